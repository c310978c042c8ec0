"""One MCAP file of ROS 2 messages (profile "ros2", CDR, "ros2msg" schemas, zstd chunks).

Format: https://mcap.dev/spec. Foxglove, PlotJuggler, Rerun and `ros2 bag` read it.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from cell.errors import ConfigError
from cell.wire import typestore

_MAGIC = b"\x89MCAP0\r\n"
_CHUNK = 4 * 1024 * 1024
_RESERVE = 16 * 1024 * 1024
"""A disk with less space than this counts as full: what waits and the index must still fit [bytes]."""
_LATCHED = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n"
    "  deadline: {sec: 9223372036, nsec: 854775807}\n  lifespan: {sec: 9223372036, nsec: 854775807}\n"
    "  liveliness: 1\n  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}\n"
    "  avoid_ros_namespace_conventions: false"
)
"""QoS with which `ros2 bag play` offers a topic to late comers: keep last, reliable, transient local."""


def check_target(path: Path) -> None:
    """Raise ConfigError unless a recording may be written to `path`.

    The directory must exist, the name must end in .mcap, and a file already there is
    replaced only if it is an MCAP recording (or empty).
    """
    if path.suffix != ".mcap":
        raise ConfigError(f"recording {path}: the file's name must end in .mcap")
    if not path.parent.is_dir():
        raise ConfigError(f"recording {path}: the directory {path.parent} does not exist")
    if not path.exists():
        return
    if not path.is_file():
        raise ConfigError(f"recording {path}: exists and is not a file")
    try:
        with path.open("rb") as file:
            start = file.read(len(_MAGIC))
    except OSError as error:
        raise ConfigError(f"recording {path}: {error.strerror}") from None
    if start not in (b"", _MAGIC):
        raise ConfigError(f"recording {path}: exists and is no MCAP recording, so it is not replaced")


class McapFile:
    """An MCAP file being written, from one thread.

    Args:
        path: checked with `check_target`; an old recording there is replaced.

    Raises:
        ConfigError: the place is not writable.

    All methods raise OSError when the disk fails; `abandon` is then the way out.
    """

    def __init__(self, path: Path) -> None:
        check_target(path)
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise ConfigError(f"recording {path}: {error.strerror}") from None
        # Half of its methods are untyped.
        self._writer: Any = Writer(self._file, chunk_size=_CHUNK, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="adaptive-sorting-cell")
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}
        self._safe = 0
        self.flush()

    def describe(self, name: str, facts: dict[str, str], files: dict[str, bytes]) -> None:
        """Write what the recording is of, before any message: one metadata record, and attached files."""
        self._writer.add_metadata(name, facts)
        for file, data in files.items():
            self._writer.add_attachment(0, 0, file, "application/octet-stream", data)
        self.flush()

    def add(
        self, topic: str, ros_type: str, t: float, seq: int, payload: bytes, latched: bool = False
    ) -> None:
        """Append one message.

        Args:
            topic: e.g. "/cell/arm/joint_states".
            ros_type: e.g. "sensor_msgs/msg/JointState"; raises KeyError for one that the
                type store does not know.
            t: source time [s], the log time of the message. seq: its sequence number.
            latched: of the topic's first message: players offer the last one to those who come late.
        """
        channel = self._channels.get((topic, ros_type))
        if channel is None:
            schema = self._schemas.get(ros_type)
            if schema is None:
                typestore.make(ros_type)  # KeyError before anything is written
                text = typestore.schema(ros_type).encode()
                schema = self._schemas[ros_type] = self._writer.register_schema(ros_type, "ros2msg", text)
            qos = {"offered_qos_profiles": _LATCHED} if latched else {}
            channel = self._writer.register_channel(topic, "cdr", schema, qos)
            self._channels[topic, ros_type] = channel
        ns = max(0, round(t * 1e9))
        self._writer.add_message(channel, ns, payload, publish_time=ns, sequence=seq & 0xFFFFFFFF)

    def flush(self) -> None:
        """Hand everything to the system: what is flushed survives the death of this process."""
        self._writer.flush()
        self._safe = self._file.tell()

    def full(self) -> bool:
        """Whether the disk has too little space left to go on and still finish the file."""
        try:
            space = os.fstatvfs(self._file.fileno())
        except OSError:
            return False
        return space.f_bavail * space.f_frsize < _RESERVE

    def close(self) -> None:
        """Write index and summary and close."""
        self._writer.finish()
        self._file.close()

    def abandon(self) -> None:
        """After a failed write: cut the file at the last flush and close it; never raises.

        Such a file has no index, but tools that recover unfinished recordings read all of it.
        """
        with suppress(OSError):
            self._file.raw.close()  # the buffered rest cannot be written: let go of it
        with suppress(OSError), open(self._file.name, "r+b") as file:
            file.truncate(self._safe)
