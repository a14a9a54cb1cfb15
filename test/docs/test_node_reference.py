"""docs/nodes.md names the topics and services that the nodes have, as the policy knows them."""

import re
from xml.etree import ElementTree

import pytest
from documents import ROOT

POLICY = ElementTree.parse(ROOT / 'config' / 'sros2_policy.xml').getroot()
#: Nodes that have a policy.
NODES = [profile.get('node') for profile in POLICY.iterfind('.//profile')]
#: Services that every node has.
OF_RCLPY = ('parameter', 'get_type_description')


def documented(node):
    """Names in a node's table, by what the first column says."""
    text = (ROOT / 'docs' / 'nodes.md').read_text()
    section = text.partition(f'\n## {node}\n')[2].partition('\n## ')[0]
    found, kind = {}, ''
    for row in re.findall(r'^\| (\w*) ?\| (`.*?) \|', section, re.MULTILINE):
        kind = row[0] or kind
        names = {name.replace('~', node) for name in re.findall(r'`([^`…]+)`', row[1])}
        found.setdefault(kind, set()).update(names)
    return found


def granted(node, what, kind):
    (profile,) = POLICY.iterfind(f".//profile[@node='{node}']")
    names = {e.text for group in profile.iterfind(what) for e in group if group.get(kind)}
    return {name for name in names if not any(word in name for word in OF_RCLPY)}


@pytest.mark.parametrize('node', ['arm_driver', 'camera', 'mosaicer', 'depth', 'calibrator'])
def test_services_are_documented(node):
    found = documented(node)
    assert found['services'] == granted(node, 'services', 'reply')
    assert found.get('calls', set()) == granted(node, 'services', 'request')


@pytest.mark.parametrize('node', ['arm_driver', 'camera', 'mosaicer', 'depth', 'calibrator'])
def test_documented_topics_exist(node):
    found = documented(node)
    assert found['publishes']
    for said, kind in (('publishes', 'publish'), ('subscribes', 'subscribe')):
        names = granted(node, 'topics', kind)
        unknown = {
            name
            for name in found.get(said, ())
            if not any(re.fullmatch(pattern, name) for pattern in names)
        }
        assert unknown == set()


def test_readme_lists_every_node():
    reference = (ROOT / 'docs' / 'nodes.md').read_text()
    nodes = re.findall(r'^<!-- parameters of (\w+) -->$', reference, re.MULTILINE)
    text = (ROOT / 'README.md').read_text().partition('\n## Nodes\n')[2]
    assert set(re.findall(r'^\| \[(\w+)\]', text, re.MULTILINE)) == set(nodes)
    assert set(nodes) >= set(NODES)
