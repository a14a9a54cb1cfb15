"""HTML pages that commands fill in or serve, as package data; they load nothing from elsewhere."""

from importlib import resources


def page(name: str) -> str:
    """Return the text of a page of this folder."""
    return resources.files(__name__).joinpath(name).read_text(encoding='utf-8')
