"""Keeps the led sweep under way in a file, and finds it there after the mosaicer was killed."""

from __future__ import annotations

from pathlib import Path

from rclpy.node import Node

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic import Rig, Sweep
from panodepth_ros.mosaic.state import State, SweepJournal, load_state


class SweepKeeper:
    """
    The file of a mosaicer's sweep.

    Parameters
    ----------
    node : rclpy.node.Node
        Logs.
    path : str
        The file, its folder must exist; empty for none.

    Attributes
    ----------
    pending : bool
        Whether a sweep that another process left behind may be found.

    Raises
    ------
    ValueError
        If the folder does not exist.
    """

    def __init__(self, node: Node, path: str) -> None:
        self._node = node
        self._path = Path(path).expanduser() if path else None
        if self._path is not None and not self._path.absolute().parent.is_dir():
            raise ValueError(f'state_file is {path}; allowed: a file in a folder that exists')
        self.pending = self._path is not None and self._path.exists()
        self._journal = SweepJournal(self._path) if self._path is not None else None
        self._azimuth = 0.0
        self._sources: set[bytes] = set()
        self._kept: int | None = None  # stamp of the newest frame in the file

    def keep(self, sweep: Sweep | None, azimuth: float, sources: set[bytes]) -> None:
        """Write down where the sweep is, before the arm takes its next step."""
        self.pending = False
        self._azimuth, self._sources = azimuth, sources
        self._write(sweep)

    def update(self, sweep: Sweep | None) -> None:
        """Write down the frame that came since, if one did."""
        if sweep is not None and sweep.end != self._kept:
            self._write(sweep)

    def _write(self, sweep: Sweep | None) -> None:
        if self._journal is None:
            return
        self._kept = sweep.end if sweep is not None else None
        gids = tuple(sorted(gid.hex() for gid in self._sources))
        try:
            self._journal.write(sweep, self._azimuth, gids)
        except OSError as error:
            self._node.get_logger().error(
                f'state_file cannot be written, a restart would lose the sweep: {error}',
                throttle_duration_sec=30.0,
            )

    def find(self, rig: Rig, camera: PinholeCamera) -> State | None:
        """Return the sweep that was left behind, once; None if there is none that can be read."""
        self.pending = False
        assert self._path is not None
        try:
            return load_state(self._path, rig, camera)
        except (ValueError, OSError) as error:
            self._node.get_logger().error(f'state_file is not used: {error}')
            return None

    def forget(self) -> None:
        """Remove the file: the sweep has ended."""
        self.pending = False
        if self._journal is None:
            return
        try:
            self._journal.remove()
        except OSError as error:
            self._node.get_logger().error(f'state_file cannot be removed: {error}')
