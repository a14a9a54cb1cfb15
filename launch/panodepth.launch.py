"""Start the node graph, on a simulated or a real rig."""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'panodepth_ros'
NODES = ('arm_driver', 'camera', 'mosaicer', 'depth')


def _parameter_file(context: LaunchContext) -> PathJoinSubstitution | str:
    given = LaunchConfiguration('params_file').perform(context)
    simulated = LaunchConfiguration('simulated').perform(context).lower() in ('true', '1')
    name = 'simulated.yaml' if simulated else 'real.yaml'
    return given or PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', name])


def _nodes(context: LaunchContext) -> list[Node]:
    return [
        Node(
            package=PACKAGE,
            executable=name,
            namespace=LaunchConfiguration('namespace'),
            parameters=[_parameter_file(context)],
            output='screen',
        )
        for name in NODES
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the launch description."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'simulated', default_value='true', description='true: the paper’s rig, simulated'
            ),
            DeclareLaunchArgument(
                'params_file',
                default_value='',
                description='Parameters of the nodes (default: config/simulated.yaml, real.yaml)',
            ),
            DeclareLaunchArgument('namespace', default_value='', description='Namespace'),
            Node(
                package=PACKAGE,
                executable='simulated_arm',
                arguments=['--link', '/tmp/panodepth_arm'],
                output='screen',
                condition=IfCondition(LaunchConfiguration('simulated')),
            ),
            OpaqueFunction(function=_nodes),
        ]
    )
