"""A damaged recording reads up to the damage, and is repaired."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.records import Message as Record
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer
from recorded import STEPS, payloads, run_samples, write

from saltus.errors import RecordingError
from saltus.recordings.recording import Recording, read_recording
from saltus.recordings.repair import repair_recording

# Magic, head of the record, its two texts
HEADER_BYTES = 8 + 9 + 4 + len("ros2") + 4 + len("saltus")
BLOCK_BYTES = 128 * 1024  # at most, of zstd


def in_order(path: Path) -> list[tuple[str, int, bytes]]:
    """All messages of a file in its order, as another reader has them."""
    with path.open("rb") as file:
        reader = make_reader(file)
        return [
            (c.topic, m.sequence, m.data) for _, c, m in reader.iter_messages(log_time_order=False)
        ]


def chunk_ends(path: Path) -> list[tuple[int, int]]:
    """Ends of the chunks of a whole file [bytes],
    and how many messages the file has up to there.
    """
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        ends = []
        for index in summary.chunk_indexes:
            end = index.chunk_start_offset + index.chunk_length
            file.seek(index.chunk_start_offset)
            chunk = next(StreamReader(file, skip_magic=True, emit_chunks=True).records)
            assert isinstance(chunk, Chunk)
            count = sum(isinstance(record, Record) for record in breakup_chunk(chunk))
            ends.append((end, count + (ends[-1][1] if ends else 0)))
    return ends


@given(share=st.floats(0.0, 1.0))
@settings(max_examples=40, deadline=None)
@example(share=1.0)
def test_a_file_cut_off_at_any_byte_has_every_message_before_the_cut(
    share: float, whole: Recording, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """And a repaired one is a whole file to other readers,
    which still says that something was lost.
    """
    data, full = whole.path.read_bytes(), in_order(whole.path)
    cut = min(round(share * len(data)), len(data) - 1)
    path, out = (tmp_path_factory.getbasetemp() / name for name in ("cut.mcap", "repaired.mcap"))
    path.write_bytes(data[:cut])
    out.unlink(missing_ok=True)
    if cut < HEADER_BYTES:
        with pytest.raises(RecordingError, match="not a recording"):
            read_recording(path)
        return
    recording = repair_recording(path, out)
    assert not recording.complete
    assert recording.lost
    before = in_order(out)
    assert before == full[: len(before)]
    assert len(before) >= max(
        (count for end, count in chunk_ends(whole.path) if end <= cut), default=0
    )
    again = read_recording(out)
    assert (again.lost, again.complete) == (recording.lost, False)
    assert again.config == recording.config
    assert payloads(again) == payloads(recording)


def test_of_a_chunk_that_was_cut_all_is_read_but_the_last_block(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    write(path, list(run_samples(4 * STEPS)))
    (end, count), *_ = chunk_ends(path)
    full, data = in_order(path), path.read_bytes()
    sizes = np.cumsum([len(payload) for _, _, payload in full[:count]])
    assert sizes[-1] > 1.5 * BLOCK_BYTES
    path.write_bytes(data[: end - 1])
    repair_recording(path, tmp_path / "repaired.mcap")
    assert len(in_order(tmp_path / "repaired.mcap")) >= np.searchsorted(
        sizes, sizes[-1] - BLOCK_BYTES
    )


def test_repairing_keeps_what_is_there_and_other_files(whole: Recording, tmp_path: Path) -> None:
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    cut.write_bytes(whole.path.read_bytes()[:-9])
    out.write_text("kept")
    with pytest.raises(RecordingError, match="is there already"):
        repair_recording(cut, out)
    assert repair_recording(whole.path, tmp_path / "new.mcap").complete
    foreign = tmp_path / "foreign.mcap"
    with foreign.open("wb") as file:
        writer = Writer(file)
        writer.start()
    with pytest.raises(RecordingError, match="not a recording of Saltus"):
        repair_recording(foreign, tmp_path / "new.mcap")
    assert out.read_text() == "kept"
    assert {path.name for path in tmp_path.iterdir()} == {"cut.mcap", "out.mcap", "foreign.mcap"}


def test_a_chunk_that_unpacks_to_more_than_it_says_takes_no_more_memory(
    whole: Recording, tmp_path: Path
) -> None:
    path = tmp_path / "bomb.mcap"
    bomb = zstandard.compress(bytes(2**30))
    for claimed in (1000, 2**30, 2**63):
        chunk = Chunk(compression="zstd", data=bomb, message_end_time=0, message_start_time=0,
            uncompressed_crc=0,
                      uncompressed_size=claimed)  # fmt: skip
        record = RecordBuilder()
        chunk.write(record)
        data = whole.path.read_bytes()
        path.write_bytes(data[:HEADER_BYTES] + record.end() + data[HEADER_BYTES:])
        tracemalloc.start()
        recording = read_recording(path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 20e6
        assert len(recording.lost) == 1
        assert payloads(recording) == payloads(whole)


@given(position=st.integers(0, 10**9), mask=st.integers(1, 255))
@settings(max_examples=30, deadline=None)
def test_a_flipped_byte_never_changes_a_message(
    whole: Recording, tmp_path_factory: pytest.TempPathFactory, position: int, mask: int
) -> None:
    data = bytearray(whole.path.read_bytes())
    data[position % len(data)] ^= mask
    path = tmp_path_factory.getbasetemp() / "flipped.mcap"
    path.write_bytes(data)
    try:
        recording = read_recording(path)
        part = payloads(recording)
    except RecordingError:
        return  # not a recording any more, or not of this version
    full = payloads(whole)
    assert set(part) <= set(full)
    if len(part) < len(full):
        assert not recording.complete
        assert recording.lost


@given(data=st.binary(max_size=200))
def test_other_files_are_refused(data: bytes, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.getbasetemp() / "other.mcap"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="not a recording"):
        read_recording(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"cannot read .*none.mcap"):
        read_recording(tmp_path / "none.mcap")
