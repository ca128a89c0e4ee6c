"""Writes messages of others, as they travelled, into an MCAP file that ROS 2 and viewers open."""

import os
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from mcap.records import Message as Record

from saltus.errors import RecordingError
from saltus.interrupts import WHOLE
from saltus.recordings.indexed_writer import IndexedWriter
from saltus.recordings.recorder import CHUNK_BYTES, FLUSH_S, PROFILE
from saltus.recordings.ros_messages import stored_definition

LIBRARY = "saltus-cdr"
"""Writer of these files; those of runs of Saltus are told by another name."""


class CdrLog:
    """Writes a recording of some DDS topics as an MCAP file that ROS 2 opens.

    Args:
        path: The file; its folder is made.
        types: Type of each topic, of those that `ros_messages` knows.

    Raises:
        RecordingError: it cannot be written, also from all methods.
    """

    def __init__(self, path: Path, types: dict[str, str]) -> None:
        self.path = path
        self.counts: Counter[str] = Counter()
        """Messages of each topic so far."""
        self._flushed_s = time.monotonic()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb", buffering=CHUNK_BYTES)
        except FileExistsError as error:
            raise RecordingError(f"{path} is there already: name another file") from error
        except OSError as error:
            raise RecordingError(f"cannot write {path}: {error.strerror}") from error
        self._writer = IndexedWriter(
            self._file, path.parent, chunk_bytes=CHUNK_BYTES, profile=PROFILE, library=LIBRARY
        )
        self._channels = {
            topic: self._writer.register_channel(
                topic,
                "cdr",
                self._writer.register_schema(kind, "ros2msg", stored_definition(kind).encode()),
                {},
            )
            for topic, kind in types.items()
        }

    def write(self, topic: str, payload: bytes, arrival_ns: int, sent_ns: int) -> None:
        """Adds a message, with its times since 1970 [ns]."""
        record = Record(
            channel_id=self._channels[topic], log_time=arrival_ns, publish_time=sent_ns,
            sequence=self.counts[topic], data=payload,
        )  # fmt: skip
        with WHOLE:
            self._do(lambda: self._writer.add_message(record))
            self.counts[topic] += 1

    def flush(self) -> None:
        """Hands what was written to the operating system, if that is due:
        a crash costs half a second.
        """
        if time.monotonic() - self._flushed_s >= FLUSH_S:
            self._flushed_s = time.monotonic()
            with WHOLE:
                self._do(self._writer.flush)

    def close(self) -> None:
        """Writes the end of the file. May be called twice."""
        if not self._file.closed:
            with WHOLE:
                self._do(self._end)

    def __enter__(self) -> "CdrLog":
        return self

    def __exit__(
        self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None
    ) -> None:
        self.close()

    def _end(self) -> None:
        try:
            self._writer.finish()
            self._file.flush()
            os.fdatasync(self._file.fileno())
        finally:
            self._file.close()
            self._writer.close()

    def _do(self, work: Callable[[], None]) -> None:
        try:
            work()
        except OSError as error:
            raise RecordingError(f"cannot write {self.path}: {error.strerror}") from error
