"""The shipped RViz and Foxglove files show what the graph publishes, and call what it serves."""

import json
from pathlib import Path

import pytest
import yaml

from panodepth_ros.nodes.depth import Depth
from panodepth_ros.nodes.mosaicer import Mosaicer, MosaicerParameters

pytestmark = pytest.mark.ros
CONFIG = Path(__file__).resolve().parents[2] / 'config'
FRAME = MosaicerParameters().frame_id


@pytest.fixture
def graph(ros):
    """Topics with a publisher, and services, of the nodes that make results: name to type."""
    nodes = [ros.add(kind(context=ros.context)) for kind in (Mosaicer, Depth)]
    topics, services = {}, {}
    for node in nodes:
        own = node.get_name(), node.get_namespace()
        topics |= dict(node.get_publisher_names_and_types_by_node(*own))
        services |= dict(node.get_service_names_and_types_by_node(*own))
    return topics, services


def test_rviz_displays_topics_of_the_graph_as_what_they_are(graph):
    topics, _ = graph
    manager = yaml.safe_load((CONFIG / 'panodepth.rviz').read_text())['Visualization Manager']
    assert manager['Global Options']['Fixed Frame'] == FRAME
    shown = {d['Topic']['Value']: d for d in manager['Displays'] if 'Topic' in d}
    assert {'/scan', '/points', '/left/image', '/depth/image'} <= set(shown)
    for topic, display in shown.items():
        kind = display['Class'].removeprefix('rviz_default_plugins/')
        assert topics[topic] == [f'sensor_msgs/msg/{kind}']
        assert display['Enabled'] == display['Value']
        assert display['Topic']['Durability Policy'] == 'Volatile'


def panels(layout):
    """Names of the panels in a tree of a Foxglove layout."""
    if isinstance(layout, str):
        return [layout]
    return panels(layout['first']) + panels(layout['second'])


def test_foxglove_layout_names_topics_and_services_of_the_graph(graph):
    topics, services = graph
    layout = json.loads((CONFIG / 'foxglove_layout.json').read_text())
    configured = layout['configById']
    assert sorted(panels(layout['layout'])) == sorted(configured)
    assert configured['3D!space']['followTf'] == FRAME
    assert set(configured['3D!space']['topics']) == {'/scan', '/points'} <= set(topics)
    for name, panel in configured.items():
        if name.startswith('Image!'):
            assert topics[panel['imageMode']['imageTopic']] == ['sensor_msgs/msg/Image']
        if name.startswith('Gauge!'):
            topic, _, field = panel['path'].rpartition('.')
            assert (topics[topic], field) == (['std_msgs/msg/Float32'], 'data')
        if name.startswith('CallService!'):
            assert services[panel['serviceName']] == ['std_srvs/srv/Trigger']
