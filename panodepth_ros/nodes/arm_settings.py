"""Parameters of the arm driver, and the arm they describe."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from panodepth_ros.arm.driver import GrblArm
from panodepth_ros.arm.dynamixel import DynamixelArm
from panodepth_ros.arm.interface import Arm, ArmState
from panodepth_ros.ros.parameters import parameter

#: How far 360/step may be from a whole number.
_WHOLE_TURN = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmDriverParameters:
    """Parameters of the arm driver."""

    driver: str = parameter(
        'grbl', 'What drives the arm: a GRBL controller or a servo', choices=('grbl', 'dynamixel')
    )
    port: str = parameter(
        '/dev/ttyUSB0', 'Serial device of the arm, best /dev/serial/by-id/... to be found again'
    )
    baud_rate: int = parameter(115200, 'Speed of the serial line', bounds=(1200, 4000000))
    servo_id: int = parameter(1, 'Number of the servo on its bus', bounds=(0, 252))
    axis: str = parameter(
        'X',
        'Axis of the GRBL controller that turns the arm, its millimetres being degrees',
        choices=('X', 'Y', 'Z', 'A', 'B', 'C'),
    )
    reference: str = parameter(
        'controller',
        "How ~/home finds azimuth 0: by the controller's homing, or its count where it has none; "
        'or where a mark begins that a sensor at the probe input of a GRBL controller sees',
        choices=('controller', 'probe'),
    )
    step_deg: float = parameter(
        0.2,
        'Turn of one step, a whole fraction of 360; negative is clockwise',
        unit='°',
        bounds=(-180.0, 180.0),
    )
    speed_deg_s: float = parameter(
        30.0, "Largest speed; the controller's maximum limits it", unit='°/s', bounds=(0.1, 720.0)
    )
    settle_time: float = parameter(
        0.1, 'How long the arm swings after a motion', unit='s', bounds=(0.0, 10.0)
    )
    status_rate: float = parameter(
        10.0,
        'Rate of joint states, standing and moving; at least 10 while the arm turns steadily',
        unit='Hz',
        bounds=(0.1, 50.0),
        live=True,
    )
    response_timeout: float = parameter(
        1.0, 'Longest time for an answer of the controller', unit='s', bounds=(0.1, 60.0)
    )
    cable_limit_deg: float = parameter(
        0.0,
        'How far the cable lets the arm turn from 0 to each side, at least 180; 0 for an endless '
        'axis',
        unit='°',
        bounds=(0.0, 36000.0),
    )
    spin_speed_deg_s: float = parameter(
        36.0,
        'Speed of steady turning, at least 0.1; negative is clockwise',
        unit='°/s',
        bounds=(-720.0, 720.0),
        live=True,
    )
    joint_name: str = parameter('panodepth_arm_joint', "The arm's joint in joint_states")

    def __post_init__(self) -> None:
        steps = 360.0 / self.step_deg if self.step_deg else math.inf
        if math.isinf(steps) or abs(steps - round(steps)) > _WHOLE_TURN:
            raise ValueError(
                f'step_deg is {self.step_deg}: a turn of 360° would take {steps:.3f} steps; '
                'allowed: whole fractions of 360°, such as 0.2'
            )
        if 0.0 < self.cable_limit_deg < 180.0:
            raise ValueError(
                f'cable_limit_deg is {self.cable_limit_deg}; allowed: 0 for an endless axis, or '
                '180 and more, so that a whole turn has room'
            )
        if self.reference == 'probe':
            if self.driver != 'grbl':
                raise ValueError(
                    f'reference is probe; allowed with driver {self.driver}: controller'
                )
            if self.cable_limit_deg >= 360.0:
                raise ValueError(
                    f'cable_limit_deg is {self.cable_limit_deg} while reference is probe; '
                    'allowed: 0 for an endless axis, or less than 360, so that the mark comes once'
                )
        if abs(self.spin_speed_deg_s) < 0.1:
            raise ValueError(
                f'spin_speed_deg_s is {self.spin_speed_deg_s}; allowed: 0.1 to 720 °/s of either '
                'sign; call ~/spin or ~/stop to stop the arm'
            )

    @property
    def step(self) -> float:
        """One step [rad], exactly a whole fraction of a turn."""
        return 2.0 * math.pi / round(360.0 / self.step_deg)


def open_arm(
    settings: ArmDriverParameters,
    clock: Callable[[], int],
    listener: Callable[[ArmState], None],
) -> Arm:
    """
    Connect the arm.

    Parameters
    ----------
    settings : ArmDriverParameters
        Which and how.
    clock : callable
        Gives the stamps of states [ns].
    listener : callable
        Called with every state, in the thread of the command that measured it.

    Raises
    ------
    ArmError
        If the arm cannot be used.
    """
    if settings.driver == 'dynamixel':
        return DynamixelArm(
            settings.port,
            baud_rate=settings.baud_rate,
            servo_id=settings.servo_id,
            speed=math.radians(settings.speed_deg_s),
            settle_time=settings.settle_time,
            response_timeout=settings.response_timeout,
            status_period=1.0 / settings.status_rate,
            clock=clock,
            listener=listener,
        )
    return GrblArm(
        settings.port,
        baud_rate=settings.baud_rate,
        axis=settings.axis,
        index_within=(
            math.radians(settings.cable_limit_deg) if settings.reference == 'probe' else None
        ),
        speed=math.radians(settings.speed_deg_s),
        settle_time=settings.settle_time,
        response_timeout=settings.response_timeout,
        status_period=1.0 / settings.status_rate,
        clock=clock,
        listener=listener,
    )
