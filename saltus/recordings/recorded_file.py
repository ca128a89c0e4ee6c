"""The file of a recorded run: what of it is sound, and what is lost.

A file that was cut off reads up to the cut, one with flipped bits without what they hit.
"""

import json
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, Footer, Header, McapRecord, Metadata, Schema
from mcap.stream_reader import StreamReader

from saltus import config
from saltus.config import RunConfig
from saltus.errors import ConfigError, RecordingError
from saltus.recordings.chunks import RECORD_MAX, sound_records, torn_chunk
from saltus.recordings.recorder import LIBRARY, LOST, METADATA, METADATA_END


@dataclass(eq=False)
class RecordedFile:
    """The sound parts of a recording's file, messages still packed."""

    path: Path
    config: RunConfig | None = field(default=None, repr=False)
    """None where the head of the file is lost."""
    metadata: dict[str, str] = field(default_factory=dict, repr=False)
    summary: dict[str, str] = field(default_factory=dict, repr=False)
    """The summary that the writer gave at the end: restarts, errors."""
    complete: bool = False
    """True where the file has its end and every part of it is sound."""
    lost: list[str] = field(default_factory=list)
    """Losses, one line each."""
    schemas: dict[int, Schema] = field(default_factory=dict, repr=False)
    channels: dict[int, Channel] = field(default_factory=dict, repr=False)
    chunks: list[Chunk] = field(default_factory=list, repr=False)

    def fill(self) -> None:
        """Reads `path`, checks every part of it, and keeps what is sound.

        Raises:
            RecordingError: nothing is, or the file cannot be read.
        """
        try:
            with self.path.open("rb") as file:
                _Reader(self).read(file)
        except OSError as error:
            raise RecordingError(f"cannot read {self.path}: {error.strerror}") from error


def is_recording(path: Path) -> bool:
    """True where a file begins as a recording of a run; other programs write MCAP too."""
    with suppress(Exception), path.open("rb") as file:  # damaged bytes fail in many ways
        first = next(StreamReader(file).records)
        return isinstance(first, Header) and first.library == LIBRARY
    return False


class _Reader:
    """Fills a `RecordedFile` from bytes that may be damaged anywhere."""

    def __init__(self, file: RecordedFile) -> None:
        self._file = file
        self.ended = False
        self.begun = False

    def read(self, file: BinaryIO) -> None:
        reader = StreamReader(file, emit_chunks=True, record_size_limit=RECORD_MAX)
        lost = self._file.lost
        start = 0
        try:
            for record in reader.records:
                self._take(record)
                start = file.tell()
        except Exception as error:  # damaged bytes fail in many ways; all mean the same
            if not self.begun:
                raise RecordingError(
                    f"{self._file.path} is not a recording (MCAP): {_reason(error)}"
                ) from error
            lost.append(f"everything after part {len(self._file.chunks)}: {_reason(error)}")
            self._take_torn(file, start)
        if not self.ended and not lost:
            lost.append("the end of the file")
        self._file.complete = self.ended and not lost

    def _take_torn(self, file: BinaryIO, start: int) -> None:
        """The first messages of the chunk that begins at `start`,
        where the file ends inside of it.
        """
        file.seek(start)
        with suppress(Exception):  # as above: then nothing of it is whole
            chunk = torn_chunk(file.read(RECORD_MAX))
            self._keep(chunk, sound_records(chunk))

    def _take(self, record: McapRecord) -> None:
        file = self._file
        if isinstance(record, Header):
            self.begun = True
        elif isinstance(record, Chunk):
            self._take_chunk(record)
        elif isinstance(record, Metadata):
            self._take_metadata(record)
        elif isinstance(
            record, Channel
        ):  # the summary repeats them: those of a damaged part come back
            file.channels.setdefault(record.id, record)
        elif isinstance(record, Schema):
            file.schemas.setdefault(record.id, record)
        elif isinstance(record, Footer):
            self.ended = True

    def _take_chunk(self, chunk: Chunk) -> None:
        try:
            self._keep(chunk, sound_records(chunk))
        except Exception as error:  # as above
            start, end = 1e-9 * chunk.message_start_time, 1e-9 * chunk.message_end_time
            self._file.lost.append(
                f"messages between {start:.2f} s and {end:.2f} s: {_reason(error)}"
            )

    def _keep(self, chunk: Chunk, records: list[McapRecord]) -> None:
        self._file.chunks.append(chunk)
        for record in records:
            if isinstance(record, Channel):
                self._file.channels[record.id] = record
            elif isinstance(record, Schema):
                self._file.schemas[record.id] = record

    def _take_metadata(self, record: Metadata) -> None:
        if record.name == METADATA_END:
            self._file.summary = record.metadata
            self._file.lost += map(str, json.loads(record.metadata.get(LOST, "[]")))
        elif record.name == METADATA:
            self._file.metadata = record.metadata
            try:
                self._file.config = config.from_toml(RunConfig, record.metadata.get("config", ""))
            except ConfigError as error:
                self._file.lost.append(f"the configuration: {error}")


def _reason(error: Exception) -> str:
    return "the file ends" if isinstance(error, EndOfFile) else str(error) or type(error).__name__
