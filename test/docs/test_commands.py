"""Every command that a document shows is run by a test, or checked as far as that goes here."""

import argparse
import importlib
import importlib.metadata
import re
import runpy
import shlex
from pathlib import Path

import pytest
import yaml
from documents import DOCUMENTS, OURS, ROOT, commands

from panodepth_ros.cli.main import COMMANDS

pytest.importorskip('rclpy', reason='the tables of the nodes need ROS 2')

#: Documents whose commands test_tutorials runs.
RUN = {path.name for path in (ROOT / 'docs' / 'tutorials').glob('*.md')}
#: Commands that no test runs as they stand, and why; the first match counts.
ONLY_CHECKED = {
    r'git clone ': 'fetches this repository',
    r'make |\.ci/run': 'installs for minutes; continuous integration begins with it',
    r'(rosdep|colcon|apt-get|pip) ': 'installs; test_workspace builds with colcon',
    r'(ls|v4l2-ctl) .*/dev/': 'needs hardware',
    r'.*(video_device|port):=/dev/': 'needs hardware',
    r'rviz2 ': 'no display; test_viewers reads the file',
    r'ros2 (launch|run|bag|param|security|service|topic)': 'PyPI has no ros2; see test_workspace',
    r'(python|\.venv/jazzy/bin/python) -m (pytest|benchmarks|tools)': 'takes minutes',
    r'python tools/parameter_tables.py': 'writes into the documents; test_parameters runs it',
    r'panodepth_ros calibrate': 'takes a minute; test_calibrate runs it on a short sweep',
    r'panodepth_ros demo': 'test_graph runs it',
    r'panodepth_ros (record|replay)': 'test_tutorials and test_bag_record run it',
    r'panodepth_ros watch': 'test_watcher runs it',
    r'panodepth_ros (figures|ply)': 'test_figures runs it',
    r'(mosaicer|depth|check_scan)\b': 'test_tutorials runs it',
}
#: In a tutorial these are run all the same.
RUN_IN_TUTORIALS = r'ros2 service|panodepth_ros (record|replay|ply)|mosaicer|depth|check_scan'
#: Programs that are not ours and take any arguments.
OTHERS = ('git', 'cd', 'rosdep', 'colcon', 'apt-get', 'ls', 'v4l2-ctl', 'rviz2', '.ci/run')


def not_run(path: Path, command: str) -> str:
    """Why no test runs a command as it stands; empty if one does."""
    tutorial = path.name in RUN
    if tutorial and re.match(RUN_IN_TUTORIALS, command):
        return ''
    return next((why for what, why in ONLY_CHECKED.items() if re.match(what, command)), '')


def is_run(path: Path, command: str) -> bool:
    """Whether test_tutorials or the test of single commands below runs it."""
    return path.name in RUN or command in single_commands()


def single_commands() -> list[str]:
    """Commands that are run by themselves, on the folder of a demo."""
    found = {c for path in DOCUMENTS for c in commands(path) if path.name not in RUN}
    return sorted(c for c in found if re.match(r'panodepth_ros (analyse|report)\b', c))


@pytest.mark.parametrize('path', DOCUMENTS, ids=lambda path: path.name)
def test_every_command_is_run_or_known_why_not(path):
    unknown = [c for c in commands(path) if not not_run(path, c) and not is_run(path, c)]
    assert unknown == [], 'run it in test_tutorials, or name it in ONLY_CHECKED with the reason'


@pytest.mark.parametrize('path', DOCUMENTS, ids=lambda path: path.name)
def test_every_command_is_right_as_far_as_can_be_told(path):
    faults = {c: fault(c) for c in commands(path)}
    assert {c: f for c, f in faults.items() if f} == {}


@pytest.mark.parametrize(
    'wrong',
    [
        'panodepth_ros analyse --fow 60',
        'panodepth_ros fly',
        'depth --ros-args -p methid:=ncc',
        'depth --ros-args -p method:=magic',
        'depth --ros-args -p beams:=360.0 &',
        'mosaicer --ros-args -r image_raw',
        'ros2 launch panodepth_ros panodepth.launch.py simulatd:=false',
        'ros2 launch panodepth_ros other.launch.py',
        'ros2 run panodepth_ros fly',
        'ros2 service call /mosaicer/go std_srvs/srv/Trigger',
        'ros2 service call /mosaicer/start std_srvs/srv/SetBool',
        'ros2 topic echo /mosaicer/state',
        'make tea',
        'make demo OUTPT=x',
        'make demo MODE=fly',
        'pip install .[jazzy,tea]',
        'python -m benchmarks.tea',
        'python -m benchmarks.turning --tea 1',
        'python tools/tea.py',
        'simulated_arm --lnk x',
        'rviz2 -d $(ros2 pkg prefix panodepth_ros)/share/panodepth_ros/config/tea.rviz',
        'bicycle --fast',
        '```tea',
    ],
)
def test_wrong_commands_are_found(wrong):
    assert fault(wrong)


@pytest.mark.ros
@pytest.mark.launch
@pytest.mark.timeout(200)
@pytest.mark.parametrize('command', single_commands())
def test_single_command(command, demo, tmp_path, monkeypatch, capsys):
    (tmp_path / 'demo_output').symlink_to(demo[0])
    monkeypatch.chdir(tmp_path)
    name, *arguments = shlex.split(command)[1:]
    from panodepth_ros.cli.main import main  # noqa: PLC0415 - as the command does

    assert main([name, *arguments]) == 0
    assert capsys.readouterr().out


# --- what can be told without running -----------------------------------------------------------


def fault(command: str) -> str:
    """What is wrong with a command; empty if nothing is known to be."""
    for part in command.removesuffix(' &').split(' && '):
        words = [w for w in shlex.split(part) if w != '…']
        for name in re.findall(r'\bconfig/[\w.]+', part):
            if not (ROOT / name).is_file():
                return f'there is no {name}'
        if words[0] in OTHERS:
            continue
        check = CHECKS.get(words[0])
        if check is None:
            return f'{words[0]} is no program that is known here'
        found = check(words)
        if found:
            return found
    return ''


def _ours(words: list[str]) -> str:
    name, *arguments = words
    scripts = importlib.metadata.distribution('panodepth_ros').entry_points
    if name not in {script.name for script in scripts}:
        return f'panodepth_ros has no program {name}'
    if name == 'panodepth_ros':
        return _command_line(arguments)
    if name == 'simulated_arm':
        return _options(ROOT / 'panodepth_ros' / 'cli' / 'simulated_arm.py', arguments)
    return _ros_arguments(name, arguments)


def _command_line(arguments: list[str]) -> str:
    name, *rest = arguments
    if name not in COMMANDS:
        return f'panodepth_ros has no command {name}'
    if not rest:
        return ''  # the command is only mentioned
    parser = argparse.ArgumentParser(exit_on_error=False)
    importlib.import_module(f'panodepth_ros.cli.{name}').add_arguments(parser)
    if name == 'watch' and '--ros-args' in rest:
        rest = rest[: rest.index('--ros-args')]
    if rest == ['--params-file']:
        return ''  # what follows is left to the reader
    try:
        _, unknown = parser.parse_known_args(rest)
    except (argparse.ArgumentError, SystemExit) as error:
        return str(error)
    return f'{name} does not know {unknown}' if unknown else ''


def _ros_arguments(node: str, arguments: list[str]) -> str:
    table = runpy.run_path(str(ROOT / 'tools' / 'parameter_tables.py'))['TABLES'][node]
    if arguments and arguments[0] != '--ros-args':
        return f'{arguments[0]} is no ROS argument'
    values = {}
    for flag, word in zip(arguments[1::2], arguments[2::2], strict=True):
        name, separator, value = word.partition(':=')
        if flag not in ('-p', '-r') or not separator:
            return f'{flag} {word} is no ROS argument'
        if flag == '-p':
            values[name] = yaml.safe_load(value)
    fields = table.__dataclass_fields__
    for name, value in values.items():
        if name not in fields:
            return f'{node} has no parameter {name}'
        if type(value) is not type(fields[name].default):
            return f'{name} is {value!r}; its default is {fields[name].default!r}'
        choices = fields[name].metadata['choices']
        if choices and value not in choices:
            return f'{name} is {value}; allowed: {choices}'
    return ''


def _ros2(words: list[str]) -> str:
    verb, *rest = words[1:]
    if verb == 'launch':
        launch = ROOT / 'launch' / rest[1]
        if not launch.is_file():
            return f'there is no launch file {rest[1]}'
        known = re.findall(r"DeclareLaunchArgument\(\s*'(\w+)'", launch.read_text())
        return ', '.join(w for w in rest[2:] if w.partition(':=')[0] not in known)
    if verb == 'run':
        return '' if rest[0] == 'tf2_ros' else _ours(rest[1:])
    if verb == 'service':
        _, node, service = rest[1].split('/')
        kind = rest[2].rpartition('/')[2]
        source = (ROOT / 'panodepth_ros' / 'nodes' / f'{node}.py').read_text()
        source += ''.join(p.read_text() for p in (ROOT / 'panodepth_ros/nodes').glob('re*.py'))
        offered = re.findall(rf"create_service\(\s*{kind}, '~/(\w+)'", source)
        if f"create_service({kind}, f'~/{{name}}'" in source:
            offered += re.findall(r"^ *\('(\w+)', self\._on_", source, re.MULTILINE)
        return '' if service in offered else f'{node} offers no {service} as {kind}'
    if verb == 'topic':
        _, node, topic = rest[1].split('/')
        source = (ROOT / 'panodepth_ros' / 'nodes' / f'{node}.py').read_text()
        published = re.findall(r"create_publisher\(\s*\w+, '~/(\w+)'", source)
        return '' if topic in published else f'{node} publishes no {topic}'
    return '' if verb in ('bag', 'param', 'security') else f'ros2 {verb} is not known here'


def _make(words: list[str]) -> str:
    text = (ROOT / 'Makefile').read_text()
    for word in words[1:]:
        name, separator, value = word.partition('=')
        pattern = rf'^{name} \?=' if separator else rf'^{name}:'
        if not re.search(pattern, text, re.MULTILINE):
            return f'Makefile has no {name}'
        if name == 'MODE':
            return _command_line(['demo', '--mode', value])
    return ''


def _pip(words: list[str]) -> str:
    extras = re.findall(r"^        '(\w+)': ", (ROOT / 'setup.py').read_text(), re.MULTILINE)
    wanted = re.findall(r'\[(.*)\]', ' '.join(words))
    return ', '.join(e for w in wanted for e in w.split(',') if e not in extras)


def _python(words: list[str]) -> str:
    _, *rest = words
    if rest[0] == '-m':
        if rest[1] == 'pytest':
            return ''
        module = ROOT / rest[1].replace('.', '/')
        path = module / '__main__.py' if module.is_dir() else module.with_suffix('.py')
        arguments = rest[2:]
    else:
        path, arguments = ROOT / rest[0], rest[1:]
        if not path.is_file():
            path = ROOT / 'docs' / 'tutorials' / rest[0]
    if '--ros-args' in arguments:
        arguments = []
    return _options(path, arguments) if path.is_file() else f'there is no {path}'


def _options(path: Path, arguments: list[str]) -> str:
    source = path.read_text()
    options = [word for word in arguments if word.startswith('--')]
    return ', '.join(option for option in options if f"'{option}'" not in source)


CHECKS = {
    'ros2': _ros2,
    'make': _make,
    'pip': _pip,
    'python': _python,
    '.venv/jazzy/bin/python': _python,
    **dict.fromkeys(OURS, _ours),
}
