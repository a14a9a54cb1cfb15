"""The arm driver: steps and steady turns of the arm as services, its measured azimuth as joint."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.task import Future
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from panodepth_ros.arm.cable import Cable
from panodepth_ros.arm.errors import (
    ArmConnectionError,
    ArmError,
    ArmStoppedError,
    ArmTimeoutError,
)
from panodepth_ros.arm.grid import StepGrid
from panodepth_ros.arm.interface import Arm, ArmState
from panodepth_ros.nodes.arm_settings import ArmDriverParameters, open_arm
from panodepth_ros.ros import answers, qos
from panodepth_ros.ros.diagnostics import ERROR, OK, WARN, Report, publish_diagnostics
from panodepth_ros.ros.parameters import declare_parameters
from panodepth_ros.ros.process import run_node

#: First and longest wait between two attempts to reopen a port that vanished [s].
_FIRST_BACKOFF, _LONGEST_BACKOFF = 0.5, 10.0
#: Executes a command on the arm and returns what to answer; may answer before by its argument.
Command = Callable[[Arm, Callable[[str], None]], str]


class ArmDriver(Node):
    """Drives the arm and publishes its azimuth. Topics, services and parameters: docs/nodes.md."""

    def __init__(self, **node_args: Any) -> None:
        self._arm: Arm | None = None  # first: the context may destroy a half-built node
        self._worker: threading.Thread | None = None
        self._ending = False
        super().__init__(
            'arm_driver', automatically_declare_parameters_from_overrides=True, **node_args
        )
        self._settings = declare_parameters(self, ArmDriverParameters, self._on_parameters)
        self._grid = StepGrid(self._settings.step)
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._running = ''  # name of the command that runs
        self._last_state: ArmState | None = None
        self._last_error = ''
        self._reported = ''  # trouble that was logged
        self._retry_at = 0.0
        self._backoff = _FIRST_BACKOFF
        self._joint_publisher = self.create_publisher(JointState, 'joint_states', qos.JOINT_STATES)
        try:
            self._arm = self._open()
            self._check_step(self._arm)
            if self._arm.doubt:
                self.get_logger().warning(f'{self._arm.doubt}; call ~/home')
            else:
                self._grid.begin(self._arm.measure().azimuth)
            group = ReentrantCallbackGroup()
            for name, callback in (
                ('step', self._on_step),
                ('home', self._on_home),
                ('unwind', self._on_unwind),
                ('stop', self._on_stop),
            ):
                self.create_service(Trigger, f'~/{name}', callback, callback_group=group)
            self.create_service(SetBool, '~/spin', self._on_spin, callback_group=group)
            publish_diagnostics(self, 'arm', self._diagnose)
            # A daemon, so that a signal between here and the first spin cannot leave it behind.
            self._worker = threading.Thread(target=self._work, name='arm worker', daemon=True)
            self._worker.start()
            self.get_logger().info(
                f'arm on port {self._settings.port} is ready; one step is '
                f'{math.degrees(self._settings.step):.7g}°'
            )
        except BaseException:
            self._close()
            raise

    def destroy_node(self) -> None:
        """Stop the arm, close the port, end the node. Idempotent."""
        self._close()
        super().destroy_node()

    # --- services -----------------------------------------------------------------------------

    async def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return await self._run('step', self._step, response)

    async def _on_home(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return await self._run('home', self._home, response)

    async def _on_unwind(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return await self._run('unwind', self._unwind, response)

    async def _on_spin(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        if request.data:
            return await self._run('spin', self._spin, response)
        if self._running == 'spin':
            return await self._on_stop(Trigger.Request(), response)
        response.success = not self._running
        response.message = (
            f'spin refused: the arm is executing {self._running}'
            if self._running
            else 'the arm was not turning'
        )
        return response

    async def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._arm is not None:
            with suppress(ArmError):  # the job below reports it
                self._arm.interrupt()
        return await self._run('stop', self._stop, response)

    async def _run(self, name: str, command: Command, response: Any) -> Any:
        """Have the worker execute a command; answer when it is done or says so."""
        if self._running and name != 'stop':
            response.message = f'{name} refused: the arm is executing {self._running}'
            return response
        arm = self._arm
        if arm is None:
            response.message = f'{name} failed: {self._last_error}'
            return response
        self._running = name
        done: Future = Future(executor=self.executor)

        def answer(message: str, success: bool = True) -> None:
            if not done.done():
                answers.give(self, done, (success, message))

        def job() -> None:
            success = True
            try:
                message = command(arm, answer)
            except ArmError as error:
                self._last_error = str(error)
                message, success = f'{name} failed: {error}', False
                if done.done() and not isinstance(error, ArmStoppedError):
                    self._report(message)
            if self._running == name:
                self._running = ''
            answer(message, success)

        self._jobs.put(job)
        response.success, response.message = await done
        return response

    # --- worker thread ------------------------------------------------------------------------

    def _work(self) -> None:
        while not self._ending and self.context.ok():
            try:
                job = self._jobs.get(timeout=1.0 / self._settings.status_rate)
            except queue.Empty:
                self._watch()
            else:
                if job is not None:
                    job()
        # A signal may have ended the process before anybody had the node to destroy.
        if self._arm is not None:
            self._arm.close()

    def _step(self, arm: Arm, _: Callable[[str], None]) -> str:
        here = self._last_state.azimuth if self._last_state is not None else 0.0
        index, target = self._grid.next(here)
        self._cable(arm).require(here, target)
        state = arm.move_to(target)
        self._grid.reached(index)
        return f'the arm stands at {math.degrees(state.azimuth):.3f}°'

    def _home(self, arm: Arm, _: Callable[[str], None]) -> str:
        self._grid.lose()
        state = arm.home()
        self._grid.begin(state.azimuth)
        self._reported = ''
        return f'the arm is home and stands at {math.degrees(state.azimuth):.3f}°'

    def _unwind(self, arm: Arm, _: Callable[[str], None]) -> str:
        here = arm.measure().azimuth
        target = self._cable(arm).unwound(here, self._settings.step)
        self._grid.lose()  # a sweep begins where the arm stands, also after a step that failed
        if target != here:
            here = arm.move_to(target).azimuth
        return f'the arm stands at {math.degrees(here):.3f}°'

    def _spin(self, arm: Arm, answer: Callable[[str], None]) -> str:
        self._grid.lose()
        limit = self._cable(arm).limit
        arm.spin(
            lambda: math.radians(self._settings.spin_speed_deg_s),
            -limit,
            limit,
            lambda: answer('the arm turns'),
        )

    def _stop(self, arm: Arm, _: Callable[[str], None]) -> str:
        state = arm.stop()
        if state is None:
            return f'the arm stands, but its position is uncertain: {arm.doubt}; call ~/home'
        return f'the arm stands at {math.degrees(state.azimuth):.3f}°'

    def _cable(self, arm: Arm) -> Cable:
        limit = math.radians(self._settings.cable_limit_deg)
        return Cable(limit, arm.farthest, arm.motor_step)

    def _watch(self) -> None:
        """Publish where the standing arm is; notice when it is in trouble; reopen its port."""
        arm = self._arm
        if arm is None:
            self._reopen()
            return
        try:
            arm.measure()
        except ArmStoppedError:
            pass  # a stop is next in the queue
        except (ArmConnectionError, ArmTimeoutError) as error:
            self._arm = None
            arm.close()
            self._backoff = _FIRST_BACKOFF
            self._retry_at = time.monotonic() + self._backoff
            self._report(f'{error}; trying to reopen it')
        except ArmError as error:
            self._report(str(error))
        else:
            self._reported = ''

    def _reopen(self) -> None:
        if time.monotonic() < self._retry_at:
            return
        try:
            arm = self._open()
        except ArmError as error:
            self.get_logger().debug(f'reopening failed: {error}')
            self._backoff = min(2.0 * self._backoff, _LONGEST_BACKOFF)
            self._retry_at = time.monotonic() + self._backoff
            return
        arm.distrust(f'connection on port {arm.port} was lost meanwhile')
        self._arm = arm
        self._report(f'port {arm.port} is open again; the position is uncertain, call ~/home')

    def _report(self, trouble: str) -> None:
        self._last_error = trouble
        if trouble != self._reported:
            self._reported = trouble
            self.get_logger().error(trouble)

    # --- arm ----------------------------------------------------------------------------------

    def _open(self) -> Arm:
        return open_arm(
            self._settings,
            lambda: int(self.get_clock().now().nanoseconds),
            self._publish_state,
        )

    def _check_step(self, arm: Arm) -> None:
        if abs(self._settings.step) < 0.999 * arm.motor_step:
            raise ValueError(
                f'step_deg is {self._settings.step_deg}: smaller than a motor step; allowed: '
                f'{math.degrees(arm.motor_step):.4g} and more on this arm'
            )
        if arm.advice:
            self.get_logger().warning(arm.advice)

    def _close(self) -> None:
        self._ending = True
        if self._arm is not None:
            self._arm.close()
        if self._worker is not None:
            self._jobs.put(None)
            self._worker.join()
        if self._arm is not None:  # reopened by the worker meanwhile
            self._arm.close()

    def _on_parameters(self, parameters: ArmDriverParameters) -> None:
        self._settings = parameters
        if self._arm is not None:
            self._arm.status_period = 1.0 / parameters.status_rate

    # --- topics -------------------------------------------------------------------------------

    def _publish_state(self, state: ArmState) -> None:
        self._last_state = state
        message = JointState(name=[self._settings.joint_name])
        message.header.stamp = Time(nanoseconds=state.stamp).to_msg()
        message.position = [state.azimuth]
        message.velocity = [state.velocity]
        try:
            self._joint_publisher.publish(message)
        except (rclpy_implementation.RCLError, rclpy_implementation.InvalidHandle):
            if self.context.ok():  # else the process is ending while the arm brakes
                raise

    def _diagnose(self) -> Report:
        arm, state = self._arm, self._last_state
        if arm is None:
            level, summary = ERROR, 'disconnected'
        elif arm.doubt:
            level, summary = ERROR, f'position uncertain: {arm.doubt}'
        elif self._reported:
            level, summary = WARN, self._reported
        else:
            level, summary = OK, self._running or 'standing'
        known = state is not None and level == OK
        values: dict[str, object] = {
            'port': self._settings.port,
            'position_deg': f'{math.degrees(state.azimuth):.3f}' if known and state else 'unknown',
            'last_error': self._last_error,
        }
        return Report(level, summary, values, self._settings.port)


def main(args: list[str] | None = None) -> int:
    """Run the arm driver; see :func:`panodepth_ros.ros.process.run_node`."""
    return run_node('arm_driver', ArmDriver, args)
