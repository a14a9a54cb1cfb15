"""
How well joint states of the steadily turning arm interpolate: against the simulated arm's truth.

The simulated arm is a process of its own on a pseudo-terminal, the driver runs here, beside as
many busy processes as asked for. Azimuths interpolated linearly between the states that the
driver tells are compared with where the arm truly was.

    python -m benchmarks.turning --speed 36 --load 2
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt

from panodepth_ros.arm.driver import GrblArm
from panodepth_ros.arm.errors import ArmStoppedError
from panodepth_ros.arm.interface import ArmState
from panodepth_ros.arm.truth import TruthError, TruthReader, truth_path

_BUSY = 'while True: pass'
#: States at the begin that are not compared: the arm speeds up, the line is short.
_SKIPPED = 40


def measure(link: str, speed: float, rate: float, seconds: float) -> list[ArmState]:
    """Turn the arm for a while; return what the driver told."""
    states: list[ArmState] = []
    arm = GrblArm(
        link,
        speed=speed,
        status_period=1.0 / rate,
        clock=time.monotonic_ns,
        listener=states.append,
    )

    def turn() -> None:
        with suppress(ArmStoppedError):
            arm.spin(lambda: speed, -1e4, 1e4, lambda: None)

    thread = threading.Thread(target=turn)
    thread.start()
    try:
        time.sleep(seconds)
    finally:
        arm.stop()
        thread.join()
        arm.close()
    return states


def errors(states: list[ArmState], truth: TruthReader) -> npt.NDArray[np.float64]:
    """Interpolated minus true azimuth, twenty times between two states [°]."""
    times = np.array([state.stamp * 1e-9 for state in states])
    azimuths = np.array([state.azimuth for state in states])
    at = np.linspace(times[0], times[-1], 20 * len(states))
    true = np.array([truth.azimuth(moment) for moment in at])
    off: npt.NDArray[np.float64] = np.degrees(np.interp(at, times, azimuths) - true)
    return off


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n', maxsplit=1)[0].strip())
    parser.add_argument('--speed', type=float, default=36.0, help='°/s')
    parser.add_argument('--rate', type=float, default=50.0, help='joint states per second')
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--load', type=int, default=0, help='busy processes beside')
    parser.add_argument('--arm', nargs='*', default=[], help="simulated_arm's options, without --")
    given = parser.parse_args()
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        link = str(Path(folder, 'arm'))
        options = [f'--{option}' for option in given.arm]
        program = [sys.executable, '-m', 'panodepth_ros.cli.simulated_arm', '--link', link]
        simulated = subprocess.Popen([*program, *options], stdout=subprocess.PIPE)
        stack.callback(simulated.wait)
        stack.callback(simulated.terminate)
        assert simulated.stdout is not None
        simulated.stdout.readline()
        for _ in range(given.load):
            stack.callback(subprocess.Popen([sys.executable, '-c', _BUSY]).kill)
        truth = TruthReader(truth_path(link))
        states = measure(link, np.radians(given.speed), given.rate, given.seconds)
        try:
            found = errors(states[_SKIPPED:-5], truth)
        except TruthError as error:
            sys.exit(f'the arm moved unsteadily: {error}')
    print(
        f'{given.speed:g} °/s, {given.rate:g} Hz, {given.load} busy processes: '
        f'{len(states)} states in {given.seconds:g} s; error of the interpolated azimuth: '
        f'mean {found.mean():+.4f}°, rms {np.sqrt(np.mean(found**2)):.4f}°, '
        f'99 % {np.percentile(np.abs(found), 99):.4f}°, largest {np.abs(found).max():.4f}°'
    )


if __name__ == '__main__':
    main()
