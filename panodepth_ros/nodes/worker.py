"""A thread that does a node's heavy work, and passes over what newer work makes pointless."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Any


class Worker:
    """
    Runs jobs in a thread of its own, at most one waiting of each kind.

    Parameters
    ----------
    name : str
        Of the thread.
    run : callable
        Called with a job's kind and what was put in; what it raises is handed to ``failed``.
    failed : callable
        Called with the exception; the thread goes on.
    kinds : tuple of hashable
        Kinds of jobs, the most urgent first.
    """

    def __init__(
        self,
        name: str,
        run: Callable[[Hashable, Any], None],
        failed: Callable[[Exception], None],
        kinds: tuple[Hashable, ...],
    ) -> None:
        self._run = run
        self._failed = failed
        self._kinds = kinds
        self._waiting: dict[Hashable, Any] = {}
        self._closed = False
        self._changed = threading.Condition()
        # A daemon, so that a signal before the first spin cannot leave it behind.
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def put(self, kind: Hashable, job: Any) -> bool:
        """Let a job wait in the place of one of its kind that has not begun; say if there was."""
        with self._changed:
            replaced = kind in self._waiting
            self._waiting[kind] = job
            self._changed.notify()
        return replaced

    def close(self) -> None:
        """Finish the job under way, forget those that wait, end the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _work(self) -> None:
        while (job := self._next()) is not None:
            try:
                self._run(*job)
            except Exception as error:  # whatever it is, the thread goes on
                self._failed(error)

    def _next(self) -> tuple[Hashable, Any] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed)
            if self._closed:
                return None
            kind = next(kind for kind in self._kinds if kind in self._waiting)
            return kind, self._waiting.pop(kind)
