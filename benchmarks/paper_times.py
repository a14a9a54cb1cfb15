"""
What the paper says of matching times, as processor times of one thread.

    python -m benchmarks.paper_times

Sec. 7: a small φ takes up to eight times less. Sec. 6.3: half the step takes about twice the time
for twice the columns. Sec. 8: lower resolution and sparse images are faster.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

from benchmarks.cost import median_times, product_run
from benchmarks.report import table
from benchmarks.scenes import noise_pair

#: Name to rows, columns of a turn, and columns to search.
CASES = {
    'the paper, 2φ = 29.9625°': (120, 1800, 149),
    'small φ, 2φ = 3.6125°': (120, 1800, 18),
    'half the step': (120, 3600, 299),
    'half the resolution': (60, 900, 75),
}
METHODS = ('ncc', 'sparse', 'semiglobal')


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--repeat', type=int, default=9, help='runs behind each median')
    repeat = parser.parse_args().repeat
    runs: dict[str, Callable[[], Any]] = {}
    for case, size in CASES.items():
        pair = noise_pair(*size)
        runs |= {f'{case} {method}': product_run(method, *pair, 1) for method in METHODS}
    taken = median_times(runs, repeat, time.process_time)
    first = next(iter(CASES))
    rows = []
    for case, (_, columns, candidates) in CASES.items():
        row = [case, str(columns), str(candidates)]
        for method in METHODS:
            seconds, of_paper = taken[f'{case} {method}'], taken[f'{first} {method}']
            row.append(f'{1e3 * seconds:.1f} ms, × {seconds / of_paper:.2f}')
        rows.append(row)
    print(table(['', 'columns', 'searched', *METHODS], rows))


if __name__ == '__main__':
    main()
