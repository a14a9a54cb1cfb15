"""Time and memory, each beside OpenCV's SGBM in the same run."""

from __future__ import annotations

import ctypes
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.methods import ALL_COLUMNS, bare_peer
from benchmarks.scenes import noise_further, noise_pair
from panodepth_ros.geometry import Panorama
from panodepth_ros.matching import Correspondence, match, prepare

Array = npt.NDArray[np.float64]

#: Sizes (rows, columns, candidates) that show how the time grows.
SIZES = ((60, 1800, 149), (120, 900, 149), (120, 1800, 80), (120, 1800, 149), (240, 1800, 149),
         (240, 3600, 149), (240, 3600, 298))  # fmt: skip


def median_times(
    runs: Mapping[str, Callable[[], Any]],
    repeat: int,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """
    Median time of each, taken in turns so that a slow moment of the machine hits all alike.

    Parameters
    ----------
    runs : mapping of callables
        What to time; each is called once before.
    repeat : int
        How often.
    clock : callable
        What time is taken from.

    Returns
    -------
    dict
        Seconds by name.
    """
    for run in runs.values():
        run()
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeat):
        for name, run in runs.items():
            start = clock()
            run()
            times[name].append(clock() - start)
    return {name: float(np.median(taken)) for name, taken in times.items()}


def product_run(
    name: str, left: Panorama, right: Panorama, threads: int
) -> Callable[[], Correspondence]:
    """One of the product's methods on a pair, with six more panoramas if its name says so."""
    method = name.removesuffix(ALL_COLUMNS)
    further = [] if method == name else noise_further(left, right)
    return partial(match, left, right, further=further, method=method, threads=threads)


def compare(
    pair: tuple[Panorama, Panorama],
    methods: Sequence[str],
    peers: Sequence[str],
    *,
    threads: int,
    repeat: int,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Median times of the product's methods and of OpenCV's matchers on one pair [s]."""
    left, right = pair
    runs: dict[str, Callable[[], Any]] = {
        f'OpenCV {peer}': bare_peer(peer, left, right) for peer in peers
    }
    for method in methods:
        runs[method] = product_run(method, left, right, threads)
    before = cv2.getNumThreads()
    cv2.setNumThreads(threads)
    try:
        return median_times(runs, repeat, clock)
    finally:
        cv2.setNumThreads(before)


def linearity(method: str, *, repeat: int) -> tuple[Array, Array, float]:
    """
    How the time grows with the work, with one thread.

    Returns
    -------
    work, seconds : ndarray of float64, shape (len(SIZES),)
        Pixels × candidates and median time.
    spread : float
        Largest over smallest time per pixel and candidate.
    """
    work = np.array([np.prod(size) for size in SIZES], np.float64)
    seconds = np.array(
        [
            compare(noise_pair(*size), [method], [], threads=1, repeat=repeat)[method]
            for size in SIZES
        ]
    )
    return work, seconds, float((seconds / work).max() / (seconds / work).min())


def peak_memory(method: str, size: tuple[int, int, int], threads: int) -> float:
    """Return the memory that a match adds to a process of its own, at its highest [MB]."""
    done = subprocess.run(
        [sys.executable, '-m', 'benchmarks.cost', method, *map(str, size), str(threads)],
        capture_output=True,
        text=True,
        check=True,
        timeout=600,
    )
    return float(done.stdout)


def _resident(field: str) -> float:
    for line in Path('/proc/self/status').read_text().splitlines():
        if line.startswith(field):
            return int(line.split()[1]) / 1024
    raise RuntimeError(f'/proc/self/status has no {field}')


def _measure_own_peak(method: str, size: tuple[int, int, int], threads: int) -> float:
    left, right = noise_pair(*size)
    if method.startswith('OpenCV '):
        run = bare_peer(method.removeprefix('OpenCV '), left, right)
    else:
        prepare(method.removesuffix(ALL_COLUMNS))
        run = product_run(method, left, right, threads)
    ctypes.CDLL(None).malloc_trim(0)  # what was freed must not hide what is taken
    Path('/proc/self/clear_refs').write_text('5')  # the peak starts anew
    before = _resident('VmRSS')
    run()
    return _resident('VmHWM') - before


if __name__ == '__main__':
    name, rows_, columns_, candidates_, threads_ = sys.argv[1:]
    whole = (int(rows_), int(columns_), int(candidates_))
    print(_measure_own_peak(name, whole, int(threads_)))
