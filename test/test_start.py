"""A signal while a node is still being imported ends it with code 0 and without a word."""

import subprocess
import sys

import pytest

#: Sends a signal to itself at the moment at which the node's module is looked for.
CODE = """
import os, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == 'panodepth_ros.nodes.{node}':
            os.kill(os.getpid(), signal.{number})
sys.meta_path.insert(0, Finder())
from panodepth_ros.start import {node}
sys.exit({node}())
"""


@pytest.mark.parametrize('number', ['SIGINT', 'SIGTERM'])
@pytest.mark.parametrize(
    'node', ['arm_driver', 'camera', 'mosaicer', 'depth', 'calibrator', 'views']
)
def test_signal_during_the_imports_is_a_quiet_end(node, number):
    code = CODE.format(node=node, number=number)
    ran = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, '', '')
