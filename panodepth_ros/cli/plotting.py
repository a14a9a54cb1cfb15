"""Modules that draw, for commands that can do without them."""

from __future__ import annotations

import importlib
from typing import Any


class PlottingError(RuntimeError):
    """There is nothing to draw with."""


def plotting(module: str) -> Any:
    """
    Import one of the modules that draw with matplotlib, which is an optional dependency.

    Raises
    ------
    PlottingError
        If matplotlib is not installed.
    """
    try:
        return importlib.import_module(f'panodepth_ros.{module}')
    except ModuleNotFoundError as error:
        if (error.name or '').partition('.')[0] != 'matplotlib':
            raise
        raise PlottingError(
            'pictures need the Python package matplotlib: pip install "panodepth_ros[plot]"'
        ) from error
