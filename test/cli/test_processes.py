"""Processes that a command starts and stops."""

import pytest
from fixtures.arm import wait_until

from panodepth_ros.cli.processes import ProcessError, Processes

pytestmark = pytest.mark.launch

MODULE = """
import signal, sys, time
from pathlib import Path

def main():
    older_ended, ready, role = (*map(Path, sys.argv[1:3]), sys.argv[3])
    try:
        ready.touch()
        signal.pause()
    except KeyboardInterrupt:
        if role == 'older':
            older_ended.touch()
        else:
            time.sleep(0.5)  # as a node that closes what it has
            print('alone' if older_ended.exists() else 'in company')
    return 0
"""


def test_what_was_started_first_outlives_what_needs_it(tmp_path, monkeypatch):
    (tmp_path / 'on_interrupt.py').write_text(MODULE)
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    processes = Processes(tmp_path)
    for role in ('older', 'newer'):
        ready = tmp_path / f'{role}_ready'
        processes.start(role, 'on_interrupt', [str(tmp_path / 'older_ended'), str(ready), role])
        wait_until(ready.exists, 'the process')
    processes.stop()
    assert processes.output('newer') == 'in company'


def test_process_that_ended_without_a_word_is_told(tmp_path, monkeypatch):
    (tmp_path / 'mute.py').write_text('def main():\n    return 3\n')
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    processes = Processes(tmp_path)
    processes.start('node', 'mute', [])
    with pytest.raises(ProcessError, match=r'(?s)node ended with code 3:.*is the disk full\?'):
        wait_until(processes.check, 'the end of the process')
