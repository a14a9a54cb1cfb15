"""How a subcommand says why it failed."""

from __future__ import annotations

import sys


def failed(command: str, reason: object) -> int:
    """
    Say in one sentence on standard error why a subcommand failed.

    Parameters
    ----------
    command : str
        The subcommand.
    reason : object
        What is shown, an error or a sentence.

    Returns
    -------
    int
        1, the exit code.
    """
    print(f'panodepth_ros {command}: {reason}', file=sys.stderr)
    return 1
