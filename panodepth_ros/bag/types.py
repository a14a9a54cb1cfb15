"""Message types between rclpy's classes, names and the definitions that bags store."""

from __future__ import annotations

import importlib
import re
from typing import Any

from rclpy.exceptions import NameValidationException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.qos import QoSProfile
from rclpy.validate_full_topic_name import validate_full_topic_name

from panodepth_ros.bag.storage import BagError, rosbags

_IDL_TO_MSG = {'boolean': 'bool', 'octet': 'byte', 'float': 'float32', 'double': 'float64'}
_SEQUENCE = re.compile(r'sequence<(.+?)(?:, (\d+))?>')
_ARRAY = re.compile(r'(.+)(\[\d+\])')
_BOUNDED_STRING = re.compile(r'(w?string)<(\d+)>')


def check_topic_name(name: str) -> None:
    """
    Refuse what cannot be the name of a topic, relative or absolute.

    Raises
    ------
    BagError
        With ROS' reason.
    """
    try:
        validate_full_topic_name(expand_topic_name(name, 'node', '/'))
    except (NameValidationException, RuntimeError, ValueError) as error:
        # Without the picture of the place and the line of rcl's source.
        reason = str(error).partition('\n')[0].partition(', at ')[0].rstrip(':')
        raise BagError(f'{name!r} is no name of a topic: {reason}') from error


def message_class(name: str) -> Any:
    """
    Class of a message type such as ``sensor_msgs/msg/Image``.

    Raises
    ------
    BagError
        If its package is not installed here.
    """
    package, _, message = name.partition('/msg/')
    try:
        return getattr(importlib.import_module(f'{package}.msg'), message)
    except (ModuleNotFoundError, AttributeError) as error:
        raise BagError(f'message type {name} is not installed') from error


def _msg_type(idl: str) -> str:
    """Write a field's type as a .msg file does: ``sequence<double>`` is ``float64[]``."""
    if match := _SEQUENCE.fullmatch(idl):
        return f'{_msg_type(match[1])}[{f"<={match[2]}" if match[2] else ""}]'
    if match := _ARRAY.fullmatch(idl):
        return _msg_type(match[1]) + match[2]
    if match := _BOUNDED_STRING.fullmatch(idl):
        return f'{match[1]}<={match[2]}'
    return _IDL_TO_MSG.get(idl, idl)


def register(name: str, typestore: Any) -> None:
    """
    Teach a rosbags typestore a type and those it is made of, as the running ROS has them.

    The definitions come from the message classes, not from .msg files, which ROS from wheels
    does not index. Constants are therefore missing; they are no part of the data or the hash.

    Raises
    ------
    BagError
        If a type's package is not installed here.
    """
    if name in typestore.fielddefs:
        return
    fields = message_class(name).get_fields_and_field_types()
    lines = {field: _msg_type(idl) for field, idl in fields.items()}
    for kind in lines.values():
        if '/' in kind:
            package, message = kind.partition('[')[0].split('/')
            register(f'{package}/msg/{message}', typestore)
    text = '\n'.join(f'{kind} {field}' for field, kind in lines.items())
    typestore.register(rosbags('typesys').get_types_from_msg(text, name))


def stored_qos(profile: QoSProfile) -> Any:
    """Quality of service as the publisher offered it, in the form that bags store."""
    interfaces = rosbags('interfaces')

    def time(duration: Any) -> Any:
        return interfaces.QosTime(*divmod(duration.nanoseconds, 10**9))

    return interfaces.Qos(
        interfaces.QosHistory(int(profile.history)),
        profile.depth,
        interfaces.QosReliability(int(profile.reliability)),
        interfaces.QosDurability(int(profile.durability)),
        time(profile.deadline),
        time(profile.lifespan),
        interfaces.QosLiveliness(int(profile.liveliness)),
        time(profile.liveliness_lease_duration),
        profile.avoid_ros_namespace_conventions,
    )
