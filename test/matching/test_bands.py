"""Bands of rows that threads share."""

from __future__ import annotations

import threading

import pytest

from panodepth_ros.matching.bands import run_bands


@pytest.mark.parametrize('threads', [1, 2, 3])
def test_every_row_is_handled_once_by_as_many_threads_at_the_same_time(threads: int) -> None:
    together = threading.Barrier(threads)
    rows: list[int] = []

    def run(start: int, stop: int) -> None:
        together.wait(timeout=30)  # breaks, and raises, unless all threads come
        rows.extend(range(start, stop))

    run_bands(run, 17, 2 * threads, threads)
    assert sorted(rows) == list(range(17))


def test_what_fails_in_another_thread_fails_here() -> None:
    here = threading.current_thread()
    both = threading.Barrier(2)

    def run(start: int, stop: int) -> None:
        both.wait(timeout=30)
        if threading.current_thread() is not here:
            raise ValueError(f'rows {start} to {stop}')

    with pytest.raises(ValueError, match='rows'):
        run_bands(run, 10, 2, 2)
