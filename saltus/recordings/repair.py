"""Writes what is sound of a damaged recording as a whole file, which every reader of MCAP opens."""

import json
from pathlib import Path

from mcap.records import Message
from mcap.stream_reader import breakup_chunk
from mcap.writer import CompressionType, Writer

from saltus.errors import RecordingError
from saltus.files import atomic_write
from saltus.recordings.recorded_file import is_recording
from saltus.recordings.recorder import CHUNK_BYTES, LIBRARY, LOST, METADATA, METADATA_END, PROFILE
from saltus.recordings.recording import Recording, read_recording


def repair_recording(path: Path, out: Path) -> Recording:
    """Writes the sound part of a recording to `out`; what was lost is said in it.

    Returns:
        The recording as it was read: `lost` says what is missing, `complete` that nothing was to be
            repaired.

    Raises:
        RecordingError: it is no recording of Saltus, there already is such a file, or it cannot be
            written.
    """
    recording = read_recording(path)
    if not is_recording(path):
        raise RecordingError(f"{path} is not a recording of Saltus")
    if recording.complete:
        return recording
    try:
        if out.exists():
            raise RecordingError(f"{out} is there already: name another file with --out")
        with atomic_write(out) as partial:
            _write(recording, partial)
    except OSError as error:
        raise RecordingError(f"cannot write {out}: {error.strerror}") from error
    return recording


def _write(recording: Recording, path: Path) -> None:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile=PROFILE, library=LIBRARY)
        if recording.metadata:
            writer.add_metadata(METADATA, recording.metadata)
        schemas = {
            schema.id: writer.register_schema(schema.name, schema.encoding, schema.data)
            for schema in recording.schemas.values()
        }
        channels = {
            channel.id: writer.register_channel(
                channel.topic,
                channel.message_encoding,
                schemas[channel.schema_id],
                channel.metadata,
            )
            for channel in recording.channels.values()
            if channel.schema_id in schemas
        }
        for chunk in recording.chunks:
            for record in breakup_chunk(chunk):
                if isinstance(record, Message) and record.channel_id in channels:
                    writer.add_message(
                        channels[record.channel_id],
                        record.log_time,
                        record.data,
                        record.publish_time,
                        record.sequence,
                    )
        writer.add_metadata(METADATA_END, recording.summary | {LOST: json.dumps(recording.lost)})
        writer.finish()
