"""Tables in Markdown and plots."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import matplotlib as mpl
import numba
import numpy as np

from benchmarks.accuracy import Accuracy
from panodepth_ros.analysis.evaluation import ScanScore

mpl.use('Agg')
from matplotlib import pyplot as plt


def versions() -> str:
    """One line that says what the figures were measured with."""
    return (
        f'{_processor()}, Python {platform.python_version()}, NumPy {np.__version__}, '
        f'OpenCV {cv2.__version__}, numba {numba.__version__}'
    )


def _processor() -> str:
    for line in Path('/proc/cpuinfo').read_text().splitlines():
        if line.startswith('model name'):
            return line.partition(':')[2].strip()
    return platform.machine()


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Markdown table."""
    lines = [head, ['---'] * len(head), *rows]
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)


def accuracy_table(results: Mapping[str, tuple[Accuracy, ScanScore]], *, kept: float) -> str:
    """One row a method; ``kept`` is the share at which methods are compared."""
    rows = []
    for name, (accuracy, scan) in results.items():
        rows.append(
            [
                name,
                _percent(accuracy.kept),
                _percent(accuracy.wrong),
                _percent(accuracy.wrong_at(kept)),
                _percent(accuracy.right_visible),
                _percent(accuracy.median_distance_error, 2),
                _percent(scan.coverage),
                _percent(scan.within_5_percent),
                _percent(scan.too_far),
                _percent(scan.too_near),
            ]
        )
    head = [
        'method',
        'kept %',
        'wrong %',
        f'wrong % at {kept:.2f} kept',
        'visible and right %',
        'median distance error %',
        'scan: coverage %',
        'within 5 %',
        'too far %',
        'too near %',
    ]
    return table(head, rows)


def time_table(one: Mapping[str, float], two: Mapping[str, float]) -> str:
    """Times with one and two threads, and as a share of SGBM's in the same run."""
    rows = [
        [
            name,
            f'{1e3 * one[name]:.1f}',
            f'{1e3 * two[name]:.1f}',
            f'{one[name] / one["OpenCV SGBM"]:.3f}',
            f'{two[name] / two["OpenCV SGBM"]:.3f}',
        ]
        for name in one
    ]
    head = ['method', '1 thread ms', '2 threads ms', 'of SGBM, 1 thread', 'of SGBM, 2 threads']
    return table(head, rows)


def _percent(share: float, digits: int = 1) -> str:
    return '–' if np.isnan(share) else f'{100 * share:.{digits}f}'


def plot_curves(results: Mapping[str, Accuracy], title: str, path: Path) -> None:
    """Write wrong against kept, from the most confident pixel on."""
    figure, axes = plt.subplots(figsize=(7, 4.5), layout='constrained')
    for name, accuracy in results.items():
        # The first pixels are few and say little; a thousand points draw the rest.
        last = accuracy.kept_curve.size - 1
        first = min(int(np.searchsorted(accuracy.kept_curve, 0.02)), last)
        shown = np.linspace(first, last, 1000).astype(np.int64)
        style = '--' if name.startswith('OpenCV') else '-'
        line = axes.plot(
            100 * accuracy.kept_curve[shown], 100 * accuracy.wrong_curve[shown], style, label=name
        )
        axes.plot(100 * accuracy.kept, 100 * accuracy.wrong, 'o', color=line[0].get_color())
    axes.set_xlabel('kept, % of the pixels visible to both eyes')
    axes.set_ylabel('wrong, % of the kept pixels')
    axes.set_xlim(0, 100)
    axes.set_ylim(bottom=0)
    axes.set_title(title)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc='upper left')
    figure.savefig(path, dpi=120)
    plt.close(figure)


def plot_reliability(results: Mapping[str, Accuracy], title: str, path: Path) -> None:
    """Write the share of right matches against the confidence."""
    figure, axes = plt.subplots(figsize=(5, 4.5), layout='constrained')
    axes.plot([0, 1], [0, 1], color='0.7')
    for name, accuracy in results.items():
        confidence, right, share = accuracy.reliability
        enough = share > 0.002
        axes.plot(confidence[enough], right[enough], 'o-', label=name)
    axes.set_xlabel('confidence')
    axes.set_ylabel('share within one column')
    axes.set_title(title)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc='upper left')
    figure.savefig(path, dpi=120)
    plt.close(figure)
