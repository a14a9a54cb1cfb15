"""Accuracy of the scan of a steadily turning arm; docs/continuous.md has a run."""

from __future__ import annotations

import argparse
import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from benchmarks.report import table
from benchmarks.stripes import (
    ARM_RADIUS,
    COLUMNS,
    FIELD_OF_VIEW,
    Image,
    bands,
    look,
    measure,
    noisy,
    panorama_scores,
)
from panodepth_ros.analysis.evaluation import DepthScore, ScanScore
from panodepth_ros.camera.simulated import Room, RoomCamera, furnished_room
from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic import ArmMotion, ContinuousAssembler, Rig, Sweep
from panodepth_ros.mosaic.clock import DelayEstimate, estimate_delay

#: Joint states per second, and how far the arm goes beyond a turn [rad].
JOINT_RATE, BEYOND = 50.0, 0.05
#: Exposures measured [s]: at 36 °/s the arm turns by 0.1, 0.5, 1.8 and 5.4 columns meanwhile.
EXPOSURES = 0.0006, 0.003, 0.01, 0.03
#: A rolling shutter's rows are rendered in so many groups, each exposed at once.
ROW_GROUPS = 120
#: An exposure is the mean of moments between which the picture moves by no more [px].
BLUR_STEP = 1.0
#: Eyes this far from the centre, as a share of the width, leave room for the widest stripes.
OFFSET_SHARE = 66 / 160
#: Stripes join at this distance [m], and are so many times the way between two frames.
STRIPE_DISTANCE, STRIPE_SHARE = 2.0, 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """
    How the arm turns and the camera sees.

    Attributes
    ----------
    turn_time : float
        Of a full turn [s].
    framerate : float
        [Hz].
    jitter : float
        Standard deviation of the frames' stamps [s].
    delay : float
        How much later frames are exposed than their stamps say [s].
    exposure : float
        How long a frame is exposed [s]; its stamp tells the middle.
    shutter : float
        How long the rows of a frame are exposed one after the other [s]; 0 if all at once.
    known : bool
        Whether the assembler knows delay and shutter.
    """

    turn_time: float = 10.0
    framerate: float = 30.0
    jitter: float = 0.0
    delay: float = 0.0
    exposure: float = 0.0
    shutter: float = 0.0
    known: bool = False

    @property
    def velocity(self) -> float:
        """[rad/s]."""
        return 2 * math.pi / self.turn_time

    @property
    def stripe(self) -> int:
        """Columns of a stripe: a divisor of a turn's, so that a frame reaches its neighbours."""
        way = STRIPE_SHARE * COLUMNS / self.turn_time / self.framerate
        return next(n for n in range(1, COLUMNS + 1) if COLUMNS % n == 0 and n >= way)


def exposed(
    room: Room, lens: RoomCamera, moment: float, case: Case, velocity: float, seen: list[slice]
) -> Image:
    """Frame the middle of whose exposure, in the middle row, is a moment; without noise."""
    turn = abs(velocity) * case.exposure
    parts = 1 + math.ceil(turn * lens.fx / BLUR_STEP)
    times = moment + case.exposure * ((np.arange(parts) + 0.5) / parts - 0.5)
    parts_seen = [_at_once(room, lens, float(time), case, velocity, seen) for time in times]
    return np.asarray(np.mean(parts_seen, axis=0, dtype=np.float32))


def _at_once(
    room: Room, lens: RoomCamera, moment: float, case: Case, velocity: float, seen: list[slice]
) -> Image:
    """Frame of no exposure time whose middle row is seen at a moment."""
    if not case.shutter:
        return look(room, lens, velocity * moment, seen)
    rows, together = [], max(1, lens.height // ROW_GROUPS)
    for v in range(0, lens.height, together):
        some = dataclasses.replace(lens, height=together, cy=lens.cy - v)
        late = (v - 0.5 * (lens.height - together)) * case.shutter / lens.height
        rows.append(look(room, some, velocity * (moment + late), seen))
    return np.concatenate(rows)


def sweep(room: Room, lens: RoomCamera, offset: float, case: Case, direction: float) -> Sweep:
    """One turn, from frames and joint states as a camera and an arm would publish them."""
    rng = np.random.default_rng(1)
    rig = Rig(
        arm_radius=ARM_RADIUS,
        column_offset=offset,
        columns=COLUMNS,
        sweep_columns=COLUMNS,
        stripe_columns=case.stripe,
        stripe_distance=STRIPE_DISTANCE if case.stripe > 1 else math.inf,
    )
    known = case if case.known else Case()
    motion = ArmMotion(round(1e9))
    builder = ContinuousAssembler(
        rig, motion, round(known.delay * 1e9), known.shutter / lens.height
    )
    camera = PinholeCamera(**{n: getattr(lens, n) for n in RoomCamera.__slots__})
    builder.set_camera(camera)
    seen = bands(rig, camera, 0.5 * case.velocity * case.shutter)
    velocity = direction * case.velocity
    duration = case.turn_time * (1 + BEYOND)
    events: list[tuple[float, float | None]] = [
        (k / JOINT_RATE, None) for k in range(round(duration * JOINT_RATE) + 10)
    ]
    stamps = np.arange(0.1, duration, 1 / case.framerate)
    events += [(float(stamp + rng.normal(0, case.jitter)), float(stamp)) for stamp in stamps]
    begin = 10**12
    for time, frame in sorted(events, key=lambda event: event[0]):
        if frame is None:
            done = builder.add_joint_state(begin + round(time * 1e9), velocity * time, None)
        else:
            image = exposed(room, lens, frame + case.delay, case, velocity, seen)
            done = builder.add_frame(begin + round(time * 1e9), noisy(image, rng))
        if done:
            return done[0]
    raise RuntimeError('the turn was not finished')


def both_ways(room: Room, lens: RoomCamera, offset: float, case: Case) -> DelayEstimate:
    """Delay estimated from a turn to either side."""
    turns = [sweep(room, lens, offset, case, direction) for direction in (1.0, -1.0)]
    forward, backward = (turn.panoramas()['center'] for turn in turns)
    return estimate_delay(forward, backward, (turns[0].velocity, turns[1].velocity))


def line(name: str, frames: str, depth: DepthScore, scan: ScanScore) -> list[str]:
    """One row of the table."""
    shares = (scan.coverage, scan.within_5_percent, scan.too_far, scan.too_near)
    return [
        name,
        frames,
        f'{100 * depth.median_error:.2f}',
        f'{100 * depth.wrong:.1f}',
        *(f'{100 * share:.1f}' for share in shares),
    ]


def cases() -> dict[str, Case]:
    """What is measured, by name."""
    turns = {f'{t:g} s a turn': Case(turn_time=t) for t in (10.0, 20.0, 60.0)}
    rates = {f'10 s, {f:g} Hz': Case(framerate=f) for f in (15.0, 60.0)}
    jitters = {f'10 s, jitter {1e3 * j:g} ms': Case(jitter=j) for j in (0.001, 0.005)}
    delays = {f'10 s, delay {1e3 * d:g} ms': Case(delay=d) for d in (0.01, 0.05)}
    exposures = {f'10 s, exposed for {1e3 * e:g} ms': Case(exposure=e) for e in EXPOSURES}
    rolling = Case(shutter=0.024)
    shutters = {
        '10 s, rolling shutter of 24 ms, not told': rolling,
        '10 s, rolling shutter of 24 ms': dataclasses.replace(rolling, known=True),
    }
    return turns | rates | jitters | delays | exposures | shutters


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--width', type=int, default=160, help='of the frames, in pixels')
    parser.add_argument('--seed', type=int, default=1, help='which room')
    parser.add_argument('--only', help='cases whose name contains this')
    chosen = parser.parse_args()
    lens = RoomCamera.from_field_of_view(chosen.width, chosen.width * 3 // 4, FIELD_OF_VIEW)
    offset = OFFSET_SHARE * chosen.width
    room = furnished_room(chosen.seed)
    rows = []
    if not chosen.only or chosen.only in 'stop and go':
        stopped = measure(room, lens, offset, 1, math.inf)
        rows = [line('stop and go', str(stopped.frames), stopped.depths[0], stopped.scans[0])]
    for name, case in cases().items():
        if chosen.only and chosen.only not in name:
            continue
        done = sweep(room, lens, offset, case, 1.0)
        depth, scan = panorama_scores(room, done.panoramas())
        rows.append(line(name, str(round(case.turn_time * case.framerate)), depth, scan))
    head = ['', 'frames', 'median error %', 'wrong %', 'coverage %', 'within 5 %']
    print(table([*head, 'too far %', 'too near %'], rows))
    for name, case in cases().items():
        if case.delay and (not chosen.only or chosen.only in name):
            found = both_ways(room, lens, offset, case)
            print(
                f'\ndelay of {1e3 * case.delay:g} ms, from a turn to either side: '
                f'{1e3 * found.delay:.2f} ms ± {1e3 * found.stddev:.2f} ms'
            )


if __name__ == '__main__':
    main()
