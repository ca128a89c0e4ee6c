"""Recordings: what is written is read."""

import gc
import os
import signal
import struct
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.writer import CompressionType, Writer
from recorded import (
    SENDER,
    STEPS,
    TERRAIN,
    depth,
    payloads,
    raw,
    run_messages,
    run_samples,
    write,
)
from samples import ROBOT, setup_of

from saltus.config import RunConfig, TerrainConfig
from saltus.errors import RecordingError
from saltus.grid import LINE
from saltus.interrupts import WHOLE
from saltus.recordings import indexed_writer, recorder
from saltus.recordings.indexed_writer import IndexedWriter
from saltus.recordings.recorder import Recorder
from saltus.recordings.recording import Recording, read_recording
from saltus.recordings.summary import run_sentence, summarise_run
from saltus.recordings.timing import rates_and_ages, run_digest
from saltus.wire import cdr, codec, messages
from saltus.wire.bus import MessageStream, RawSample
from saltus.wire.codec import Envelope
from saltus.wire.schemas import TYPE_NAME
from saltus.wire.topics import TOPICS


def test_what_is_written_is_read(whole: Recording) -> None:
    assert whole.complete
    assert whole.lost == []
    assert whole.config == RunConfig(
        robot="go1", grid="line", seed=7, terrain=TerrainConfig(terrain="gap")
    )
    sent = {topic: [s for s in run_samples() if s.key.startswith(topic)] for topic in TOPICS}
    for topic, samples in sent.items():
        read = list(whole.payloads(topic))
        assert [payload for _, _, payload in read] == [s.payload for s in samples]
        assert [envelope.to_bytes() for _, envelope, _ in read] == [s.attachment for s in samples]
    assert set(whole.topics()) == {topic for topic, samples in sent.items() if samples}
    for _, envelope, message in whole.messages("camera/depth"):
        np.testing.assert_array_equal(message.depth, depth(2 * envelope.sequence - 2).depth)  # type: ignore[union-attr]
    assert (
        len(list(whole.messages("status/controller")))
        == len(list(whole.messages("status")))
        == STEPS
    )


def test_what_a_prompt_shows_of_values_fits_on_it(whole: Recording) -> None:
    assert repr(whole) == f"Recording(path={whole.path!r}, complete=True, lost=[])"
    assert len(repr(whole.robot)) < 4000  # without the text of its model


def test_another_reader_opens_it_and_finds_the_definitions(whole: Recording) -> None:
    with whole.path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    schemas = {schema.name: schema for schema in summary.schemas.values()}
    assert {
        TYPE_NAME[messages.Heightmap],
        "sensor_msgs/msg/Image",
        "tf2_msgs/msg/TFMessage",
    } <= set(schemas)
    assert {schema.encoding for schema in schemas.values()} == {"ros2msg"}
    topics = {channel.topic for channel in summary.channels.values()}
    assert {
        f"/viewer/{name}" for name in ("depth", "camera_info", "tf", "heightmap", "terrain")
    } <= topics
    assert {channel.metadata["boot_id"] for channel in summary.channels.values()} == {SENDER.hex()}
    for channel in summary.channels.values():
        name = summary.schemas[channel.schema_id].name
        assert channel.message_encoding == "cdr"
        assert b"MSG: std_msgs/Header" in schemas[name].data or name == "rcl_interfaces/msg/Log"


def test_fields_of_another_version_are_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`half_width_90` was called `std` once, and meant something else in the same place."""
    definition_of = cdr.ros2msg_definition
    monkeypatch.setattr(
        cdr, "ros2msg_definition", lambda name: definition_of(name).replace("half_width_90", "std")
    )
    older = write(tmp_path / "older.mcap", list(run_samples(3)))
    monkeypatch.undo()
    assert len(list(older.messages("controller/state"))) == 3
    with pytest.raises(
        RecordingError, match=r"older.mcap: heightmap/heightmap .*'float64\[\] std'"
    ):
        list(older.messages("heightmap/heightmap"))


def test_a_recording_holds_its_robot_and_grid(whole: Recording) -> None:
    assert whole.robot == ROBOT
    # Its prefix stood there
    older = Recording(whole.path, config=RunConfig(robot="go1/0", grid="line"))
    assert older.robot == ROBOT
    assert Recording(whole.path).robot == ROBOT
    assert whole.grid == older.grid == Recording(whole.path).grid == LINE


def test_what_was_flushed_survives_the_writer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)
    path = tmp_path / "recording.mcap"
    file = Recorder(path, RunConfig(robot="go1", grid="line"), setup_of(TERRAIN))
    for sample in run_samples(5):
        file.write(sample)
    time.sleep(0.001)
    file.flush()
    recording = read_recording(path)
    assert not recording.complete
    assert len(list(recording.messages("controller/state"))) == 5
    file.close()
    assert read_recording(path).complete


@pytest.mark.parametrize("missed", [0, 3])
def test_what_came_too_fast_is_told(missed: int, tmp_path: Path) -> None:
    with Recorder(
        tmp_path / "recording.mcap", RunConfig(robot="go1", grid="line"), setup_of(TERRAIN)
    ) as file:
        file.missed = missed
    lost = read_recording(tmp_path / "recording.mcap").lost
    assert lost == (
        [f"{missed} messages, which came faster than they were recorded"] if missed else []
    )


def test_what_was_flushed_is_given_to_the_disk_soon_and_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[int] = []
    monkeypatch.setattr(recorder.os, "fdatasync", lambda file: given.append(os.fstat(file).st_size))
    monkeypatch.setattr(recorder, "SYNC_S", 0.01)
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)
    path = tmp_path / "recording.mcap"
    with Recorder(path, RunConfig(robot="go1", grid="line"), setup_of(TERRAIN)) as file:
        for sample in run_samples(5):
            file.write(sample)
        time.sleep(0.001)
        file.flush()
        flushed, until_s = path.stat().st_size, time.monotonic() + 10.0
        while given[-1:] != [flushed]:
            assert time.monotonic() < until_s
            time.sleep(0.001)
    assert given[-1] == path.stat().st_size > flushed


def test_the_index_of_a_long_recording_takes_no_memory_and_says_where_everything_is(
    tmp_path: Path,
) -> None:
    """It is written as the library would write it, to the byte."""
    rng = np.random.default_rng(5)
    path, plain = tmp_path / "run.mcap", BytesIO()
    chunks, channels = 300, range(1, 15)
    theirs = Writer(plain, chunk_size=200, compression=CompressionType.ZSTD)
    theirs.start(profile="ros2", library="saltus")
    with (
        path.open("wb") as file,
        closing(
            IndexedWriter(file, tmp_path, chunk_bytes=200, profile="ros2", library="saltus")
        ) as ours,
    ):
        assert list(tmp_path.iterdir()) == [path]  # nothing is left of it, however the process ends
        for writer in (ours, theirs):
            writer.add_metadata("run", {"seed": "7"})
            assert writer.register_schema("Plan", "ros2msg", b"int8 kind") == 1
            assert [
                writer.register_channel(f"/{number}", "cdr", 1, {}) for number in channels
            ] == list(channels)
        tracemalloc.start()
        for chunk in range(chunks):
            for channel in channels[: int(rng.integers(1, 15))]:
                time_ns, data = int(rng.integers(10**9)), rng.bytes(int(rng.integers(8)))
                record = Message(
                    channel_id=channel,
                    log_time=time_ns,
                    data=data,
                    publish_time=chunk,
                    sequence=chunk,
                )
                ours.add_message(record)
                theirs.add_message(channel, time_ns, data, chunk, chunk)
            for writer in (ours, theirs):
                writer.flush()
        snapshot = tracemalloc.take_snapshot().filter_traces(
            [tracemalloc.Filter(True, indexed_writer.__file__)]
        )
        tracemalloc.stop()
        for writer in (ours, theirs):
            writer.finish()
    assert path.read_bytes() == plain.getvalue()
    plain.seek(0)
    assert len(make_reader(plain).get_summary().chunk_indexes) >= chunks  # type: ignore[union-attr]
    assert sum(trace.size for trace in snapshot.traces) < 10_000  # 0.3 MB as a list of objects


def test_malformed_samples_are_counted_not_recorded(tmp_path: Path) -> None:
    good = raw("policy/plan", next(m for k, m in run_messages(0) if k == "policy/plan"), 1)
    path = tmp_path / "recording.mcap"
    with Recorder(path, RunConfig(robot="go1", grid="line"), setup_of(TERRAIN)) as file:
        for bad in (
            replace(good, payload=b""),
            replace(good, attachment=b""),
            replace(good, payload=good.payload[:-1]),
        ):
            file.write(bad)
        file.write(replace(good, key="nonsense/key"))
        file.write(good)
    assert file.rejected == {
        f"policy/plan/{reason}": 1 for reason in ("empty", "envelope", "malformed")
    }
    assert len(payloads(read_recording(path))) == 1


def test_the_digest_is_that_of_the_run_not_of_the_file(whole: Recording, tmp_path: Path) -> None:
    samples = list(run_samples())
    expected = run_digest(whole)
    later = [replace(s, arrival_ns=s.arrival_ns + 10**9) for s in samples]
    assert run_digest(write(tmp_path / "later.mcap", later)) == expected
    reordered = sorted(samples, key=lambda s: s.key)
    assert run_digest(write(tmp_path / "reordered.mcap", reordered)) == expected
    shorter = [s for s in samples if not s.key.startswith("camera")]
    assert run_digest(write(tmp_path / "shorter.mcap", shorter)) == expected


@pytest.mark.parametrize("topic", ["heightmap/heightmap", "policy/plan", "controller/state"])
def test_the_digest_sees_every_bit_and_every_gap(
    whole: Recording, tmp_path: Path, topic: str
) -> None:
    samples = list(run_samples())
    index = [i for i, s in enumerate(samples) if s.key == topic][STEPS // 2]
    payload = bytearray(samples[index].payload)
    payload[16] ^= 1  # the lowest bit of the step, or of the header's frame
    kind = TOPICS[topic].message
    changed = codec.encode_message(
        replace(codec.decode_message(kind, samples[index].payload), step=12345)
    )  # type: ignore[call-arg]
    altered = [*samples[:index], replace(samples[index], payload=changed), *samples[index + 1 :]]
    assert run_digest(write(tmp_path / "altered.mcap", altered)) != run_digest(whole)
    with pytest.raises(RecordingError, match=f"{topic} {STEPS // 2 + 1} is missing"):
        run_digest(write(tmp_path / "gap.mcap", [*samples[:index], *samples[index + 1 :]]))


def asked_again(samples: Iterable[RawSample], seed: int) -> Iterator[RawSample]:
    """Each message up to three times, under a new number each time.

    Statuses are not answers, and come once.
    """
    rng, numbers = np.random.default_rng(seed), Counter[str]()
    for sample in samples:
        _, capture_ns = struct.unpack_from("<qq", sample.attachment)
        for _ in range(1 if sample.key.startswith("status") else rng.integers(1, 4)):
            numbers[sample.key] += 1
            yield replace(
                sample, attachment=Envelope(numbers[sample.key], capture_ns, SENDER).to_bytes()
            )


@pytest.mark.parametrize("seed", range(3))
def test_a_recording_holds_each_message_once_however_often_a_step_was_asked(
    whole: Recording, tmp_path: Path, seed: int
) -> None:
    samples = list(asked_again(run_samples(), seed))
    recording = write(tmp_path / "asked.mcap", samples)
    assert len(samples) > 1.5 * len(list(run_samples()))
    assert payloads(recording) == payloads(whole)
    assert recording.topics() == whole.topics()
    assert run_digest(recording) == run_digest(whole)
    assert all(timing.lost == 0 for timing in rates_and_ages(recording).values())
    plans = [s for s in samples if s.key == "policy/plan"]
    lost = [s for s in plans if codec.decode_message(messages.MotionPlan, s.payload).step == 7]
    gone = [s for s in samples if s not in lost]
    with pytest.raises(RecordingError, match="policy/plan 8 is missing"):
        run_digest(write(tmp_path / "lost.mcap", gone))


def test_in_real_time_all_is_recorded_that_is_sent(tmp_path: Path) -> None:
    samples = list(asked_again(run_samples(), 0))
    assert len(payloads(write(tmp_path / "sent.mcap", samples, "realtime"))) == len(samples)


def test_rates_and_ages_in_real_time(tmp_path: Path) -> None:
    epoch_ns = 123_456_789
    timing = rates_and_ages(
        write(
            tmp_path / "recording.mcap", list(run_samples(epoch_ns=epoch_ns)), "realtime", epoch_ns
        )
    )
    for topic in ("controller/state", "policy/plan", "plant/truth"):
        assert timing[topic].rate_hz == pytest.approx(100.0)
        assert timing[topic].age_p50_ms == pytest.approx(3.0)
        assert timing[topic].age_p99_ms == pytest.approx(3.0)
        assert timing[topic].lost == 0
        assert timing[topic].count == STEPS


def test_ages_in_lockstep_are_simulated(whole: Recording) -> None:
    timing = rates_and_ages(whole)
    assert timing["heightmap/heightmap"].age_p99_ms == 0.0
    assert timing["camera/depth"].age_p50_ms == pytest.approx(50.0)
    assert timing["controller/state"].rate_hz == pytest.approx(100.0)


def test_losses_are_counted_from_the_sequence(tmp_path: Path) -> None:
    samples = [s for i, s in enumerate(run_samples()) if i % 3 or s.key != "policy/plan"]
    sent = sum(s.key == "policy/plan" for s in run_samples())
    recording = write(tmp_path / "recording.mcap", samples)
    timing = rates_and_ages(recording)["policy/plan"]
    assert 0 < timing.lost <= sent - timing.count
    assert f"; the recording lacks {timing.lost} messages" in run_sentence(summarise_run(recording))


@contextmanager
def interrupted_often() -> Iterator[Callable[[bool], None]]:
    """Signals anywhere between two steps of Python, some thousand times a second.

    The first of them after what it gives was called with true, and not yet with false, interrupts.
    """
    armed = False

    def handle(*_: object) -> None:
        nonlocal armed
        if armed:
            armed = False
            WHOLE.interrupt(KeyboardInterrupt())

    def arm(value: bool) -> None:
        nonlocal armed
        armed = value

    before = signal.signal(signal.SIGALRM, handle)
    # Python swallows what is raised in a callback of its collector, and Hypothesis leaves one there
    gc.disable()
    signal.setitimer(signal.ITIMER_REAL, 2e-4, 2e-4)
    try:
        yield arm
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        gc.enable()


def test_signals_tear_no_message_of_a_recording(tmp_path: Path) -> None:
    interrupted = 0
    samples = list(run_samples(20 * STEPS))
    with recorder_of(tmp_path) as file, interrupted_often() as arm:
        for sample in samples:
            try:
                arm(True)
                file.write(sample)
                arm(False)
            except KeyboardInterrupt:
                interrupted += 1
    assert interrupted > 50
    assert len(samples) - interrupted <= messages_of(tmp_path) <= len(samples)


def test_signals_lose_no_message_of_a_stream(tmp_path: Path) -> None:
    interrupted = 0
    samples, stream = list(run_samples(20 * STEPS)), MessageStream()
    with recorder_of(tmp_path) as file, interrupted_often() as arm:
        for first in range(0, len(samples), 5):
            for sample in samples[first : first + 5]:
                stream.push(sample)
            try:
                arm(True)
                file.write_all(stream)
                arm(False)
            except KeyboardInterrupt:
                interrupted += 1
        file.write_all(stream)
    assert interrupted > 50
    assert messages_of(tmp_path) == len(samples)


def recorder_of(folder: Path) -> Recorder:
    config = RunConfig(
        robot="go1", grid="line", pace="lockstep", terrain=TerrainConfig(terrain="gap")
    )
    return Recorder(folder / "run.mcap", config, setup_of(TERRAIN))


def messages_of(folder: Path) -> int:
    recording = read_recording(folder / "run.mcap")
    assert recording.complete
    return sum(1 for topic in TOPICS for _ in recording.messages(topic))
