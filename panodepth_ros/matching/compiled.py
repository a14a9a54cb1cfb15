"""Compilation of kernels: numba, cached on disk, free of the interpreter lock, no fast-math."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

Function = TypeVar('Function', bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a function on first call; threads run it at the same time."""
    return cast(Function, njit(nogil=True, cache=True)(function))
