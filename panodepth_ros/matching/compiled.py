"""The decorator of the matching's kernels."""

from pathlib import Path

from panodepth_ros.compiled import compiler

kernel = compiler(Path(__file__).parent)
