"""A signal while a node is still being imported ends it with code 0 and without a word."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

#: Sends a signal to itself at the moment at which the node's module is looked for.
CODE = """
import os, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == 'panodepth_ros.{folder}.{node}':
            os.kill(os.getpid(), signal.{number})
sys.meta_path.insert(0, Finder())
from panodepth_ros.start import {node}
sys.exit({node}())
"""


@pytest.mark.parametrize('number', ['SIGINT', 'SIGTERM'])
@pytest.mark.parametrize(
    ('folder', 'node'),
    [
        *(('nodes', node) for node in ('arm_driver', 'camera', 'mosaicer', 'depth')),
        *(('nodes', node) for node in ('calibrator', 'views', 'check_scan')),
        ('cli', 'simulated_arm'),
    ],
)
def test_signal_during_the_imports_is_a_quiet_end(folder, node, number):
    code = CODE.format(folder=folder, node=node, number=number)
    ran = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, '', '')


def test_every_executable_begins_here():
    setup = Path(__file__).parents[1] / 'setup.py'
    words = [
        node.value
        for node in ast.walk(ast.parse(setup.read_text()))
        if isinstance(node, ast.Constant)
    ]
    scripts = [word for word in words if isinstance(word, str) and ' = panodepth_ros.' in word]
    elsewhere = [s for s in scripts if s != '{0} = panodepth_ros.start:{0}'.format(s.split()[0])]
    assert elsewhere == ['panodepth_ros = panodepth_ros.cli.main:main']
