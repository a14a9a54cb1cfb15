"""Start the node graph, on a simulated or a real rig."""

from __future__ import annotations

import os

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
    Shutdown,
    TimerAction,
)
from launch.event_handlers import OnProcessIO
from launch.events.process import ProcessExited
from launch.some_substitutions_type import SomeSubstitutionsType
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import ExecutableInPackage, FindPackageShare

PACKAGE = 'panodepth_ros'
NODES = ('arm_driver', 'camera', 'mosaicer', 'depth')
#: Time after which a killed node is started again [s].
RESPAWN_DELAY = 1.0
#: What Fast DDS of Jazzy, and of Kilted and later, reads its profile from.
PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
#: Where config/simulated.yaml expects the simulated arm.
LINK = '/tmp/panodepth_arm'


def _mount(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the static transform of the scan's frame on the robot, if a mount is given."""
    mount = LaunchConfiguration('mount').perform(context).split()
    if not mount:
        return []
    if len(mount) != 4:
        raise ValueError(
            f'mount is {" ".join(mount)!r}; allowed: x y z yaw, in metres and radians'
        )
    x, y, z, yaw = (str(float(value)) for value in mount)
    return [
        Node(
            package='tf2_ros',
            executable='static_transform_publisher',
            name='panodepth_mount',
            arguments=[
                *('--x', x, '--y', y, '--z', z, '--yaw', yaw),
                *('--frame-id', LaunchConfiguration('base_frame')),
                *('--child-frame-id', LaunchConfiguration('scan_frame')),
            ],
        )
    ]


def _node(name: str, parameters: SomeSubstitutionsType) -> Node:
    """Return a node that is started again if a signal kills it, but not if it ends by itself."""

    def on_exit(
        event: ProcessExited, context: LaunchContext
    ) -> list[LaunchDescriptionEntity] | None:
        if event.returncode >= 0 or context.is_shutdown:
            return None
        return [TimerAction(period=RESPAWN_DELAY, actions=[_node(name, parameters)])]

    return Node(
        package=PACKAGE,
        executable=name,
        namespace=LaunchConfiguration('namespace'),
        parameters=[parameters],
        output='screen',
        on_exit=on_exit,
    )


def _graph(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    simulated = LaunchConfiguration('simulated').perform(context) == 'true'
    default = 'simulated.yaml' if simulated else 'real.yaml'
    parameters = LaunchConfiguration('params_file').perform(context) or PathJoinSubstitution(
        [FindPackageShare(PACKAGE), 'config', default]
    )
    nodes = [_node(name, parameters) for name in NODES]
    if not simulated:
        return nodes
    program = ExecutableInPackage(executable='simulated_arm', package=PACKAGE)
    arm = ExecuteProcess(
        cmd=[program, '--link', LINK], output='screen', on_exit=Shutdown(reason='the arm ended')
    )
    # The arm speaks once its serial line is there; a driver without one would give up.
    begin = OnProcessIO(
        target_action=arm, on_stdout=lambda _: [nodes.pop(0) for _ in range(len(nodes))]
    )
    return [arm, RegisterEventHandler(begin)]


def generate_launch_description() -> LaunchDescription:
    """Return the launch description."""
    profile = PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', 'fastdds.xml'])
    return LaunchDescription(
        [
            *(
                SetEnvironmentVariable(name, profile)
                for name in PROFILE_VARIABLES
                if name not in os.environ
            ),
            DeclareLaunchArgument(
                'simulated',
                default_value='true',
                choices=['true', 'false'],
                description='true: the rig of config/simulated.yaml',
            ),
            DeclareLaunchArgument(
                'params_file',
                default_value='',
                description='Parameters of the nodes (default: config/simulated.yaml, real.yaml)',
            ),
            DeclareLaunchArgument('namespace', default_value='', description='Namespace'),
            DeclareLaunchArgument(
                'mount',
                default_value='',
                description='"x y z yaw" of the arm\'s axis at the height of the camera in '
                'base_frame [m, rad]; empty: no transform is published, as another does',
            ),
            DeclareLaunchArgument(
                'base_frame', default_value='base_link', description="The robot's frame"
            ),
            DeclareLaunchArgument(
                'scan_frame',
                default_value='panodepth',
                description="The scan's frame: frame_id of the mosaicer",
            ),
            OpaqueFunction(function=_mount),
            OpaqueFunction(function=_graph),
        ]
    )
