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


def compiler(folder: Path, **options: Any) -> Callable[[Function], Function]:
    """
    Make the decorator of a folder's kernels: compiled on first call, run by threads side by side.

    Parameters
    ----------
    folder : Path
        Where the kernels and all that they take from other files are.
    options
        Further options of ``numba.njit``.
    """
    digest = hashlib.blake2b(digest_size=16)
    for file in sorted(folder.glob('*.py')):
        digest.update(file.read_bytes())
    stamp = digest.hexdigest()

    def kernel(function: Function) -> Function:
        dispatcher: Any = njit(nogil=True, cache=True, **options)(function)
        # Numba has no public way to say what a cache depends on.
        dispatcher._cache._cache_file._source_stamp = stamp
        return cast(Function, dispatcher)

    return kernel
