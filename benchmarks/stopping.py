"""
How long ``~/stop`` takes: from the call of the service until the simulated arm truly stands.

Simulated arm and arm_driver are processes of their own; the arm is stopped in a step, in a
steady turn and while it searches its switch, beside as many busy processes as asked for.

    python -m benchmarks.stopping --times 5 --load 2
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import rclpy
from std_srvs.srv import SetBool, Trigger

from panodepth_ros.arm.truth import TruthReader, truth_path
from panodepth_ros.cli.domain import claimed_domain

_BUSY = 'while True: pass'
_TIMEOUT = 60.0
#: The truth is looked at in steps of this time [s].
_GRAIN = 1e-3


class Rig:
    """The services of an arm driver and the truth of its arm."""

    def __init__(self, node: Any, truth: TruthReader) -> None:
        self._node = node
        self._truth = truth
        self._clients = {
            name: node.create_client(SetBool if name == 'spin' else Trigger, f'arm_driver/{name}')
            for name in ('step', 'spin', 'home', 'stop')
        }
        for client in self._clients.values():
            if not client.wait_for_service(_TIMEOUT):
                sys.exit(f'the service {client.srv_name} did not come within {_TIMEOUT:g} s')

    def begin(self, name: str) -> Any:
        """Call a service; return the future answer."""
        request = SetBool.Request(data=True) if name == 'spin' else Trigger.Request()
        return self._clients[name].call_async(request)

    def wait(self, answer: Any) -> None:
        """Wait for an answer."""
        rclpy.spin_until_future_complete(self._node, answer, timeout_sec=_TIMEOUT)

    def moves(self, moment: float) -> bool:
        """Whether the arm truly moves at a time of ``time.monotonic()`` [s]."""
        return self._truth.azimuth(moment) != self._truth.azimuth(moment + _GRAIN)

    def stop_within(self, motion: str) -> float:
        """Begin a motion, stop it on its way; return how long that took [s]."""
        answer = self.begin(motion)
        deadline = time.monotonic() + _TIMEOUT
        while not self.moves(time.monotonic()):
            rclpy.spin_once(self._node, timeout_sec=0.01)
            if time.monotonic() > deadline:
                sys.exit(f'{motion} did not begin: {answer.result() if answer.done() else ""}')
        time.sleep(0.5)
        asked = time.monotonic()
        self.wait(self.begin('stop'))
        self.wait(answer)
        end = time.monotonic()
        if self.moves(end):
            sys.exit(f'the arm still moves after stop in {motion}')
        stands = end
        while stands > asked and not self.moves(stands - _GRAIN):
            stands -= _GRAIN
        return stands - asked


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n', maxsplit=1)[0].strip())
    parser.add_argument('--times', type=int, default=5)
    parser.add_argument('--load', type=int, default=0, help='busy processes beside')
    given = parser.parse_args()
    with ExitStack() as stack:
        domain = stack.enter_context(claimed_domain())
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        link = str(Path(folder, 'arm'))
        program = [sys.executable, '-m', 'panodepth_ros.cli.simulated_arm']
        program += ['--link', link, '--homing']
        simulated = subprocess.Popen(program, stdout=subprocess.PIPE)
        stack.callback(simulated.wait)
        stack.callback(simulated.terminate)
        assert simulated.stdout is not None
        simulated.stdout.readline()
        settings = {'port': link, 'step_deg': 120.0, 'settle_time': 1.0}
        code = 'import sys; from panodepth_ros.nodes.arm_driver import main; sys.exit(main())'
        arguments = [word for item in settings.items() for word in ('-p', '{}:={}'.format(*item))]
        driver = subprocess.Popen(
            [sys.executable, '-c', code, '--ros-args', *arguments],
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain)},
        )
        stack.callback(driver.wait)
        stack.callback(driver.terminate)
        for _ in range(given.load):
            stack.callback(subprocess.Popen([sys.executable, '-c', _BUSY]).kill)
        rclpy.init(args=[], domain_id=domain)
        stack.callback(rclpy.try_shutdown)
        rig = Rig(rclpy.create_node('stopping'), TruthReader(truth_path(link)))
        rig.wait(rig.begin('home'))
        for motion in ('step', 'spin', 'home'):
            took = []
            for _ in range(given.times):
                if motion == 'home':  # away from the switch first
                    rig.wait(rig.begin('home'))
                    rig.wait(rig.begin('step'))
                took.append(rig.stop_within(motion))
            print(
                f'stop in {motion}, {given.load} busy processes: the arm stands after '
                f'{min(took) * 1e3:.0f} to {max(took) * 1e3:.0f} ms ({given.times} times)'
            )


if __name__ == '__main__':
    main()
