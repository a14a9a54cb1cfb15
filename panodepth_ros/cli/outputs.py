"""Whether an output can be written, asked before the work that makes it."""

from __future__ import annotations

import os
from pathlib import Path


def check_file(path: Path) -> None:
    """
    Check that a file can be written; it is not touched.

    Raises
    ------
    OSError
        If it cannot; the sentence names the path and the reason.
    """
    if path.is_dir():
        raise OSError(f'{path} cannot be written: it is a folder; allowed: a file')
    if path.exists():
        if not os.access(path, os.W_OK):
            raise OSError(f'{path} cannot be written: the file is read-only')
    elif not path.parent.is_dir():
        raise OSError(f'{path} cannot be written: {path.parent} is not a folder')
    else:
        _check_writable(path, path.parent)


def check_folder(path: Path) -> None:
    """
    Check that files can be written into a folder, which need not exist yet; it is not made.

    Raises
    ------
    OSError
        If they cannot; the sentence names the path and the reason.
    """
    existing = next(folder for folder in (path, *path.parents) if folder.exists())
    if not existing.is_dir():
        raise OSError(f'{path} cannot be written: {existing} is not a folder')
    _check_writable(path, existing)


def _check_writable(path: Path, folder: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OSError(f'{path} cannot be written: nothing may be written into folder {folder}')
