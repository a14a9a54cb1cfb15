"""Whether a frame turns against the robot: by transforms where there are any, else by joints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

#: Rotations that differ by less are one [rad].
STILL = math.radians(0.05)
#: A scan's z axis may lean that far [rad].
UPRIGHT = math.radians(3.0)

Quaternion = Sequence[float]
_SUFFIXES = ('_joint', '_link', '_frame')


class Known(NamedTuple):
    """What is known in favour of a frame, and whether that is enough."""

    certain: bool
    text: str


@dataclass(slots=True)
class FrameMotion:
    """
    Collects transforms and joint positions.

    Attributes
    ----------
    base_frame : str
        The robot's frame: what happens above it is the robot's own motion.
    transforms_readable : bool
        Whether transforms can be heard at all.
    """

    base_frame: str = 'base_link'
    transforms_readable: bool = True
    _parents: dict[str, str] = field(default_factory=dict)
    _first: dict[str, Quaternion] = field(default_factory=dict)
    _turned: dict[str, float] = field(default_factory=dict)
    _joints: dict[str, tuple[float, float]] = field(default_factory=dict)

    def add_transform(self, parent: str, child: str, rotation: Quaternion) -> None:
        """Take the rotation (x, y, z, w) of a child in its parent."""
        self._parents[child] = parent
        first = self._first.setdefault(child, tuple(rotation))
        turn = 2 * math.acos(min(abs(float(np.dot(first, rotation))), 1.0))
        self._turned[child] = max(self._turned.get(child, 0.0), turn)

    def add_joint(self, name: str, position: float) -> None:
        """Take a joint's position [rad]."""
        low, high = self._joints.get(name, (position, position))
        self._joints[name] = (min(low, position), max(high, position))

    def judge(self, frame: str) -> tuple[str, Known]:
        """
        Judge a frame.

        Returns
        -------
        fault : str
            Why it is unfit; empty if nothing is known against it.
        known : Known
            What is known in its favour.
        """
        turning = {name for name, (low, high) in self._joints.items() if high - low > STILL}
        for joint in sorted(turning):
            if _stem(joint) == _stem(frame):
                return f'frame {frame} turns with the joint {joint}: {_CACHED}', Known(False, '')
        chain = self._chain(frame)
        for child in chain:
            if self._turned[child] > STILL:
                by = math.degrees(self._turned[child])
                return f'frame {frame} turns by {by:.1f}° with {child}: {_CACHED}', Known(
                    False, ''
                )
        if chain and self._parents[chain[-1]] == self.base_frame:
            lean = self._lean(chain)
            if lean > UPRIGHT:
                fault = f'z of frame {frame} leans {math.degrees(lean):.0f}° from z of the robot'
                return f'{fault}; allowed: z up', Known(False, '')
            return '', Known(True, f'{frame} does not turn in {self.base_frame}, z up')
        if frame == self.base_frame:
            return '', Known(True, f'{frame} is the frame of the robot')
        if not self.transforms_readable:
            why = 'tf2_msgs is not installed, so transforms cannot be heard'
        elif chain:
            why = f'its transforms lead to {self._parents[chain[-1]]}, not to {self.base_frame}'
        else:
            why = 'no transform to it was heard'
        moving = f'{len(turning)} turning joints are named otherwise'
        return '', Known(False, f'whether {frame} turns is not known: {why}; {moving}')

    def _chain(self, frame: str) -> list[str]:
        """Frames from this one up to the child of the base frame, or of the root."""
        chain: list[str] = []
        while frame in self._parents and frame != self.base_frame and frame not in chain:
            chain.append(frame)
            frame = self._parents[frame]
        return chain

    def _lean(self, chain: Sequence[str]) -> float:
        """Angle between the z axes of the chain's first frame and the base frame [rad]."""
        axis = np.array([0.0, 0.0, 1.0])
        for child in chain:
            axis = _rotated(self._first[child], axis)
        return math.acos(float(np.clip(axis[2], -1.0, 1.0)))


_CACHED = 'consumers keep the transform of the first scan; allowed: a frame fixed to the robot'


def _stem(name: str) -> str:
    for suffix in _SUFFIXES:
        name = name.removesuffix(suffix)
    return name


def _rotated(quaternion: Quaternion, vector: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    q, w = np.asarray(quaternion[:3], np.float64), quaternion[3]
    return vector + 2 * np.cross(q, np.cross(q, vector) + w * vector)
