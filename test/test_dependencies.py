"""Dependencies point one way, and what is declared is what is needed."""

import ast
import graphlib
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'panodepth_ros'
CORE_FOLDERS = ('geometry', 'mosaic', 'matching', 'calibration', 'scan', 'motion', 'analysis')
CORE = [
    *sorted(
        '.'.join(path.relative_to(PACKAGE).with_suffix('').parts)
        for folder in CORE_FOLDERS
        for path in [PACKAGE / folder, *(PACKAGE / folder).glob('[a-z]*.py')]
    ),
    'export.ply',
]
#: docs/architecture.md: what is on a line uses that line and those before it.
LAYERS = (
    ('compiled', *CORE_FOLDERS, 'export', 'pages'),
    ('ros', 'arm', 'camera', 'bag'),
    ('nodes',),
    ('cli', 'start'),
)

#: Modules and the rosdep keys that bring them, each looked up in rosdistro's rosdep/*.yaml.
ROSDEP_KEYS = {
    'cv2': 'python3-opencv',
    'hypothesis': 'python3-hypothesis',
    'llvmlite': 'python3-numba',  # which is made with it
    'matplotlib': 'python3-matplotlib',
    'numba': 'python3-numba',
    'numpy': 'python3-numpy',
    'pytest': 'python3-pytest',
    'pytest_timeout': 'python3-pytest-timeout',
    'serial': 'python3-serial',
    'yaml': 'python3-yaml',
}
#: What is imported only where it is there, and no package of a robot's distribution brings.
OPTIONAL = {'dynamixel_sdk', 'plotly'}
#: Packages of the distribution.
ROS_PACKAGES = {
    *('rclpy', 'rcl_interfaces', 'builtin_interfaces', 'sensor_msgs', 'std_msgs', 'std_srvs'),
    *('geometry_msgs', 'nav_msgs', 'tf2_msgs', 'tf2_ros', 'diagnostic_msgs'),
    *('launch', 'launch_ros', 'ros2launch', 'ament_index_python', 'rosgraph_msgs'),
}


@pytest.mark.parametrize('module', CORE)
def test_core_imports_without_ros_and_devices(module):
    code = (
        f'import sys, panodepth_ros.{module}\n'
        "print([m for m in ('rclpy', 'sensor_msgs', 'serial', 'rosbags', 'matplotlib', "
        "'panodepth_ros.arm', 'panodepth_ros.camera', 'panodepth_ros.ros', 'panodepth_ros.nodes') "
        'if m in sys.modules])'
    )
    ran = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == '[]'


def imports(path):
    """What a file imports anywhere, by full names."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            yield from (f'{node.module}.{alias.name}' for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def used_folders():
    """Folder, or module beside them, to the others that its modules import anywhere."""
    used = {}
    for path in PACKAGE.rglob('[a-z]*.py'):
        mine = path.relative_to(PACKAGE).with_suffix('').parts[0]
        theirs = {n.split('.')[1] for n in imports(path) if n.startswith('panodepth_ros.')}
        used.setdefault(mine, set()).update(theirs - {mine})
    return used


def test_every_layer_uses_itself_and_those_below():
    level = {folder: height for height, layer in enumerate(LAYERS) for folder in layer}
    used = used_folders()
    assert used['nodes'] >= {'ros', 'arm', 'camera', 'matching'}
    upward = [(a, b) for a, others in used.items() for b in others if level[a] < level[b]]
    assert upward == []


def test_no_folders_use_each_other():
    list(graphlib.TopologicalSorter(used_folders()).static_order())


@pytest.mark.parametrize('distro', ['jazzy', 'kilted'])
def test_every_ros_wheel_is_pinned(distro):
    lines = (ROOT / 'requirements' / f'{distro}.txt').read_text().split()
    assert len(lines) > 50
    assert [line for line in lines if not re.fullmatch(r'ros-[a-z0-9-]+==[0-9.]+', line)] == []
    assert any(line.startswith('ros-rclpy==') for line in lines)


def test_package_xml_names_existing_keys_and_all_imports():
    package = ElementTree.parse(ROOT / 'package.xml').getroot()
    named = {element.text for element in package if element.tag.endswith('depend')}
    assert named <= {*ROSDEP_KEYS.values()} | ROS_PACKAGES
    files = [*PACKAGE.rglob('*.py'), *(ROOT / 'launch').glob('*.py')]
    imported = {name.partition('.')[0] for path in files for name in imports(path)}
    known = ROSDEP_KEYS.keys() | ROS_PACKAGES | OPTIONAL | sys.stdlib_module_names
    assert imported - known == {'panodepth_ros'}
    needed = {
        ROSDEP_KEYS.get(name, name) for name in imported & (ROSDEP_KEYS.keys() | ROS_PACKAGES)
    }
    assert needed <= named


def test_version_is_the_same_everywhere():
    xml = ElementTree.parse(ROOT / 'package.xml').getroot().findtext('version')
    assert f"version='{xml}'" in (ROOT / 'setup.py').read_text()
