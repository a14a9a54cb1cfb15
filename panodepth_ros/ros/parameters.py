"""
Parameter tables: one frozen dataclass a node, from which all else comes.

A field made by :func:`parameter` holds type, default, unit, range or choices, description and
whether it may change while the node runs. :func:`declare_parameters` declares the table on a
node, :func:`markdown_table` prints it for docs/nodes.md.
"""

from __future__ import annotations

import dataclasses
from array import array
from collections.abc import Callable
from typing import Any, TypeVar, get_type_hints

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

Table = TypeVar('Table')

#: Names that rclpy itself takes from a parameter file.
STANDARD_NAMES = ('use_sim_time', 'start_type_description_service')


class ParameterError(ValueError):
    """A parameter is unknown, of the wrong type, out of range or at odds with another."""


def parameter(
    default: Any,
    description: str,
    *,
    unit: str = '',
    bounds: tuple[float, float] | None = None,
    choices: tuple[str, ...] | None = None,
    live: bool = False,
) -> Any:
    """
    Describe one parameter as a dataclass field.

    Parameters
    ----------
    default : bool, int, float, str or tuple of float
        Default value; its type is the field's annotation, ``tuple[float, ...]`` for a list. An
        empty list is what a list is by default, for ROS cannot tell its type: a parameter file
        leaves the parameter out.
    description : str
        What it means, without unit and range.
    unit : str
        Unit as people write it, empty for none.
    bounds : (float, float), optional
        Smallest and largest allowed value, both included; of each element of a list.
    choices : tuple of str, optional
        The allowed values of a string.
    live : bool
        Whether it may be set while the node runs; it then acts on the next sweep.
    """
    return dataclasses.field(
        default=default,
        metadata={
            'description': description,
            'unit': unit,
            'bounds': bounds,
            'choices': choices,
            'live': live,
        },
    )


def _allowed(field: dataclasses.Field[Any]) -> str:
    bounds, choices, unit = (field.metadata[key] for key in ('bounds', 'choices', 'unit'))
    if choices:
        return ', '.join(choices)
    if bounds:
        return f'{bounds[0]:g} to {bounds[1]:g}{" " + unit if unit else ""}'
    return ''


def _descriptor(field: dataclasses.Field[Any], kind: type) -> ParameterDescriptor:
    descriptor = ParameterDescriptor()
    unit = field.metadata['unit']
    descriptor.description = field.metadata['description'] + (f' [{unit}]' if unit else '')
    descriptor.read_only = not field.metadata['live']
    if field.metadata['choices']:
        descriptor.additional_constraints = f'one of {_allowed(field)}'
    bounds = field.metadata['bounds']
    if bounds and kind is int:
        descriptor.integer_range = [IntegerRange(from_value=bounds[0], to_value=bounds[1])]
    elif bounds and kind is float:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(bounds[0]), to_value=float(bounds[1]))
        ]
    return descriptor


def check_values(table: Any) -> None:
    """
    Refuse what ROS does not check: strings by their choices, elements of lists by their bounds.

    Raises
    ------
    ValueError
        Names the parameter, its value and what is allowed.
    """
    for field in dataclasses.fields(table):
        choices, value = field.metadata['choices'], getattr(table, field.name)
        if choices and value not in choices:
            raise ValueError(f'{field.name} is {value!r}; allowed: {_allowed(field)}')
        bounds = field.metadata['bounds']
        if bounds and isinstance(value, tuple):
            for element in value:
                if not bounds[0] <= element <= bounds[1]:
                    raise ValueError(f'{field.name} holds {element}; allowed: {_allowed(field)}')


def declare_parameters(
    node: Node,
    table: type[Table],
    on_change: Callable[[Table], None] | None = None,
    check: Callable[[Table], None] | None = None,
) -> Table:
    """
    Declare a table on a node and keep it checked.

    Parameters
    ----------
    node : rclpy.node.Node
        Must have been made with ``automatically_declare_parameters_from_overrides=True``, so
        that names given in a parameter file but unknown to the table can be seen and refused.
    table : type
        Frozen dataclass of :func:`parameter` fields. Its ``__post_init__`` checks what spans
        fields and raises ValueError.
    on_change : callable, optional
        Called with the new table after a live parameter was set.
    check : callable, optional
        Called with a proposed table before a live parameter is set; raises ValueError with a
        sentence if the node, as it runs, cannot take it.

    Returns
    -------
    table
        The values in force.

    Raises
    ------
    ParameterError
        A sentence that names the parameter, its value and what is allowed.
    """
    fields = {field.name: field for field in dataclasses.fields(table)}  # type: ignore[arg-type]
    kinds = get_type_hints(table)
    given = {
        name: node.get_parameter(name)
        for name in node.list_parameters([], 0).names
        if name not in STANDARD_NAMES and not name.startswith('qos_overrides.')
    }
    unknown = sorted(set(given) - set(fields))
    if unknown:
        raise ParameterError(
            f'unknown parameter {", ".join(unknown)} for {node.get_name()}; '
            f'known: {", ".join(sorted(fields))}'
        )
    values = {}
    for name, field in fields.items():
        if name in given:
            node.undeclare_parameter(name)  # declared by the override, without a descriptor
        try:
            declared = _declare(node, name, field.default, _descriptor(field, kinds[name]))
        except InvalidParameterTypeException as error:
            raise ParameterError(
                f'{name} is {_plain(given[name].value)!r}; allowed: {_type_name(kinds[name])}'
            ) from error
        except InvalidParameterValueException as error:
            raise ParameterError(
                f'{name} is {given[name].value!r}; allowed: {_allowed(field)}'
            ) from error
        values[name] = _plain(declared.value)
    try:
        current = table(**values)
        check_values(current)
    except ValueError as error:
        raise ParameterError(str(error)) from error

    def proposed(changes: list[Parameter]) -> Table:
        known = {change.name: _plain(change.value) for change in changes if change.name in fields}
        return dataclasses.replace(current, **known)  # type: ignore[type-var]

    def approve(changes: list[Parameter]) -> SetParametersResult:
        try:
            table_to_be = proposed(changes)
            check_values(table_to_be)
            if check is not None:
                check(table_to_be)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def apply(changes: list[Parameter]) -> None:
        nonlocal current
        current = proposed(changes)
        if on_change is not None:
            on_change(current)

    node.add_on_set_parameters_callback(approve)
    node.add_post_set_parameters_callback(apply)
    return current


def _declare(
    node: Node, name: str, default: Any, descriptor: ParameterDescriptor
) -> Parameter[Any]:
    """Declare one parameter, an empty list in three steps: rclpy takes it for one of bytes."""
    if default != ():
        return node.declare_parameter(name, default, descriptor)
    kind = Parameter.Type.DOUBLE_ARRAY
    declared = node.declare_parameter(name, kind, ParameterDescriptor())
    if declared.value is None:
        node.set_parameters([Parameter(name, kind, [])])
    descriptor.type = kind.value
    node.set_descriptor(name, descriptor)
    return node.get_parameter(name)


def _plain(value: Any) -> Any:
    """Return a parameter's value as a table holds it: lists, whose kinds are many, as tuples."""
    return tuple(value) if isinstance(value, (list, tuple, array)) else value


def _type_name(kind: Any) -> str:
    names = {float: 'a floating-point number, such as 1.0', int: 'a whole number'}
    names |= {bool: 'true or false', str: 'a string'}
    names[tuple[float, ...]] = 'a list of floating-point numbers, such as [1.0, 2.0]'
    return names.get(kind, str(kind))


def markdown_table(table: type) -> str:
    """Return the table as Markdown rows: name, type, default, unit, range, live, meaning."""
    kinds = get_type_hints(table)
    rows = [
        '| parameter | type | default | unit | allowed | live | meaning |',
        '|---|---|---|---|---|---|---|',
    ]
    for field in dataclasses.fields(table):
        default = str(field.default).lower() if kinds[field.name] is bool else field.default
        shown = f'`{default}`' if default not in ('', ()) else 'empty'
        kind = 'list of float' if isinstance(default, tuple) else kinds[field.name].__name__
        allowed = _allowed(field).removesuffix(f' {field.metadata["unit"]}')
        rows.append(
            f'| `{field.name}` | {kind} | {shown} '
            f'| {field.metadata["unit"]} | {allowed} '
            f'| {"yes" if field.metadata["live"] else "no"} | {field.metadata["description"]} |'
        )
    return '\n'.join(rows)
