"""Chunks of a recording that may be damaged:
unpacked into bounded memory, and read up to where a file was cut off.
"""

import struct
import zlib
from collections.abc import Container, Iterator
from dataclasses import replace
from io import BytesIO
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk, McapRecord
from mcap.stream_reader import breakup_chunk

from saltus.errors import RecordingError

RECORD_MAX = 32 * 2**20  # bytes; a chunk is 256 KiB and one message at most 4 MiB longer
_HEAD = struct.Struct("<BQ")  # of a record: kind and length
# Of a message, its payload follows: kind, length, and the fields of `ChunkRow`
_MESSAGE = struct.Struct("<BQHIQQ")
_BEFORE_PAYLOAD = _MESSAGE.size - _HEAD.size  # bytes that the length counts


class ChunkRow(NamedTuple):
    """A message as a chunk of an MCAP file has it."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    payload: bytes


def chunk_rows(chunk: Chunk, channels: Container[int]) -> Iterator[ChunkRow]:
    """The messages of a sound chunk on some channels, in order.

    Others are stepped over: to make an object of each record, as mcap's reader does, takes ten
    times as long, and a report looks through a recording for a dozen topics.
    """
    data, start = _unpack(chunk), 0
    while start < len(data):
        kind, length = _HEAD.unpack_from(data, start)
        if kind == Opcode.MESSAGE:
            _, _, channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
            if channel in channels:
                begin = start + _MESSAGE.size
                payload = data[begin : begin + length - _BEFORE_PAYLOAD]
                yield ChunkRow(channel, sequence, log_time, publish_time, payload)
        start += _HEAD.size + length


def sound_records(chunk: Chunk) -> list[McapRecord]:
    """The records of a whole chunk; an error of any kind where it is damaged."""
    data = _unpack(chunk)
    if len(data) != chunk.uncompressed_size:
        raise RecordingError(f"has {len(data)} bytes in place of {chunk.uncompressed_size}")
    _check_lengths(data)
    return breakup_chunk(replace(chunk, compression="", data=data), validate_crc=True)


def torn_chunk(end_of_file: bytes) -> Chunk:
    """The whole messages of a chunk inside of which a file ends, as a chunk.

    An error of any kind where there is none.

    Of compressed bytes that is all up to the last whole block, of at most 128 KiB (RFC 8878).
    """
    kind, length = _HEAD.unpack_from(end_of_file)
    body = end_of_file[_HEAD.size :]
    if kind != Opcode.CHUNK or length <= len(body):
        raise RecordingError("is no chunk, or whole")
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    data = _unpack(chunk)
    if len(data) == chunk.uncompressed_size and zlib.crc32(data) != chunk.uncompressed_crc:
        raise RecordingError("its checksum is wrong")
    end = 0
    while len(data) >= end + _HEAD.size:
        after = end + _HEAD.size + _HEAD.unpack_from(data, end)[1]
        if after > len(data):
            break
        end = after
    return replace(
        chunk, compression="", data=data[:end], uncompressed_size=end, uncompressed_crc=0
    )


def _check_lengths(data: bytes) -> None:
    """Refuses records that do not lie end to end:
    mcap's reader believes the length of few, `chunk_rows` that of all.
    """
    start = 0
    while start < len(data):
        kind, length = _HEAD.unpack_from(data, start)
        start += _HEAD.size + length
        if kind == Opcode.MESSAGE and length < _BEFORE_PAYLOAD:
            raise RecordingError("has a message without its head")
    if start != len(data):
        raise RecordingError("ends inside of a record")


def _unpack(chunk: Chunk) -> bytes:
    """The bytes of a chunk, no more than it says."""
    if chunk.uncompressed_size > RECORD_MAX:
        raise RecordingError(f"claims {chunk.uncompressed_size} bytes")
    if chunk.compression == "":
        return chunk.data
    if chunk.compression != "zstd":
        raise RecordingError(f"is compressed by '{chunk.compression}', not by zstd")
    unpacker = zstandard.ZstdDecompressor(max_window_size=RECORD_MAX)
    with unpacker.stream_reader(BytesIO(chunk.data)) as stream:
        return stream.read(chunk.uncompressed_size)
