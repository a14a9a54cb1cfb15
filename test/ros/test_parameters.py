"""Parameter tables: declaration, checks, documentation and configuration files."""

import math
import runpy
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml
from fixtures.ros import started
from rclpy.node import Node
from rclpy.parameter import Parameter

from panodepth_ros.ros.parameters import (
    ParameterError,
    declare_parameters,
    markdown_table,
    parameter,
)

pytestmark = pytest.mark.ros
ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    fixed: int = parameter(3, 'Fixed number', bounds=(1, 5))
    rate: float = parameter(2.0, 'Rate', unit='Hz', bounds=(0.5, 10.0), live=True)
    limit: float = parameter(4.0, 'At least the rate', unit='Hz', live=True)
    mode: str = parameter('slow', 'Mode', choices=('slow', 'fast'), live=True)
    places: tuple[float, ...] = parameter((), 'Places', unit='m', bounds=(1.0, 9.0), live=True)

    def __post_init__(self):
        if self.rate > self.limit:
            raise ValueError(
                f'rate is {self.rate} Hz and limit {self.limit}; allowed: rate <= limit'
            )


LIST = 'a list of floating-point numbers, such as [1.0, 2.0]'


def made(ros, *, on_change=None, check=None, **values):
    node = ros.add(
        Node(
            'tabled',
            context=ros.context,
            automatically_declare_parameters_from_overrides=True,
            parameter_overrides=[Parameter(n, value=v) for n, v in values.items()],
        )
    )
    return node, declare_parameters(node, Table, on_change, check)


def test_defaults_and_given_values(ros):
    node, table = made(ros, rate=3.0)
    assert (table.fixed, table.rate, table.mode) == (3, 3.0, 'slow')
    assert node.get_parameter('rate').value == 3.0


def test_descriptor_tells_unit_range_and_whether_it_may_change(ros):
    node, _ = made(ros, rate=3.0)
    rate, fixed, mode = (node.describe_parameter(name) for name in ('rate', 'fixed', 'mode'))
    assert rate.description == 'Rate [Hz]'
    assert rate.floating_point_range[0].to_value == 10.0
    assert fixed.integer_range[0].from_value == 1
    assert (rate.read_only, fixed.read_only) == (False, True)
    assert mode.additional_constraints == 'one of slow, fast'


@pytest.mark.parametrize(
    ('values', 'sentence'),
    [
        (
            {'rat': 1.0},
            'unknown parameter rat for tabled; known: fixed, limit, mode, places, rate',
        ),
        ({'rate': 11.0}, 'rate is 11.0; allowed: 0.5 to 10 Hz'),
        ({'fixed': 0}, 'fixed is 0; allowed: 1 to 5'),
        ({'rate': 2}, 'rate is 2; allowed: a floating-point number, such as 1.0'),
        ({'fixed': 'three'}, "fixed is 'three'; allowed: a whole number"),
        ({'mode': 'medium'}, "mode is 'medium'; allowed: slow, fast"),
        ({'places': [2, 3]}, f'places is (2, 3); allowed: {LIST}'),
        ({'places': 2.0}, f'places is 2.0; allowed: {LIST}'),
        ({'places': [2.0, 0.5]}, 'places holds 0.5; allowed: 1 to 9 m'),
        ({'places': [math.nan]}, 'places holds nan; allowed: 1 to 9 m'),
        ({'rate': 5.0}, 'rate is 5.0 Hz and limit 4.0; allowed: rate <= limit'),
    ],
)
def test_bad_values_are_refused_with_a_sentence(ros, values, sentence):
    with pytest.raises(ParameterError) as error:
        made(ros, **values)
    assert str(error.value) == sentence


def test_use_sim_time_is_no_unknown_name(ros):
    _, table = made(ros, use_sim_time=False)
    assert table == Table()


def test_live_change_reaches_the_node(ros):
    changes = []
    node, _ = made(ros, on_change=changes.append)
    (result,) = node.set_parameters([Parameter('rate', value=4.0)])
    assert result.successful
    assert [table.rate for table in changes] == [4.0]


@pytest.mark.parametrize(
    ('name', 'value', 'reason'),
    [
        ('rate', 4.5, 'rate is 4.5 Hz and limit 4.0; allowed: rate <= limit'),
        ('mode', 'medium', "mode is 'medium'; allowed: slow, fast"),
        ('rate', 3.5, 'not now'),
    ],
)
def test_bad_live_change_is_refused_with_a_sentence(ros, name, value, reason):
    def check(table):
        if table.rate == 3.5:
            raise ValueError('not now')

    changes = []
    node, _ = made(ros, on_change=changes.append, check=check)
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert (result.successful, result.reason, changes) == (False, reason, [])


def test_list_that_is_left_out_is_an_empty_list_of_numbers(ros):
    # rclpy takes [] for a list of bytes, and one unset parameter fails the query of all.
    node, table = made(ros)
    assert table.places == ()
    assert list(node.get_parameter('places').value) == []
    assert node.get_parameter('places').type_ == Parameter.Type.DOUBLE_ARRAY
    assert node.describe_parameter('places').description == 'Places [m]'


def test_list_is_given_and_set_as_numbers(ros):
    changes = []
    node, table = made(ros, on_change=changes.append, places=[2.0, 3.5])
    assert table.places == (2.0, 3.5)
    (result,) = node.set_parameters([Parameter('places', value=[4.0])])
    assert result.successful
    assert changes[0].places == (4.0,)
    (result,) = node.set_parameters([Parameter('places', value=[4.0, 10.0])])
    assert result.reason == 'places holds 10.0; allowed: 1 to 9 m'


def test_out_of_range_and_read_only_changes_are_refused(ros):
    node, _ = made(ros)
    (result,) = node.set_parameters([Parameter('rate', value=math.inf)])
    assert not result.successful
    assert 'rate' in result.reason
    (result,) = node.set_parameters([Parameter('fixed', value=4)])
    assert not result.successful
    assert 'read-only' in result.reason


def test_empty_list_in_a_parameter_file_is_refused_with_a_sentence(ros_domain):
    with started('mosaicer', '--ros-args', '-p', 'further_offsets_px:=[]', exit_code=1) as running:
        assert running.wait() == 1
        assert 'given as [], whose type ROS cannot tell; leave it out instead' in running.output


def test_markdown_table():
    lines = markdown_table(Table).splitlines()
    assert lines[2] == '| `fixed` | int | `3` |  | 1 to 5 | no | Fixed number |'
    assert lines[6] == '| `places` | list of float | empty | m | 1 to 9 | yes | Places |'
    assert lines[3] == '| `rate` | float | `2.0` | Hz | 0.5 to 10 | yes | Rate |'


@pytest.fixture(scope='module')
def tool():
    return runpy.run_path(str(ROOT / 'tools' / 'parameter_tables.py'))


def test_documents_show_the_tables_in_force(tool):
    text = tool['DOCUMENT'].read_text()
    assert tool['with_tables'](text) == text, 'run python tools/parameter_tables.py'


@pytest.mark.parametrize('name', ['simulated.yaml', 'simulated_spin.yaml', 'real.yaml'])
def test_shipped_parameter_files_fit_the_tables(tool, name):
    content = yaml.safe_load((ROOT / 'config' / name).read_text())
    nodes = {
        name.removeprefix('/**/'): entry['ros__parameters'] for name, entry in content.items()
    }
    assert set(nodes) == {'arm_driver', 'camera', 'mosaicer', 'depth', 'calibrator', 'views'}
    for node, values in nodes.items():
        table = tool['TABLES'][node](**values)
        for key, value in values.items():
            assert type(value) is type(getattr(tool['TABLES'][node](), key)), f'{node}.{key}'
            assert getattr(table, key) == value
