"""What all tests share. Without rclpy, tests that need ROS are skipped and say so."""

from __future__ import annotations

import importlib
import importlib.util
import warnings
from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# A busy machine is slow; that fails no test.
settings.register_profile('untimed', deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile('untimed')

pytest_plugins = ['fixtures.ros', 'fixtures.demo', 'fixtures.v4l2_device']

ROS_IS_HERE = importlib.util.find_spec('rclpy') is not None

if ROS_IS_HERE:
    # The first message of a process makes ROS import lark, whose release of the time warns of
    # modules that Python has deprecated since. Not ours to fail on.
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', DeprecationWarning)
        importlib.import_module('rosidl_generator_py')


def _is_of_ros(module: str) -> bool:
    package = module.partition('.')[0]
    return package in ('rclpy', 'std_srvs') or package.endswith(('_msgs', '_interfaces'))


class _Module(pytest.Module):
    """A test module that is skipped if what it imports needs ROS."""

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        try:
            return super().collect()
        except self.CollectError as error:
            cause = error.__cause__
            if isinstance(cause, ModuleNotFoundError) and _is_of_ros(cause.name or ''):
                pytest.skip(f'needs ROS 2: {cause}', allow_module_level=True)
            raise


if not ROS_IS_HERE:

    def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module:
        return _Module.from_parent(parent, path=module_path)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if ROS_IS_HERE:
        return
    for item in items:
        if item.get_closest_marker('ros'):
            item.add_marker(pytest.mark.skip(reason='needs ROS 2: rclpy is not importable'))
