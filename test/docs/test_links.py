"""What the documents point to is there."""

import re

import pytest
from documents import DOCUMENTS, ROOT

#: Folders that a path in a document begins with, seen from the root or from the package.
FOLDERS = {path.name for top in (ROOT, ROOT / 'panodepth_ros') for path in top.iterdir()}


def anchors(text):
    """Anchors of a document's headings, as GitHub makes them."""
    headings = re.findall(r'^#+ (.*)$', text, re.MULTILINE)
    return {re.sub(r'[^\w -]', '', heading.lower()).replace(' ', '-') for heading in headings}


def broken_links(document):
    text = document.read_text()
    broken = []
    for link in re.findall(r'\]\((?!http)([^)]+)\)', text):
        name, _, anchor = link.partition('#')
        target = document.parent / name if name else document
        if not target.exists() or (anchor and anchor not in anchors(target.read_text())):
            broken.append(link)
    return broken


def missing_paths(document):
    """Files and folders of the tree that are named in a sentence and are not there."""
    named = re.findall(r'`([\w.]+/[\w./]*)`', document.read_text())
    tops = (ROOT, ROOT / 'panodepth_ros')
    return [
        path
        for path in named
        if path.partition('/')[0] in FOLDERS and not any((top / path).exists() for top in tops)
    ]


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(document):
    assert broken_links(document) == []


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: path.name)
def test_named_files_exist(document):
    assert missing_paths(document) == []


def test_what_leads_nowhere_is_found(tmp_path):
    document = tmp_path / 'page.md'
    document.write_text(
        '# A head\n[a](#a-head) [b](#no-head) [c](none.md)\n'
        '`geometry/none.py` `geometry/camera.py` `3/4`\n'
    )
    assert broken_links(document) == ['#no-head', 'none.md']
    assert missing_paths(document) == ['geometry/none.py']
