"""Bands of rows that threads share."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise


def run_bands(run: Callable[[int, int], None], rows: int, bands: int, threads: int) -> None:
    """
    Run something for all bands of some rows.

    Parameters
    ----------
    run : callable
        From a band's first row and the one after its last to nothing.
    rows, bands : int
        How many.
    threads : int
        Threads to use, this one among them: starting one takes as long as a tenth of a match.
    """
    limits = [round(band * rows / bands) for band in range(bands + 1)]
    waiting = deque(pairwise(limits))

    def work() -> None:
        while waiting:
            try:
                start, stop = waiting.popleft()
            except IndexError:  # another thread took the last one
                return
            run(start, stop)

    if threads == 1:
        work()
        return
    with ThreadPoolExecutor(threads - 1) as pool:
        others = [pool.submit(work) for _ in range(threads - 1)]
        work()
    for other in others:
        other.result()
