"""The ``panodepth_ros`` command itself."""

import json
import subprocess
import sys
from importlib.metadata import version

import pytest

from panodepth_ros.cli.main import COMMANDS, main


def ended(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as caught:
        main(list(arguments))
    captured = capsys.readouterr()
    return caught.value.code, captured.out, captured.err


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = ended(capsys, '--help')
    assert code == 0
    for name, text in COMMANDS.items():
        assert name in out
        assert text.split()[0] in out


@pytest.mark.parametrize('command', ['analyse', 'figures', 'ply', 'record', 'replay'])
def test_command_has_help(capsys: pytest.CaptureFixture[str], command: str) -> None:
    code, out, _ = ended(capsys, command, '--help')
    assert code == 0
    assert COMMANDS[command] in out
    assert out.startswith(f'usage: panodepth_ros {command} ')


def test_version_is_the_installed_one(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = ended(capsys, '--version')
    assert (code, out) == (0, f'panodepth_ros {version("panodepth_ros")}\n')


@pytest.mark.parametrize('arguments', [[], ['fly'], ['record'], ['record', '-a', 'topic']])
def test_wrong_arguments_end_with_usage_and_code_2(
    capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    code, out, err = ended(capsys, *arguments)
    assert code == 2
    assert out == ''
    assert err.startswith('usage: panodepth_ros')


#: Sends a signal to itself at the moment at which the command's module is looked for.
INTERRUPTED = """
import os, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == 'panodepth_ros.cli.' + sys.argv[1]:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
from panodepth_ros.cli.main import main
sys.exit(main())
"""


@pytest.mark.launch
@pytest.mark.parametrize('command', ['analyse', 'calibrate', 'ply', 'replay'])
def test_interrupted_command_ends_without_a_traceback(command: str) -> None:
    words = [sys.executable, '-c', INTERRUPTED, command]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    told = f'\npanodepth_ros {command}: interrupted\n'
    assert (done.returncode, done.stdout, done.stderr) == (130, '', told)


PROBE = """
import json, sys
from panodepth_ros.cli.main import main
try:
    main(json.loads(sys.argv[1]))
except SystemExit as end:
    loaded = [name for name in ('rclpy', 'rosbags', 'cv2', 'numba') if name in sys.modules]
    print(json.dumps([end.code, loaded]))
"""


@pytest.mark.launch
@pytest.mark.parametrize('arguments', [['--help'], ['--version'], ['replay', '--help']])
def test_help_loads_neither_ros_nor_anything_slow(arguments: list[str]) -> None:
    command = [sys.executable, '-c', PROBE, json.dumps(arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert json.loads(done.stdout.splitlines()[-1]) == [0, []]


WITHOUT = """
import sys
sys.modules[sys.argv.pop(1)] = None  # as if it were not installed
from panodepth_ros.cli.main import main
sys.exit(main())
"""


@pytest.mark.launch
@pytest.mark.ros
@pytest.mark.parametrize('arguments', [['record', '/a', '-o', 'new'], ['replay', '.']])
@pytest.mark.parametrize(
    ('missing', 'remedy'),
    [('rclpy', 'pip install "panodepth_ros[jazzy]"'), ('rosbags', 'pip install rosbags')],
)
def test_what_is_missing_is_told_with_the_remedy(
    ros_domain: int, tmp_path, missing: str, remedy: str, arguments: list[str]
) -> None:
    (tmp_path / 'metadata.yaml').write_text('')  # looks like a bag
    command = [sys.executable, '-c', WITHOUT, missing, *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=60, cwd=tmp_path, check=False
    )
    assert done.returncode == 1
    assert done.stderr.startswith(f'panodepth_ros {arguments[0]}: ')
    assert done.stderr.count('\n') == 1
    assert remedy in done.stderr
    assert not (tmp_path / 'new').exists()
