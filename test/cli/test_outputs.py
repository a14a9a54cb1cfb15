"""An output that cannot be written is told before the work: even before the bag is looked for."""

import os
import subprocess
import sys

import pytest

from panodepth_ros.cli.main import main
from panodepth_ros.cli.outputs import check_file, check_folder

FILES = [
    ('calibrate', '-o'),
    ('calibrate', '-p'),
    ('ply', '-o'),
    ('report', '-o'),
]


def failed(capsys, *arguments):
    assert main([*map(str, arguments)]) == 1
    captured = capsys.readouterr()
    assert captured.out == ''
    (line,) = captured.err.splitlines()
    return line


@pytest.mark.parametrize(('command', 'option'), FILES)
def test_file_that_cannot_be_written_is_told_before_the_work(capsys, tmp_path, command, option):
    bag = tmp_path / 'no_bag'
    path = tmp_path / 'no' / 'file'
    said = failed(capsys, command, bag, option, path)
    assert f'{path} cannot be written: {path.parent} is not a folder' in said
    said = failed(capsys, command, bag, option, tmp_path)
    assert f'{tmp_path} cannot be written: it is a folder' in said
    assert list(tmp_path.iterdir()) == []


def test_folder_that_cannot_be_made_is_told_before_the_work(capsys, tmp_path):
    pytest.importorskip('matplotlib')
    (tmp_path / 'file').touch()
    path = tmp_path / 'file' / 'figures'
    said = failed(capsys, 'figures', tmp_path / 'no_bag', '--output', path)
    assert f'{path} cannot be written: {tmp_path / "file"} is not a folder' in said
    said = failed(capsys, 'analyse', '--figures', path)
    assert f'{path} cannot be written: {tmp_path / "file"} is not a folder' in said


@pytest.mark.ros
def test_demo_tells_a_folder_that_cannot_be_made(capsys, tmp_path):
    (tmp_path / 'file').touch()
    said = failed(capsys, 'demo', '--output', tmp_path / 'file')
    assert said.startswith('panodepth_ros demo: ')
    assert f'{tmp_path / "file"} is not a folder' in said


def test_what_can_be_written_passes_untouched(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    old = tmp_path / 'old'
    old.write_text('kept')
    for path in (old, tmp_path / 'new', old.relative_to(tmp_path)):
        check_file(path)
    for path in (tmp_path, tmp_path / 'a' / 'b', (tmp_path / 'a').relative_to(tmp_path)):
        check_folder(path)
    assert [path.name for path in tmp_path.iterdir()] == ['old']
    assert old.read_text() == 'kept'


#: Root may write everywhere, so that the question is asked by nobody.
PROBE = """
import os, sys
from pathlib import Path
from panodepth_ros.cli.outputs import check_file, check_folder
if os.geteuid() == 0:
    os.setgroups([])
    os.setresgid(65534, 65534, 65534)
    os.setresuid(65534, 65534, 65534)
for check, name in ((check_file, 'new'), (check_file, 'old'), (check_folder, 'figures')):
    try:
        check(Path(name))
    except OSError as error:
        print(error)
"""


def test_missing_permission_is_told(tmp_path):
    old = tmp_path / 'old'
    old.touch(0o444)
    os.chmod(tmp_path, 0o555)
    ran = subprocess.run(
        [sys.executable, '-c', PROBE], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    os.chmod(tmp_path, 0o755)
    assert ran.stderr == ''
    new, read_only, figures = ran.stdout.splitlines()
    assert new == 'new cannot be written: nothing may be written into folder .'
    assert read_only == 'old cannot be written: the file is read-only'
    assert figures == 'figures cannot be written: nothing may be written into folder .'
