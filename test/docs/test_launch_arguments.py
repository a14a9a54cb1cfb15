"""docs/nodes.md tells the arguments of the launch file, and their defaults."""

import ast
import re

from documents import ROOT


def declared():
    """Arguments of the launch file with their defaults."""
    source = (ROOT / 'launch' / 'panodepth.launch.py').read_text()
    calls = [
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == 'DeclareLaunchArgument'
    ]
    defaults = [
        {word.arg: word.value for word in call.keywords}['default_value'] for call in calls
    ]
    return {
        ast.literal_eval(call.args[0]): ast.literal_eval(default)
        for call, default in zip(calls, defaults, strict=True)
    }


def test_launch_arguments_are_documented():
    text = (ROOT / 'docs' / 'nodes.md').read_text().partition('## Launch file')[2]
    rows = re.findall(r'^\| `(\w+)` \| (.*?) \|', text.partition('## Security')[0], re.MULTILINE)
    assert {name: '' if told == 'empty' else told.strip('`') for name, told in rows} == declared()
