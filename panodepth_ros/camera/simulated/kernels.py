"""The decorators of the room's kernels; divisions by 0 give what they give in NumPy."""

from pathlib import Path
from typing import Any

from panodepth_ros.compiled import compiler

kernel: Any = compiler(Path(__file__).parent, error_model='numpy')
#: For a kernel whose dozens of arrays cost as much to hand over as what it does.
inlined: Any = compiler(Path(__file__).parent, error_model='numpy', inline='always')
