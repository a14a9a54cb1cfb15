"""The simulated arm as a serial port and as a program."""

import os
import signal
import threading

import pytest
import serial
from fixtures.arm import DEG, ArmServer, wait_until
from fixtures.ros import started

from panodepth_ros.arm.driver import GrblArm
from panodepth_ros.arm.terminal import SimulatedArm, TerminalError
from panodepth_ros.arm.truth import TruthError, TruthReader

BANNER = b"Grbl 1.1h ['$' for help]"


@pytest.fixture
def link(tmp_path):
    return tmp_path / 'arm'


@pytest.fixture
def server(link):
    server = ArmServer(link)
    yield server
    server.unplug()


def read_line(port):
    line = port.readline()
    assert line.endswith(b'\r\n'), line
    return line.strip() or read_line(port)


def test_opening_the_port_powers_the_controller_up_each_time(server):
    for _ in range(2):
        with serial.Serial(server.link, 115200, timeout=10.0) as port:
            assert read_line(port) == BANNER
            port.write(b'G21G90G1X1F6000\nG4P0\n')
            assert [read_line(port), read_line(port)] == [b'ok', b'ok']
            port.write(b'?')
            assert read_line(port).startswith(b'<Idle|MPos:1.000,')
        wait_until(lambda: not server.arm._open, 'the hang-up')
    assert server.true_azimuth() == pytest.approx(0.0349066, abs=1e-6)  # 2°: the arm stayed


def test_controller_that_runs_on_keeps_its_count(link):
    server = ArmServer(link, reset_on_open=False, boot_time=0.0)
    try:
        for query, answer in ((b'G21G90G1X1F6000\nG4P0\n', b'ok'), (b'?', b'<Idle|MPos:1.000')):
            with serial.Serial(server.link, 115200, timeout=10.0) as port:
                port.write(query)
                wait_until(
                    lambda port=port, answer=answer: read_line(port).startswith(answer),
                    'the answer',
                )
                wait_until(lambda: not server.is_moving(), 'the end of the motion')
    finally:
        server.unplug()


def test_what_was_sent_while_the_port_was_closed_is_lost(link):
    with SimulatedArm(link, reset_on_open=False) as arm:  # its banner has gone out
        with serial.Serial(str(link), 115200, timeout=10.0) as port:
            thread = threading.Thread(target=arm.run)
            thread.start()
            port.write(b'?')
            assert port.readline().startswith(b'<Idle|')
        arm.stop()
        thread.join()


def test_unplugging_ends_reading(server):
    with serial.Serial(server.link, 115200, timeout=10.0) as port:
        assert read_line(port) == BANNER
        server.unplug()
        with pytest.raises((serial.SerialException, OSError)):
            port.read()


def test_link_and_truth_are_removed_at_the_end(server, link, tmp_path):
    assert link.is_symlink()
    server.unplug()
    assert list(tmp_path.iterdir()) == []


def test_stale_link_is_replaced(link):
    link.symlink_to('/dev/pts/nowhere')
    with SimulatedArm(link) as arm:
        assert os.readlink(link) == arm.terminal


def test_link_in_use_is_refused_and_left_alone(server, link):
    terminal = os.readlink(link)
    with pytest.raises(TruthError, match='in use'):
        SimulatedArm(link)
    assert os.readlink(link) == terminal


def test_file_at_the_link_is_refused_and_left_alone(link):
    link.write_text('precious')
    with pytest.raises(TerminalError, match='is not a link'):
        SimulatedArm(link)
    assert link.read_text() == 'precious'


def test_link_of_a_successor_is_not_removed(link):
    with SimulatedArm(link):
        link.unlink()
        link.symlink_to('/dev/null')
    assert os.readlink(link) == '/dev/null'


@pytest.mark.launch
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_program_ends_cleanly(link, tmp_path, number):
    arguments = ('--link', str(link), '--boot-time', '0.01', '--steps-per-degree', '50')
    with started('simulated_arm', *arguments, stop_signal=number) as program:
        program.wait_for_output('simulated arm on')
        with serial.Serial(str(link), 115200, timeout=10.0) as port:
            assert read_line(port) == BANNER
            port.write(b'$$\nG21G90G1X0.02F6000\nG4P0\n')
            answers = [read_line(port) for _ in range(37)]
            assert b'$100=50.000' in answers
            assert answers[-2:] == [b'ok', b'ok']
        assert TruthReader(f'{link}.truth').azimuth(1e9) == pytest.approx(3.4907e-4, abs=1e-7)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.launch
def test_program_has_a_mark_that_the_driver_finds(link):
    arguments = ('--link', str(link), '--boot-time', '0.01', '--max-rate', '400', '--index', '33')
    with started('simulated_arm', *arguments) as program:
        program.wait_for_output('simulated arm on')
        arm = GrblArm(str(link), speed=400 * DEG, listener=lambda _: None, index_within=0.0)
        try:
            assert arm.home().azimuth == pytest.approx(0.0, abs=1e-9)
            true = TruthReader(f'{link}.truth').azimuth(1e9)
            assert true == pytest.approx(33 * DEG, abs=0.041 * DEG)  # a motor step
        finally:
            arm.close()


@pytest.mark.launch
def test_program_says_what_is_in_the_way(link):
    link.write_text('precious')
    with started('simulated_arm', '--link', str(link), exit_code=1) as program:
        assert program.wait() == 1
        assert program.output.strip().endswith(
            f'{link} exists and is not a link of a simulated arm'
        )


@pytest.mark.launch
@pytest.mark.parametrize('value', ['0', '-1', 'nan', 'inf', 'x'])
def test_program_refuses_impossible_motors(link, value):
    arguments = ('--link', str(link), f'--max-rate={value}')
    with started('simulated_arm', *arguments, exit_code=2) as program:
        assert program.wait() == 2
        assert '--max-rate' in program.output
