"""The protocol as bytes: every message, whole, in pieces, and among noise."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panodepth_ros.arm import grbl
from panodepth_ros.arm.grbl import (
    Alarm,
    Banner,
    ErrorReply,
    Feedback,
    LineAssembler,
    Malformed,
    Ok,
    Probe,
    Setting,
    Status,
    parse,
)

MESSAGES = {
    b'ok': Ok(),
    b'error:20': ErrorReply(20),
    b'ALARM:1': Alarm(1),
    b"Grbl 1.1h ['$' for help]": Banner('1.1h'),
    b"GrblHAL 1.1f ['$' or '$HELP' for help]": Banner('1.1f'),
    b"Grbl 3.7 [FluidNC v3.7.8 (wifi) '$' for help]": Banner('3.7'),
    b'$100=25.000': Setting(100, 25.0),
    b'$22=1': Setting(22, 1.0),
    b'$N0=': Malformed(b'$N0='),
    b'$70=home': Setting(70, None),
    b'[MSG:Reset to continue]': Feedback('[MSG:Reset to continue]'),
    b'>G54:ok': Feedback('>G54:ok'),
    b'[PRB:12.345,0.000,0.000:1]': Probe((12.345, 0.0, 0.0), True),
    b'[PRB:0.0000,0.0000,0.0000:0]': Probe((0.0, 0.0, 0.0), False),
    b'[PRB:12.345,0.000:1]': Malformed(b'[PRB:12.345,0.000:1]'),
    b'<Idle|MPos:1.029,0.000,0.000|FS:0,0>': Status(
        'Idle', None, True, (1.029, 0.0, 0.0), None, 0.0
    ),
    b'<Hold:1|WPos:-0.040,0.000,0.000|FS:1800,0|Ov:100,100,100>': Status(
        'Hold', 1, False, (-0.04, 0.0, 0.0), None, 1800.0
    ),
    b'<Run|MPos:0.0409,0.0000,0.0000|WCO:0.5000,0.0000,0.0000|Bf:15,128|F:70.9>': Status(
        'Run', None, True, (0.0409, 0.0, 0.0), (0.5, 0.0, 0.0), 70.9
    ),
    b'<Alarm|MPos:0.000,0.000,0.000,41.080|Pn:XH|A:S|FS:0,0>': Status(
        'Alarm', None, True, (0.0, 0.0, 0.0, 41.08), None, 0.0, 'XH'
    ),
    b'<Idle|MPos:12345.678,0.000,0.000>': Status('Idle', None, True, (12345.678, 0.0, 0.0)),
}

MALFORMED = [
    b'o',
    b'okk',
    b'ok ok',
    b'error:',
    b'error:x',
    b'rror:20',
    b'ALARM',
    b'Grbl',
    b'\xff\xfe',
    b'ok\xff',
    b'$=1',
    b'[MSG:half',
    b'<>',
    b'<Idle>',
    b'<Idle|MPos:1.029,0.000,0.000',
    b'Idle|MPos:1.029,0.000,0.000>',
    b'<Ide|MPos:1.029,0.000,0.000>',
    b'<Idle|Pos:1.029,0.000,0.000>',
    b'<Idle|FS:0,0|MPos:1.029,0.000,0.000>',
    b'<Idle|MPos:1.029,0.000>',
    b'<Idle|MPos:1.09,0.000,0.000>',  # a lost decimal
    b'<Idle|MPos:1029,0.000,0.000>',  # a lost point
    b'<Idle|MPos:.029,0.000,0.000>',
    b'<Idle|MPos:1.029,0.0000,0.000>',
    b'<Idle|MPos:1.029,0.000,0.000,>',
    b'<Idle|MPos:1.029,0.000,0.000|MPos:1.029,0.000,0.000>',
    b'<Idle|MPos:1.029,0.000,0.000|WPos:1.029,0.000,0.000>',
    b'<Idle|MPos:1.029,0.000,0.000|WCO:0.000,0.000>',
    b'<Idle|MPos:1.029,0.000,0.000|FS:>',
    b'<Idle|MPos:1.029,0.000,0.000||FS:0,0>',
    b'<Idle|MPos:1.0<Idle|MPos:1.029,0.000,0.000>',
]


def feed(portions):
    assembler = LineAssembler()
    return [parse(line) for portion in portions for line in assembler.feed(portion)]


@pytest.mark.parametrize('line', MESSAGES, ids=repr)
def test_message_is_understood(line):
    assert parse(line) == MESSAGES[line]


@pytest.mark.parametrize('line', MALFORMED, ids=repr)
def test_what_is_not_exactly_a_message_is_malformed(line):
    assert parse(line) == Malformed(line)


@pytest.mark.parametrize('line', MESSAGES, ids=repr)
def test_message_split_at_any_byte_is_the_same(line):
    sent = line + b'\r\n'
    for at in range(len(sent) + 1):
        assert feed([sent[:at], sent[at:]]) == [MESSAGES[line]]
    assert feed([sent[i : i + 1] for i in range(len(sent))]) == [MESSAGES[line]]


@pytest.mark.parametrize('line', MESSAGES, ids=repr)
def test_message_among_noise_is_found(line):
    noise = b'\x00\xff\x80?'
    sent = noise + b'\n' + line + b'\r\n' + noise + b'\r' + line + b'\n' + noise
    assert feed([sent]) == [Malformed(noise), MESSAGES[line], Malformed(noise), MESSAGES[line]]


@pytest.mark.parametrize('line', MESSAGES, ids=repr)
def test_noise_inside_a_message_is_never_taken_for_another(line):
    for at in range(1, len(line)):
        assert parse(line[:at] + b'\xff' + line[at:]) == Malformed(line[:at] + b'\xff' + line[at:])


def test_endless_noise_is_cut():
    assembler = LineAssembler()
    lines = [line for _ in range(100) for line in assembler.feed(b'x' * 100)]
    assert len(lines) > 10
    assert len(assembler.rest) <= 612
    assert sum(map(len, lines)) + len(assembler.rest) == 10000


@given(st.lists(st.binary(max_size=40), max_size=20))
def test_any_bytes_in_any_portions_give_the_same_lines(portions):
    together = LineAssembler().feed(b''.join(portions))
    assembler = LineAssembler()
    assert [line for portion in portions for line in assembler.feed(portion)] == together
    assert all(isinstance(parse(line), grbl.Message) for line in together)


def test_errors_and_alarms_are_told_in_words():
    assert ErrorReply(20).meaning == 'error:20 (unsupported command or axis)'
    assert Alarm(3).meaning == 'ALARM:3 (reset while moving, position lost)'
    assert '99' in ErrorReply(99).meaning
    assert '77' in Alarm(77).meaning


def test_move_states_every_mode_it_depends_on():
    line = grbl.encode_move('X', 41.70857142857, 1800.0)
    assert line == b'G53G21G90G94G1X41.7086F1800.000\n'
    assert grbl.encode_move('A', -0.2, math.pi) == b'G53G21G90G94G1A-0.2000F3.142\n'
