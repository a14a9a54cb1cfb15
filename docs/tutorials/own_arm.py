"""An arm of your own as one node: all that the mosaicer needs of it. See own_arm.md."""

import math
import sys
import time

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from panodepth_ros.arm.truth import Piece, TruthWriter

PERIOD = 0.02  # of reading the motor and publishing [s]


class Motor:
    """Stands for your motor: replace both methods. Here it turns at 30°/s."""

    def __init__(self) -> None:
        self.azimuth, self.target = 0.0, 0.0

    def turn_to(self, azimuth: float) -> None:
        """Begin to turn to an azimuth [rad], counter-clockwise positive, seen from above."""
        self.target = azimuth

    def read(self) -> tuple[float, bool]:
        """Return where the arm is [rad], and whether it stands and swings no more."""
        way = self.target - self.azimuth
        self.azimuth += math.copysign(min(abs(way), math.radians(30.0) * PERIOD), way)
        return self.azimuth, way == 0.0


class OwnArm(Node):
    """Publishes ``joint_states`` and answers ``arm_driver/step``."""

    def __init__(self) -> None:
        super().__init__('own_arm')
        step_deg = self.declare_parameter('step_deg', 0.2).value
        self._columns, self._steps = round(360.0 / step_deg), 0
        self._motor = Motor()
        self._joint_states = self.create_publisher(JointState, 'joint_states', 10)
        self.create_service(Trigger, 'arm_driver/step', self._on_step)
        self.create_timer(PERIOD, self._publish)
        # For the simulated camera alone, which must know where the arm is; leave it out.
        self._truth = TruthWriter(self.declare_parameter('truth', 'own_arm.truth').value)
        self._pieces = [Piece(-math.inf, 0.0)]
        self.get_logger().info('ready')

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._publish()  # the arm still stands: a frame counts between two such states only
        # Counted, so that rounding does not add up.
        self._steps += 1
        self._motor.turn_to(2.0 * math.pi * self._steps / self._columns)
        response.success = True
        return response

    def _publish(self) -> None:
        stamp = self.get_clock().now().to_msg()  # when the motor is read, not later
        azimuth, stands = self._motor.read()
        message = JointState(name=['panodepth_arm_joint'], position=[azimuth])
        message.header.stamp = stamp
        message.velocity = [0.0 if stands else math.radians(30.0)]
        self._joint_states.publish(message)
        if azimuth != self._pieces[-1].azimuth:
            self._pieces = [*self._pieces[-100:], Piece(time.monotonic(), azimuth)]
            self._truth.write(self._pieces)

    def destroy_node(self) -> None:
        """Close what the node holds."""
        self._truth.close()
        super().destroy_node()


def main() -> int:
    """Run the node."""
    rclpy.init()
    node = OwnArm()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
