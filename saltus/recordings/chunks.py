"""Chunks of a recording that may be damaged: unpacked into bounded memory, and read up to where a file was cut off."""

import struct
import zlib
from dataclasses import replace
from io import BytesIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk, McapRecord
from mcap.stream_reader import breakup_chunk

from saltus.errors import RecordingError

RECORD_MAX = 32 * 2**20  # bytes; a chunk is 256 KiB and one message at most 4 MiB longer
_HEAD = struct.Struct("<BQ")  # of a record: kind and length


def sound_records(chunk: Chunk) -> list[McapRecord]:
    """The records of a whole chunk; an error of any kind where it is damaged."""
    data = _unpack(chunk)
    if len(data) != chunk.uncompressed_size:
        raise RecordingError(f"has {len(data)} bytes in place of {chunk.uncompressed_size}")
    return breakup_chunk(replace(chunk, compression="", data=data), validate_crc=True)


def torn_chunk(end_of_file: bytes) -> Chunk:
    """The whole messages of a chunk inside of which a file ends, as a chunk; an error of any kind where there is none.

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
    return replace(chunk, compression="", data=data[:end], uncompressed_size=end, uncompressed_crc=0)


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
