"""Bytes from outside: whatever comes, no crash, no hang, no growing memory."""

from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import fuzz
from panodepth_ros.arm import grbl


@given(st.lists(st.binary(max_size=700), max_size=8))
@settings(max_examples=200, deadline=None)
def test_any_bytes_in_any_portions_are_lines_of_a_known_form(portions):
    assembler = grbl.LineAssembler()
    for portion in portions:
        fuzz.check_grbl(assembler, portion)


@given(st.binary(max_size=80))
@settings(max_examples=200, deadline=None)
def test_any_answer_of_a_servo_is_bytes_or_an_arm_error(answer):
    memory = fuzz.Memory()
    fuzz.check_dynamixel(fuzz.impatient_bus(memory), memory, answer)


def test_mutated_answers_of_both_controllers_do_no_harm():
    memory = fuzz.Memory()
    bus, assembler = fuzz.impatient_bus(memory), grbl.LineAssembler()
    fuzz.run(2000, lambda data: fuzz.check_grbl(assembler, data), fuzz.GRBL, seed=1)
    fuzz.run(2000, lambda data: fuzz.check_dynamixel(bus, memory, data), fuzz.DYNAMIXEL, seed=1)
