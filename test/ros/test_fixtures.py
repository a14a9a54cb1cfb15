"""The tests' own ROS fixtures: domains apart, deadlines that fail, processes checked."""

import os
import signal
import sys

import pytest
from fixtures.ros import started

from panodepth_ros.cli.domain import DOMAINS, claimed_domain


def test_every_claim_is_another_domain() -> None:
    with claimed_domain() as first, claimed_domain() as second:
        assert first != second
        assert {first, second} <= set(DOMAINS)


def test_claim_ends_with_its_block() -> None:
    claims = []
    for _ in range(2 * len(DOMAINS)):  # more than there are: fails unless they are given back
        with claimed_domain() as domain:
            claims.append(domain)
    assert len(set(claims)) > 1


@pytest.mark.ros
def test_nodes_of_one_test_hear_each_other(ros) -> None:
    from std_msgs.msg import Float32  # noqa: PLC0415 - the other tests run without ROS

    got = []
    publisher = ros.node('talker').create_publisher(Float32, 'number', 10)
    ros.node('listener').create_subscription(Float32, 'number', got.append, 10)
    ros.spin_until(lambda: publisher.get_subscription_count() == 1, 'the listener')
    publisher.publish(Float32(data=2.5))
    ros.spin_until(lambda: got, 'the number')
    assert [message.data for message in got] == [2.5]
    assert os.environ['ROS_DOMAIN_ID'] == str(ros.domain_id)


@pytest.mark.ros
def test_waiting_fails_at_the_deadline(ros) -> None:
    ros.node()
    with pytest.raises(pytest.fail.Exception, match=r'a wonder did not come within 0\.1 s'):
        ros.spin_until(lambda: False, 'a wonder', timeout=0.1)


SLEEPER = """
import signal, sys, time
signal.signal(signal.SIGINT, lambda *_: sys.exit(int(sys.argv[1])))
print('ready', flush=True)
while True:
    time.sleep(1)
"""


@pytest.mark.launch
def test_started_program_is_stopped_and_its_exit_code_checked() -> None:
    with started(sys.executable, '-c', SLEEPER, '0') as program:
        program.wait_for_output('ready')
    assert not program.running()
    with (
        pytest.raises(AssertionError, match=r'ended with 3:\n\s*ready'),
        started(sys.executable, '-c', SLEEPER, '3') as program,
    ):
        program.wait_for_output('ready')


@pytest.mark.launch
def test_started_program_does_not_outlive_a_failing_test() -> None:
    programs = []

    def failing_test() -> None:
        with started(sys.executable, '-c', SLEEPER, '0') as program:
            programs.append(program)
            program.wait_for_output('ready')
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        failing_test()
    (program,) = programs
    assert program.process.returncode == -signal.SIGKILL


@pytest.mark.launch
def test_program_that_ends_early_is_reported_with_what_it_said() -> None:
    with (
        pytest.raises(pytest.fail.Exception, match=r"without saying 'ready'.*\nno way"),
        started(sys.executable, '-c', 'print("no way")') as program,
    ):
        program.wait_for_output('ready')
