"""Light that changes in a sweep: steps of all pixels are removed, parts of the view are marked."""

import math

import numpy as np
import pytest

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic import Rig, Sweep
from panodepth_ros.mosaic.steady import SteadySweep

COLUMNS, WIDTH, HEIGHT = 180, 96, 64
STEP = 2 * math.pi / COLUMNS
CAMERA = PinholeCamera(width=WIDTH, height=HEIGHT, fx=100.0, fy=100.0, cx=47.5, cy=31.5)


def rig(column_offset=30.0, **values):
    return Rig(
        arm_radius=0.3,
        column_offset=column_offset,
        columns=COLUMNS,
        sweep_columns=COLUMNS,
        mends_light=True,
        **values,
    )


def scene(azimuth):
    """Grey levels of far away things in a frame, smooth and with edges."""
    rng = np.random.default_rng(4)
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    bearing = azimuth - np.arctan((u - 47.5) / 100.0)
    along, up = rng.integers(2, 40, 25), rng.uniform(-25, 25, 25)
    slope = (31.5 - v) / 100.0
    waves = along[:, None, None] * bearing + up[:, None, None] * slope
    level = 110 + 14 * np.cos(waves + rng.uniform(0, 6.28, 25)[:, None, None]).sum(axis=0) / 2
    level += 25 * np.sign(np.cos(7 * bearing)) * (slope > 0)
    return np.clip(level, 20, 200)[..., np.newaxis] * np.array([0.8, 1.0, 1.1])


def swept(gain=lambda k: 1.0, change=None, direction=1, rig=rig, noise=1.5):
    """A turn with gains of its frames, and with changes of them."""
    sweep, rng = Sweep(rig(), CAMERA, 0.3), np.random.default_rng(2)
    for k in range(sweep.rig.sweep_steps):
        azimuth = 0.3 + direction * k * sweep.rig.column_step
        frame = scene(azimuth) * np.asarray(gain(k))
        if change is not None:
            frame = change(k, azimuth, frame)
        noisy = np.rint(frame + rng.normal(0, noise, frame.shape))
        sweep.add(k + 1, np.clip(noisy, 0, 255).astype(np.uint8), azimuth)
    return sweep


def without(values):
    """The same rig, without looking at the light."""
    return Rig(
        arm_radius=0.3, column_offset=30.0, columns=COLUMNS, sweep_columns=COLUMNS, **values
    )


@pytest.mark.parametrize('direction', [1, -1])
@pytest.mark.parametrize('noise', [0.0, 1.5, 5.0])
def test_sweep_in_steady_light_stays_as_it_is_to_the_bit(direction, noise):
    sweep = swept(direction=direction, noise=noise)
    plain = swept(direction=direction, noise=noise, rig=lambda: without({}))
    assert (sweep.light_steps()[0] == 1.0).all()
    for name, panorama in sweep.panoramas().items():
        other = plain.panoramas()[name]
        assert np.array_equal(panorama.image, other.image)
        assert np.array_equal(panorama.geometry.ray_angle, other.geometry.ray_angle)


@pytest.mark.parametrize('closing', [False, True])
@pytest.mark.parametrize('direction', [1, -1])
def test_steps_of_the_gain_are_removed(direction, closing):
    def gain(k):
        return 1.0 if k < 50 else 0.75 if k < 120 else np.array([0.9, 1.0, 1.15])

    def closes():
        return rig(closes=closing, closing_frame=closing)

    sweep, steady = swept(gain, direction=direction, rig=closes), swept(direction=direction)
    gains = sweep.light_steps()[0]
    expected = np.array([gain(k) * np.ones(3) for k in range(COLUMNS + closing)])
    # One factor from cells of 8 x 8 pixels is told to a percent.
    assert gains == pytest.approx(expected, abs=0.015)
    mended, true = sweep.panoramas(), steady.panoramas()
    for name, panorama in mended.items():
        off = np.abs(panorama.image.astype(float) - true[name].image).mean(axis=(0, 2))
        assert off.max() < 4.0
        assert panorama.geometry.seen.all()


def coarse():
    """Steps of 5° displace a frame by a tenth: what comes into view hides a step of the gain."""
    columns = {'columns': 72, 'sweep_columns': 72}
    return Rig(
        arm_radius=0.3,
        column_offset=30.0,
        mends_light=True,
        closes=True,
        closing_frame=True,
        **columns,
    )


@pytest.mark.parametrize('factor', [0.72, 0.9, 1.1, np.array([0.9, 1.0, 1.15])])
@pytest.mark.parametrize('at', [1, 10, 40, 72])
def test_step_that_is_hidden_is_told_by_the_frame_at_360(factor, at):
    sweep = swept(lambda k: 1.0 if k < at else factor, rig=coarse)
    gains, changes = sweep.light_steps()
    expected = np.array([(1.0 if k < at else factor) * np.ones(3) for k in range(73)])
    assert gains == pytest.approx(expected, abs=0.01)
    assert not changes


def lit_beginning(k, azimuth, frame):
    """A lamp that lights only what the first frame has seen, long after that."""
    bearing = azimuth - np.arctan((np.arange(WIDTH) - 47.5) / 100.0)
    off = np.remainder(bearing - 0.3 + math.pi, 2 * math.pi) - math.pi
    return frame * np.where((k > 30) & (np.abs(off) < 0.5), 1.2, 1.0)[np.newaxis, :, np.newaxis]


@pytest.mark.parametrize(
    'change',
    [
        lambda _k, _azimuth, frame: frame,
        lambda k, _, frame: frame * (1.0 - 0.15 * k / 72),
        lit_beginning,
    ],
    ids=['nothing', 'a drift', 'a lamp at the seam'],
)
def test_what_is_no_step_is_not_taken_for_a_hidden_one(change):
    assert (swept(change=change, rig=coarse).light_steps()[0] == 1.0).all()


@pytest.mark.parametrize(('lit', 'shade'), [(2.0, 0.0), (1.5, 0.8)])
def test_dark_part_of_a_turn_makes_no_steps_of_the_rest(lit, shade):
    """Few cells that are not dark tell no gain, and dark frames not how much others scatter."""

    def night(_, azimuth, frame):
        off = np.remainder(azimuth - np.arctan((np.arange(WIDTH) - 47.5) / 100.0) - 0.3, math.tau)
        level = np.where(off < lit, 1.0 - shade * (np.sin(9 * off) > 0), 0.05)
        return frame * level[np.newaxis, :, np.newaxis]

    gains, changes = swept(change=night, rig=coarse).light_steps()
    assert (gains == 1.0).all()
    assert not changes


def test_steps_of_the_gain_are_removed_from_columns_between_two_frames():
    wide = {'column_offset': 26.0, 'stripe_columns': 2}
    panoramas = []
    for darker in (1.0, 0.6):
        sweep = SteadySweep(rig(**wide), CAMERA, 0.0)
        for k in range(60):
            azimuth = 0.6 * k * STEP
            frame = scene(azimuth) * (darker if k >= 33 else 1.0)
            sweep.add(k + 1, np.clip(np.rint(frame), 0, 255).astype(np.uint8), azimuth)
        assert sweep.light_steps()[0][-1] == pytest.approx(darker, abs=0.01)
        panoramas.append(sweep.panoramas())
    for name, panorama in panoramas[1].items():
        off = np.abs(panorama.image.astype(float) - panoramas[0][name].image).mean(axis=(0, 2))
        assert off.max() < 2.0


def test_gain_that_stays_does_not_drift_over_a_turn():
    sweep = swept(lambda k: 1.0 if k < 90 else 0.8)
    assert sweep.light_steps()[0][-1] == pytest.approx(0.8 * np.ones(3), abs=0.005)


def test_what_has_changed_between_the_eyes_is_unknown():
    lit = 0.3 + 90 * STEP  # where the arm looks as the lamp goes on

    def lamp(k, azimuth, frame):
        bearing = azimuth - np.arctan((np.arange(WIDTH) - 47.5) / 100.0)
        near = np.abs(np.remainder(bearing - lit + math.pi, 2 * math.pi) - math.pi) < 0.1
        return frame * np.where((k >= 90) & near, 1.7, 1.0)[np.newaxis, :, np.newaxis]

    sweep = swept(change=lamp)
    assert (sweep.light_steps()[0] == 1.0).all()
    ((arm_azimuth, least, largest),) = sweep.light_steps()[1]
    assert arm_azimuth == pytest.approx(lit)
    assert (least, largest) == pytest.approx((-0.1, 0.1), abs=0.03)
    for panorama in sweep.panoramas().values():
        seen = panorama.geometry.seen
        assert 7 <= (~seen).sum() <= 9  # 0.2 rad are 6, and one to each side
        assert not panorama.image[:, ~seen].any()


def test_who_walks_across_the_view_is_noticed():
    """A dark body comes into view at the left, crosses it in four frames, and is gone."""

    def walker(k, _, frame):
        at = 26 * (k - 90)
        if 0 <= at < WIDTH:
            frame[10:, at : at + 26] = 20.0
        return frame

    sweep = swept(change=walker)
    gains, changes = sweep.light_steps()
    assert (gains == 1.0).all()
    azimuths = np.array([(azimuth - 0.3) / STEP for azimuth, _, _ in changes])
    assert azimuths.round().astype(int).tolist() == [90, 91, 92, 93]
    for panorama in sweep.panoramas().values():
        assert 10 < (~panorama.geometry.seen).sum() < 40


def test_change_beyond_both_eyes_harms_nothing():
    # The eyes are 20 px to the sides of the middle.
    lit = np.where(np.arange(WIDTH) > 72, 1.8, 1.0)[np.newaxis, :, np.newaxis]
    sweep = swept(
        change=lambda k, _, frame: frame * lit if k == 90 else frame,
        rig=lambda: rig(column_offset=20.0),
    )
    assert sweep.light_steps()[1]
    assert all(panorama.geometry.seen.all() for panorama in sweep.panoramas().values())


@pytest.mark.parametrize('closing', [False, True])
def test_light_of_what_the_arm_looks_at_is_no_gain(closing):
    lit = 0.3 + 90 * STEP

    def lamp(k, azimuth, frame):
        bearing = azimuth - np.arctan((np.arange(WIDTH) - 47.5) / 100.0)
        off = np.remainder(bearing - lit + math.pi, 2 * math.pi) - math.pi
        more = 0.6 * np.exp(-((off / 0.6) ** 2)) * (k >= 90)
        return frame * (1.0 + more)[np.newaxis, :, np.newaxis]

    sweep = swept(change=lamp, rig=lambda: rig(closes=closing, closing_frame=closing))
    gains, changes = sweep.light_steps()
    assert (gains == 1.0).all()
    assert [at for at, _, _ in changes] == pytest.approx([lit])
    # The eyes look 0.29 rad to both sides: 16.7 columns of 2 degrees.
    for panorama in sweep.panoramas().values():
        assert (~panorama.geometry.seen).sum() == pytest.approx(17, abs=1)


def test_frames_without_overlap_tell_nothing():
    sweep = Sweep(rig(), CAMERA, 0.0)
    for k in range(0, 40, 15):  # 30° of 51°
        sweep.add(k, scene(k * STEP).astype(np.uint8) // (1 + k), k * STEP)
    assert (sweep.light_steps()[0] == 1.0).all()
    assert not sweep.light_steps()[1]
