"""Bytes from outside: whatever comes, no crash, no hang, no growing memory."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import fuzz
from panodepth_ros.arm import grbl
from panodepth_ros.arm.errors import ArmProtocolError


@given(st.lists(st.binary(max_size=700), max_size=8))
@settings(max_examples=200)
def test_any_bytes_in_any_portions_are_lines_of_a_known_form(portions):
    assembler = grbl.LineAssembler()
    for portion in portions:
        fuzz.check_grbl(assembler, portion)


@given(st.binary(max_size=80))
@settings(max_examples=200)
def test_any_answer_of_a_servo_is_bytes_or_an_arm_error(answer):
    memory = fuzz.Memory()
    fuzz.check_dynamixel(fuzz.impatient_bus(memory), memory, answer)


def test_mutated_inputs_of_every_kind_do_no_harm(tmp_path):
    pytest.importorskip('rosbags', reason='bags need rosbags')
    kinds = fuzz.kinds(tmp_path)
    assert sum(kind.share for kind in kinds) == pytest.approx(1.0)
    for kind in kinds:
        with fuzz.silence():
            fuzz.run(round(5000 * kind.share), kind.check, kind.seeds, seed=1)


def test_fuzzed_servo_answers_reach_the_values():
    memory = fuzz.Memory()
    bus = fuzz.impatient_bus(memory)
    memory.answer = fuzz.sealed(fuzz.DYNAMIXEL[0])
    assert bus.read_block(122, 14) == bytes(14)
    memory.answer = fuzz.sealed(fuzz.DYNAMIXEL[0][:-2])
    with pytest.raises(ArmProtocolError, match='with 12 bytes instead of 14'):
        bus.read_block(122, 14)


def test_noise_without_an_end_of_line_does_not_fill_the_memory():
    assembler = grbl.LineAssembler()
    for _ in range(100):
        fuzz.check_grbl(assembler, b'x' * 100)
