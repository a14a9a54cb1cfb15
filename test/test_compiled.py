"""The kernel cache: used again, and not beyond a change of what was compiled."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import panodepth_ros

pytestmark = pytest.mark.launch

PROGRAM = """
from folder.outer import outer
print(outer(5), sum(outer.stats.cache_hits.values()))
"""


@pytest.fixture
def run(tmp_path: Path):
    folder = tmp_path / 'folder'
    folder.mkdir()
    (folder / '__init__.py').touch()
    (folder / 'compiled.py').write_text(
        'from pathlib import Path\nfrom panodepth_ros.compiled import compiler\n\n'
        'kernel = compiler(Path(__file__).parent)\n'
    )
    (folder / 'inner.py').write_text(
        'from folder.compiled import kernel\nSTEP = 1\n\n'
        '@kernel\ndef inner(x):\n    return x + STEP\n'
    )
    (folder / 'outer.py').write_text(
        'from folder.compiled import kernel\nfrom folder.inner import inner\n\n'
        '@kernel\ndef outer(x):\n    return inner(x)\n'
    )

    def once() -> tuple[int, int]:
        environment = {
            **os.environ,
            'NUMBA_CACHE_DIR': str(tmp_path / 'cache'),
            'PYTHONPATH': str(Path(panodepth_ros.__file__).parents[1]),
        }
        done = subprocess.run(
            [sys.executable, '-c', PROGRAM],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
        )
        result, hits = done.stdout.split()
        return int(result), int(hits)

    return folder, once


def test_second_process_takes_the_kernel_from_the_cache(run) -> None:
    _, once = run
    assert once() == (6, 0)
    assert once() == (6, 1)


def test_change_in_another_file_compiles_anew(run) -> None:
    folder, once = run
    assert once() == (6, 0)
    inner = folder / 'inner.py'
    inner.write_text(inner.read_text().replace('STEP = 1', 'STEP = 2'))
    assert once() == (7, 0)
