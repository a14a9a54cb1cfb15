"""The time that bytes take on a simulated serial line, in both directions."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator


class PacedLine:
    """
    Bytes on their way.

    Parameters
    ----------
    baud_rate : float
        Bits per second, ten for a byte; +inf for a line that takes no time.
    """

    def __init__(self, baud_rate: float) -> None:
        self._byte_time = 10.0 / baud_rate
        self._incoming: deque[tuple[float, bytes]] = deque()
        self._outgoing: deque[tuple[float, bytes]] = deque()
        self._heard, self._said = -math.inf, -math.inf  # ends of the last bytes

    def clear(self) -> None:
        """Lose what is on its way."""
        self._incoming.clear()
        self._outgoing.clear()
        self._heard = self._said = -math.inf

    def send(self, data: bytes, now: float) -> None:
        """Put bytes for the controller on the line."""
        if self._byte_time == 0.0:
            self._incoming.append((now, data))
            return
        for value in data:
            self._heard = max(self._heard, now) + self._byte_time
            self._incoming.append((self._heard, bytes([value])))

    def arrived(self, now: float) -> Iterator[tuple[float, bytes]]:
        """Take off what has reached the controller, and when it did [s]."""
        while self._incoming and self._incoming[0][0] <= now:
            yield self._incoming.popleft()

    def answer(self, data: bytes, now: float) -> None:
        """Put bytes of the controller on the line."""
        if data:
            self._said = max(self._said, now) + self._byte_time * len(data)
            self._outgoing.append((self._said, data))

    def answered(self, now: float) -> bytes:
        """Take off what has come back."""
        data = b''
        while self._outgoing and self._outgoing[0][0] <= now:
            data += self._outgoing.popleft()[1]
        return data

    def next_event(self) -> float:
        """When the next bytes are there [s]; +inf if none are on their way."""
        return min(
            (queue[0][0] for queue in (self._incoming, self._outgoing) if queue), default=math.inf
        )
