"""Writes MCAP files whose index lies on the disk while they grow:
the same bytes as the library's `Writer`.

That one keeps 1 KB in memory for each chunk, of which a run in real time has four a second.
"""

import struct
import tempfile
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import IO

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"
COMPRESSION = "zstd"
# Records that come often, whole: the library writes them number by number
_RECORD = struct.Struct("<BQ")
"""Head of every record: opcode and length of what follows."""
_MESSAGE = struct.Struct(_RECORD.format + "HIQQ")
_INDEX = struct.Struct(_RECORD.format + "HI")


class IndexedWriter:
    """Writes one MCAP file with its index, in chunks of at least so many bytes, compressed by zstd.

    The index is a file without a name in `folder`: 200 bytes for each chunk.
    """

    def __init__(
        self, stream: IO[bytes], folder: Path, *, chunk_bytes: int, profile: str, library: str
    ) -> None:
        self._stream = stream
        self._chunk_bytes = chunk_bytes
        self._index = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # until `close`
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: Counter[int] = Counter()
        self._chunks = 0
        self._span: tuple[int, int] | None = None
        """Least and greatest log time of the file [ns]."""
        self._chunk = RecordBuilder()
        self._in_chunk: defaultdict[int, list[int]] = defaultdict(list)
        """By channel: log time of each message of the chunk, and where it begins, in turn."""
        stream.write(MAGIC)
        self._write(Header(profile, library))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """The number of a schema, which is written."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        schema.write(self._chunk)
        return schema.id

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str]
    ) -> int:
        """The number of a channel, which is written."""
        channel = Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding=message_encoding,
            schema_id=schema_id,
            metadata=metadata,
        )  # fmt: skip
        self._channels.append(channel)
        channel.write(self._chunk)
        return channel.id

    def add_message(self, message: Message) -> None:
        """Adds a message to the chunk, and ends this one where it is large enough."""
        channel = message.channel_id
        self._in_chunk[channel] += (message.log_time, self._chunk.count)
        self._counts[channel] += 1
        self._chunk.write(
            _MESSAGE.pack(
                Opcode.MESSAGE,
                _MESSAGE.size - _RECORD.size + len(message.data),
                channel,
                message.sequence,
                message.log_time,
                message.publish_time,
            )
        )
        self._chunk.write(message.data)
        if self._chunk.count > self._chunk_bytes:
            self._end_chunk()

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Adds texts by their names."""
        offset = self._write(Metadata(name=name, metadata=data))
        self._metadata.append(
            MetadataIndex(offset=offset, length=self._stream.tell() - offset, name=name)
        )

    def flush(self) -> None:
        """Ends the chunk, and hands all that was written to the operating system."""
        self._end_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Writes the end of the file: what it holds and where."""
        self._end_chunk()
        self._write(DataEnd(data_section_crc=0))
        start = self._stream.tell()
        self._index.seek(0)
        summary, offsets = b"", []
        for opcode, group in (
            (Opcode.SCHEMA, _bytes_of(self._schemas)),
            (Opcode.CHANNEL, _bytes_of(self._channels)),
            (Opcode.STATISTICS, _bytes_of([self._statistics()])),
            (Opcode.CHUNK_INDEX, self._index.read()),
            (Opcode.ATTACHMENT_INDEX, b""),
            (Opcode.METADATA_INDEX, _bytes_of(self._metadata)),
        ):
            offsets.append(
                SummaryOffset(opcode, group_start=start + len(summary), group_length=len(group))
            )
            summary += group
        offset_start = start + len(summary)
        summary += _bytes_of(offsets)
        # Whose checksum follows
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 8 + 8 + 4, start, offset_start)
        self._stream.write(summary)
        self._write(Footer(start, offset_start, summary_crc=zlib.crc32(summary + footer)))
        self._stream.write(MAGIC)

    def close(self) -> None:
        """Ends the file of the index."""
        self._index.close()

    def _end_chunk(self) -> None:
        if not self._in_chunk:
            return
        first = min(min(index[::2]) for index in self._in_chunk.values())
        last = max(max(index[::2]) for index in self._in_chunk.values())
        data = self._chunk.end()
        packed = zstandard.compress(data)
        chunk = Chunk(
            COMPRESSION, packed, last, first, zlib.crc32(data), uncompressed_size=len(data)
        )
        start, end = self._write(chunk), self._stream.tell()
        offsets = {channel: self._write_index(channel) for channel in self._in_chunk}
        entry = ChunkIndex(
            chunk_length=end - start, chunk_start_offset=start, compression=COMPRESSION,
            compressed_size=len(packed),
            message_end_time=last, message_index_length=self._stream.tell() - end,
            message_index_offsets=offsets,
            message_start_time=first, uncompressed_size=len(data),
        )  # fmt: skip
        self._index.write(_bytes_of([entry]))
        self._in_chunk.clear()
        self._chunks += 1
        known = self._span or (first, last)
        self._span = (min(first, known[0]), max(last, known[1]))

    def _statistics(self) -> Statistics:
        first, last = self._span or (0, 0)
        return Statistics(
            attachment_count=0, channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunks, message_count=self._counts.total(), message_end_time=last,
            message_start_time=first, metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )  # fmt: skip

    def _write_index(self, channel: int) -> int:
        """Writes where the messages of a channel begin in the chunk; returns where that begins."""
        start, index = self._stream.tell(), self._in_chunk[channel]
        size = 8 * len(index)
        head = _INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX.size - _RECORD.size + size, channel, size)
        self._stream.write(head + struct.pack(f"<{len(index)}Q", *index))
        return start

    def _write(self, record: McapRecord) -> int:
        """Writes a record; returns where it begins."""
        start = self._stream.tell()
        self._stream.write(_bytes_of([record]))
        return start


def _bytes_of(records: Iterable[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()
