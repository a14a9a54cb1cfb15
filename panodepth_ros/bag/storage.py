"""Bag files: open, read and write them, with errors in sentences that name the bag."""

from __future__ import annotations

import importlib
import sqlite3
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

STORAGES = ('mcap', 'sqlite3')
"""Names of the storages that bags are written in."""


class BagError(RuntimeError):
    """A bag cannot be read or written, or there is nothing to do it with."""


def rosbags(module: str) -> Any:
    """
    One of the modules of the package rosbags, which is an optional dependency.

    Raises
    ------
    BagError
        If rosbags is not installed.
    """
    try:
        return importlib.import_module(f'rosbags.{module}')
    except ModuleNotFoundError as error:
        if (error.name or '').partition('.')[0] != 'rosbags':
            raise
        raise BagError(
            'bags need the Python package rosbags: pip install rosbags; '
            'or use ros2 bag, whose files are the same'
        ) from error


@contextmanager
def reported(path: Path) -> Iterator[None]:
    """
    Turn whatever rosbags raises about a damaged bag into a sentence that names it.

    Raises
    ------
    BagError
        That sentence.
    """
    try:
        yield
    except BagError:
        raise
    except Exception as error:  # of rosbags, sqlite, lz4, zstandard, struct, YAML …
        reason = ' '.join(str(error).split()).rstrip('.') or type(error).__name__
        raise BagError(f'{path} cannot be read as a bag: {reason}') from error


@contextmanager
def opened(path: Path, *, deserializing: bool = False) -> Iterator[Any]:
    """
    Open a bag: the folder with its ``metadata.yaml``, or one ``.mcap`` or ``.db3`` file.

    Parameters
    ----------
    path : Path
        The bag.
    deserializing : bool
        Whether the reader can deserialise messages, by the definitions in the bag.

    Returns
    -------
    context manager
        Of a rosbags ``Reader``, or ``AnyReader`` if ``deserializing``.

    Raises
    ------
    BagError
        If it is missing, no bag, damaged or without any message.
    """
    if not path.exists():
        raise BagError(f'bag {path} does not exist')
    if path.is_dir() and not (path / 'metadata.yaml').is_file():
        raise BagError(f'{path} is no bag: it has no metadata.yaml')
    if deserializing:
        highlevel, typesys = rosbags('highlevel'), rosbags('typesys')
        with reported(path):
            # Bags older than Iron carry no definitions; ours are the same since Humble.
            store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
            reader = highlevel.AnyReader([path], default_typestore=store)
            reader.open()
    else:
        rosbag2 = rosbags('rosbag2')
        with reported(path):
            reader = rosbag2.Reader(path)
            reader.open()
    try:
        if reader.message_count == 0:
            raise BagError(f'bag {path} holds no messages')
        yield reader
    finally:
        reader.close()


def raw_messages(
    reader: Any, path: Path, connections: Collection[Any]
) -> Iterator[tuple[Any, int, bytes]]:
    """
    Messages of the given connections as they are stored, in order of time.

    Parameters
    ----------
    reader : rosbags reader
        Made by :func:`opened`.
    path : Path
        Its bag, for error messages.
    connections : collection of rosbags connections
        Some of ``reader.connections``; if none, there are no messages.

    Yields
    ------
    (connection, time, data)
        Time in nanoseconds since the epoch, data serialised.

    Raises
    ------
    BagError
        If the bag is damaged, or ends before it held as many messages as it says.
    """
    expected, count = sum(connection.msgcount for connection in connections), 0
    if not expected:
        return
    with reported(path):
        for connection, time, data in reader.messages(connections):
            yield connection, time, bytes(data)
            count += 1
    if count != expected:
        raise BagError(f'bag {path} is damaged: it holds {count} of its {expected} messages')


def chosen_connections(
    reader: Any, path: Path, topics: Collection[str], exclude: Collection[str] = ()
) -> list[Any]:
    """
    Connections of the given topics, or of all if none are given, without the excluded ones.

    Raises
    ------
    BagError
        If the bag has no such topic.
    """
    known = {connection.topic for connection in reader.connections}
    unknown = sorted({*topics, *exclude} - known)
    if unknown:
        raise BagError(
            f'bag {path} has no topic {", ".join(unknown)}; it has {", ".join(sorted(known))}'
        )
    chosen = set(topics or known) - set(exclude)
    return [connection for connection in reader.connections if connection.topic in chosen]


def read(
    path: Path | str, topics: Collection[str] | Mapping[str, str] = ()
) -> Iterator[tuple[str, int, Any]]:
    """
    Read a bag's messages, without ROS.

    Parameters
    ----------
    path : Path or str
        The bag's folder, or one of its files.
    topics : collection of str, or mapping of str to str
        Topics to read, all if empty; or topic to the type its messages must have, such as
        ``sensor_msgs/msg/Image``.

    Yields
    ------
    (topic, time, message)
        In order of time, which is that of reception in nanoseconds since the epoch. Messages
        have the fields of the ROS messages; sequences of numbers are arrays.

    Raises
    ------
    BagError
        If the bag is missing, damaged, empty or without one of the topics, or one is of another
        type.
    """
    path = Path(path)
    types = topics if isinstance(topics, Mapping) else {}
    with opened(path, deserializing=True) as reader:
        connections = chosen_connections(reader, path, topics)
        for connection in connections:
            allowed = types.get(connection.topic, connection.msgtype)
            if connection.msgtype != allowed:
                raise BagError(
                    f'topic {connection.topic} of bag {path} is of type {connection.msgtype}; '
                    f'allowed: {allowed}'
                )
        for connection, time, data in raw_messages(reader, path, connections):
            with reported(path):
                message = reader.deserialize(data, connection.msgtype)
            yield connection.topic, time, message


class BagWriter:
    """
    A new bag. Close it, or use it in a ``with`` block: only a closed bag is complete.

    Parameters
    ----------
    path : Path or str
        Folder to make.
    storage : str
        One of :data:`STORAGES`.

    Raises
    ------
    BagError
        If the path exists already or cannot be made, or rosbags is missing.
    """

    def __init__(self, path: Path | str, storage: str = 'mcap'):
        if storage not in STORAGES:
            raise BagError(f'storage is {storage!r}; allowed: {", ".join(STORAGES)}')
        self.path = Path(path)
        if self.path.exists():
            raise BagError(f'{self.path} exists already and is not overwritten')
        rosbag2 = rosbags('rosbag2')
        plugin = rosbag2.StoragePlugin[storage.upper()]
        self._writer = rosbag2.Writer(self.path, version=9, storage_plugin=plugin)
        with self._telling('made'):
            self._writer.open()
        self._connections: dict[str, Any] = {}
        self.message_count = 0

    def add_topic(
        self, topic: str, message_type: str, typestore: Any, qos: Collection[Any] = ()
    ) -> None:
        """
        Announce a topic before its first message.

        Parameters
        ----------
        topic : str
            Absolute name.
        message_type : str
            Such as ``sensor_msgs/msg/Image``.
        typestore : rosbags typestore
            Knows the type, whose definition and hash are stored with the messages.
        qos : collection of rosbags Qos
            What the publishers offered.

        Raises
        ------
        BagError
            If it cannot be written, as on a full disk.
        """
        with self._telling('written'):
            self._connections[topic] = self._writer.add_connection(
                topic, message_type, typestore=typestore, offered_qos_profiles=tuple(qos)
            )

    def write(self, topic: str, time: int, data: bytes | memoryview) -> None:
        """
        Append a serialised message, received at a time in nanoseconds since the epoch.

        Raises
        ------
        BagError
            If it cannot be written, as on a full disk.
        """
        with self._telling('written'):
            self._writer.write(self._connections[topic], time, data)
        self.message_count += 1

    def close(self) -> None:
        """
        Write the index and the metadata.

        Raises
        ------
        BagError
            If they cannot be written, as on a full disk.
        """
        with self._telling('completed'):
            self._writer.close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        # What went wrong first says more than that the bag cannot be completed either.
        with suppress(BagError) if kind is not None else nullcontext():
            self.close()

    @contextmanager
    def _telling(self, what: str) -> Iterator[None]:
        """Raise as BagError what the disk, or SQLite, has to say."""
        try:
            yield
        except (OSError, sqlite3.Error) as error:
            reason = getattr(error, 'strerror', None) or error
            raise BagError(f'bag {self.path} cannot be {what}: {reason}') from error
