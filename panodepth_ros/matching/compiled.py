"""
Compilation of kernels: numba, cached on disk, free of the interpreter lock, no fast-math.

Numba recompiles a kernel when its own file changes, not when a kernel or a constant that it took
from another file does. Here the cache of every kernel belongs to the content of the whole folder.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar('Function', bound=Callable[..., object])


def _digest_of_folder() -> str:
    digest = hashlib.blake2b(digest_size=16)
    for file in sorted(Path(__file__).parent.glob('*.py')):
        digest.update(file.read_bytes())
    return digest.hexdigest()


_STAMP = _digest_of_folder()


def kernel(function: Function) -> Function:
    """Compile a function on first call; threads run it at the same time."""
    dispatcher: Any = njit(nogil=True, cache=True)(function)
    # Numba has no public way to say what a cache depends on.
    dispatcher._cache._cache_file._source_stamp = _STAMP
    return cast(Function, dispatcher)
