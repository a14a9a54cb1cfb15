"""A ROS domain that nothing else of this package uses on this machine."""

from __future__ import annotations

import itertools
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager

#: Domains that are safe on every platform, without the default 0.
DOMAINS = range(1, 102)
_turn = itertools.count(os.getpid())


@contextmanager
def claimed_domain() -> Iterator[int]:
    """
    Claim a domain for as long as the block runs.

    The claim is a socket name in Linux' abstract namespace: it is as wide as DDS on the
    loopback interface, and it ends with the process at the latest.

    Raises
    ------
    RuntimeError
        If all domains are claimed.
    """
    for _ in DOMAINS:
        domain = DOMAINS[next(_turn) % len(DOMAINS)]
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f'\0panodepth_ros-domain-{domain}')
        except OSError:
            claim.close()
            continue
        with claim:
            yield domain
        return
    raise RuntimeError(f'all ROS domains from {DOMAINS[0]} to {DOMAINS[-1]} are claimed')
