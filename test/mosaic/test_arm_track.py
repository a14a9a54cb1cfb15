"""Standstills out of joint states."""

import pytest

from panodepth_ros.mosaic import ArmTrack, Standstill

MS = 1_000_000


def track(*states, tolerance=1e-4, gap_ms=1000):
    built = ArmTrack(tolerance, gap_ms * MS)
    for ms, position, velocity in states:
        built.add(ms * MS, position, velocity)
    return built


#: Standing since before the record, a step from 10 to 30 ms, standing from 40 ms on.
STEP = [(0, 0.0, 0.0), (10, 0.0, 0.0), (20, 0.001, 0.1), (40, 0.0035, 0.0), (60, 0.0035, 0.0)]


def test_frame_between_two_equal_standing_states_has_their_azimuth():
    place = track(*STEP).at(50 * MS)
    assert isinstance(place, Standstill)
    assert (place.azimuth, place.start, place.end) == (0.0035, 40 * MS, 60 * MS)


def test_frame_at_the_very_stamp_of_a_state_belongs_to_it():
    assert track(*STEP).at(40 * MS).azimuth == 0.0035


def test_frame_of_an_arm_not_seen_to_arrive_is_not_placed():
    assert track(*STEP).at(5 * MS) == 'arm was not seen to arrive'


@pytest.mark.parametrize('ms', [11, 20, 39])
def test_frame_exposed_while_the_arm_moved_is_not_placed(ms):
    assert track(*STEP).at(ms * MS) == 'arm moved'


def test_frame_newer_than_the_joint_states_has_to_wait():
    assert track(*STEP).at(61 * MS) is None
    assert track().at(0) is None


def test_frame_older_than_the_joint_states_is_not_placed():
    assert track(*STEP).at(-1 * MS) == 'no joint state near its stamp'


def test_silence_of_the_joint_states_is_not_taken_for_standing():
    silent = track(*STEP, (2000, 0.0035, 0.0), (2010, 0.0035, 0.0))
    assert silent.at(1000 * MS) == 'no joint state near its stamp'
    assert silent.at(2005 * MS).arrived


def test_silence_of_a_standing_arm_is_no_arrival():
    silent = track((0, 0.0, 0.0), (10, 0.0, 0.0), (2000, 0.0, 0.0), (2010, 0.0, 0.0))
    assert silent.at(2005 * MS) == 'arm was not seen to arrive'


def test_another_position_after_a_silence_is_an_arrival():
    silent = track((0, 0.0, 0.0), (2000, 0.1, 0.0), (2010, 0.1, 0.0))
    assert silent.at(2005 * MS).azimuth == 0.1


def test_longest_gap_and_tolerance_are_included():
    built = track((0, 0.0, 0.5), (10, 0.5, 0.0), (1010, 0.5, 0.0), tolerance=0.25)
    assert built.at(500 * MS).start == 10 * MS
    built.add(1020 * MS, 0.75, 0.0)
    assert built.at(1015 * MS).start == 10 * MS


def test_positions_alone_tell_of_an_arm_without_velocity():
    states = [(0, 0.0, None), (10, 0.0, None), (20, 0.1, None), (30, 0.2, None), (40, 0.2, None)]
    built = track(*states)
    assert built.at(5 * MS) == 'arm was not seen to arrive'
    assert built.at(15 * MS) == 'arm moved'
    assert built.at(25 * MS) == 'arm moved'
    assert built.at(35 * MS).azimuth == 0.2


def test_change_within_the_tolerance_is_standing():
    built = track((0, 0.0, 0.5), (10, 0.1, 0.0), (20, 0.10005, 0.0), (30, 0.1002, 0.0))
    assert built.at(15 * MS).azimuth == 0.1
    assert built.at(25 * MS) == 'arm moved'


def test_current_standstill_ends_with_the_first_motion():
    built = track(*STEP)
    assert built.current.start == 40 * MS
    built.add(70 * MS, 0.0036, 0.1)
    assert built.current is None
    assert (built.newest, built.position) == (70 * MS, 0.0036)


@pytest.mark.parametrize('ms', [60, 59])
def test_state_out_of_order_or_twice_is_refused(ms):
    with pytest.raises(ValueError, match='out of order'):
        track(*STEP).add(ms * MS, 0.0, 0.0)


@pytest.mark.parametrize(('position', 'velocity'), [(float('nan'), 0.0), (0.0, float('inf'))])
def test_state_that_is_not_finite_is_refused(position, velocity):
    with pytest.raises(ValueError, match='position'):
        track(*STEP).add(100 * MS, position, velocity)


def test_memory_of_old_standstills_is_bounded():
    built = track(gap_ms=10**6)
    for k in range(1000):
        built.add(k * 1000 * MS, k * 0.1, 0.0)
    assert len(built._standstills) == 31  # 30 s and the newest
    assert built.at(967_999 * MS) == 'no joint state near its stamp'
    assert built.at(969_000 * MS).azimuth == pytest.approx(96.9)
