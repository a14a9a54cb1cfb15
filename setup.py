"""Metadata for pip and colcon alike; pyproject.toml holds the build system and tool tables."""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).parent
PACKAGE = 'panodepth_ros'


def pinned(distro: str) -> list[str]:
    """ROS 2 of one distribution as exact wheels from PyPI; never two in one environment."""
    return (HERE / 'requirements' / f'{distro}.txt').read_text().split()


setup(
    name=PACKAGE,
    version='0.1.0',
    description='Panoramic depth and laser scans from one camera on a rotating arm, for ROS 2',
    long_description=(HERE / 'README.md').read_text(),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    maintainer='panodepth_ros maintainers',
    maintainer_email='maintainers@panodepth-ros.invalid',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    package_data={PACKAGE: ['py.typed', 'pages/*.html']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/config', sorted(glob('config/*.*'))),
        (f'share/{PACKAGE}/launch', sorted(glob('launch/*.launch.py'))),
    ],
    python_requires='>=3.10',
    # rclpy is not here: a robot has it from its distribution, everyone else from an extra.
    install_requires=[
        'numba>=0.58.1',
        'numpy>=1.26',
        'opencv-python-headless>=4.6',
        'pyserial>=3.5',
        'pyyaml>=6.0',
    ],
    extras_require={
        'jazzy': pinned('jazzy'),
        'kilted': pinned('kilted'),
        'bag': ['rosbags>=0.11.6'],
        'dynamixel': ['dynamixel-sdk>=4.1'],
        'plot': ['matplotlib>=3.6'],
        'report': ['plotly>=5.18'],
        'test': [
            'colcon-common-extensions==0.3.0',
            'dynamixel-sdk>=4.1',
            'hypothesis>=6.80',
            'mcap-ros2-support>=0.5',
            'mypy==2.4.1',
            'pytest>=7.4',
            'pytest-timeout>=2.2',
            'ruff==0.17.6',
            'scikit-image>=0.22',
            'types-PyYAML',
        ],
    },
    zip_safe=True,
    entry_points={
        'console_scripts': [
            'arm_driver = panodepth_ros.start:arm_driver',
            'camera = panodepth_ros.start:camera',
            'mosaicer = panodepth_ros.start:mosaicer',
            'depth = panodepth_ros.start:depth',
            'calibrator = panodepth_ros.start:calibrator',
            'check_scan = panodepth_ros.start:check_scan',
            'views = panodepth_ros.start:views',
            'simulated_arm = panodepth_ros.start:simulated_arm',
            'panodepth_ros = panodepth_ros.cli.main:main',
        ],
    },
)
