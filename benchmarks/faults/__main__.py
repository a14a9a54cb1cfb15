"""
A campaign of faults: each in the middle of a sweep of a running graph, at a random moment.

Graphs run side by side, each with a simulated arm and room, and live on from fault to fault. Every
scan that is published is compared with the true room, every panorama column with what the camera
would see from there. A person who homes the arm steps in only where the mosaicer asks for one.

    python -m benchmarks.faults --injections 360 --graphs 4 --output docs/reliability.md
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.faults.campaign import Outcome, compresses, start_graph
from benchmarks.faults.faults import FAULTS
from benchmarks.faults.graph import COLUMNS
from benchmarks.faults.judge import GLARING, WRONG_COLUMN, WRONG_SCAN
from panodepth_ros.matching import prepare
from panodepth_ros.nodes.depth_settings import DepthParameters

#: More rounds of all faults than a graph ever gets through.
_ROUNDS = 50
_BEGIN, _END = '<!-- fault campaign -->', '<!-- end of fault campaign -->'


def table(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the campaign as Markdown rows."""
    rows = [
        '| fault | injections | wrong scans | hangs | scan by itself | given up | '
        'a person homed the arm | columns lost | median, longest time to the end |',
        '|---|---|---|---|---|---|---|---|---|',
    ]
    for name in (*(fault.name for fault in FAULTS), ''):
        mine = [outcome for outcome in outcomes if name in ('', outcome.fault)]
        if not mine:
            continue
        took = sorted(outcome.took for outcome in mine)
        rows.append(
            f'| {name or "**all**"} | {len(mine)} | {sum(o.wrong for o in mine)} '
            f'| {sum(o.ended == "hang" for o in mine)} | {sum(o.ended == "scan" for o in mine)} '
            f'| {sum(o.ended == "given up" for o in mine)} | {sum(o.person for o in mine)} '
            f'| {sum(o.lost for o in mine)} of {COLUMNS * len(mine)} '
            f'| {took[len(took) // 2]:.1f} s, {took[-1]:.1f} s |'
        )
    return rows


def plan(number: int, words: str, rng: np.random.Generator) -> list[str]:
    """Names of the faults of one graph, round after round, each round in another order."""
    names = [
        fault.name
        for fault in FAULTS
        if words in fault.name and fault.compressed in (None, compresses(number))
    ]
    return [str(name) for _ in range(_ROUNDS) for name in rng.permutation(names)] if names else []


def main() -> int:
    """Run the campaign; print the table; return 1 if a scan was wrong or a sweep hung."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n\n', maxsplit=1)[0])
    parser.add_argument('--injections', type=int, default=360)
    parser.add_argument('--graphs', type=int, default=4)
    parser.add_argument('--minutes', type=float, default=13.5, help='no injection after that')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--only', help='faults whose names hold these words')
    parser.add_argument('--output', type=Path, help='document whose table is replaced')
    given = parser.parse_args()
    prepare(DepthParameters().method)  # compiled once, not by every graph at once
    rng = np.random.default_rng(given.seed)
    plans = [plan(number, given.only or '', rng) for number in range(given.graphs)]
    share = -(-given.injections // given.graphs)
    began = time.monotonic()
    end = began + 60.0 * given.minutes
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # ends the graphs, which are daemons
    reports = [
        start_graph(number, names[:share], given.seed, end) for number, names in enumerate(plans)
    ]
    outcomes = [outcome for report in reports for outcome in report.recv()]
    wrong, hangs = sum(o.wrong for o in outcomes), sum(o.ended == 'hang' for o in outcomes)
    rows = [
        f'`make faults`: {len(outcomes)} injections in {(time.monotonic() - began) / 60:.1f} '
        f'minutes, {given.graphs} graphs side by side, seed {given.seed}. A scan counts as wrong '
        f'if a column of its panoramas is off by more than {WRONG_COLUMN:g} grey levels on '
        'average (where the light was switched: besides one factor, and without pixels above '
        f'{GLARING:g}), or if its median error is above {WRONG_SCAN:.0%} with fewer than half of '
        'the columns unknown.',
        '',
        *table(outcomes),
    ]
    print('\n'.join(rows))
    if given.output:
        text = given.output.read_text()
        head, _, rest = text.partition(_BEGIN)
        tail = rest.partition(_END)[2]
        given.output.write_text('\n'.join([f'{head}{_BEGIN}', *rows, f'{_END}{tail}']))
    return int(wrong > 0 or hangs > 0)


if __name__ == '__main__':
    raise SystemExit(main())
