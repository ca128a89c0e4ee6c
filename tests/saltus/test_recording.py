"""Recordings: what is written is read, and a damaged file reads up to the damage."""

import struct
import time
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

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
from samples import ROBOT

from saltus.config import Pace, RunConfig, TerrainConfig
from saltus.depth_camera import SHIPPED
from saltus.errors import RecordingError
from saltus.recordings import recorder
from saltus.recordings.recorder import Recorder
from saltus.recordings.recording import Recording, digest, rates_and_ages, read_recording
from saltus.recordings.repair import repair
from saltus.terrain.curriculum import make_terrain
from saltus.wire import codec, messages
from saltus.wire.bus import RawSample
from saltus.wire.codec import Envelope
from saltus.wire.messages import Message
from saltus.wire.schemas import TYPE_NAME
from saltus.wire.topics import TOPICS

MS = 1_000_000
SENDER = b"0123456789abcdef"
STEPS = 40
LATENCY_NS = 3 * MS
HEADER_BYTES = 8 + 9 + 4 + len("ros2") + 4 + len("saltus")  # magic, head of the record, its two texts
BLOCK_BYTES = 128 * 1024  # at most, of zstd
TERRAIN = make_terrain(TerrainConfig())


def depth(step: int) -> messages.DepthFrame:
    pixels = np.random.default_rng(step).integers(0, 3000, (48, 16), dtype=np.uint16)
    pixels[0, :2] = 0, 65535
    return messages.DepthFrame(
        time_ns=max(0, step * 10 - 50) * MS, frame_id=step // 2, depth=pixels, depth_unit_m=0.001,
        fx=213.5, fy=213.5, cx=8.0, cy=24.0,
    )  # fmt: skip


def unit_quaternion(rng: np.random.Generator) -> np.ndarray:
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def run_messages(step: int) -> Iterator[tuple[str, Message]]:
    """What the processes say at one step."""
    rng = np.random.default_rng(step)
    now: dict[str, Any] = {"time_ns": step * 10 * MS, "step": step}
    pose: dict[str, Any] = {
        "quaternion_base_in_world": unit_quaternion(rng),
        "velocity_base_in_world": rng.normal(size=3),
        "angular_velocity_base": rng.normal(size=3),
        "joint_position": rng.normal(size=12),
    }
    rows = {
        name: rng.normal(size=(5, 12))
        for name in (
            "position", "velocity", "position_desired", "velocity_desired",
            "torque_feedforward", "torque_estimated", "kp", "kd",
        )
    }  # fmt: skip
    rows |= {gain: np.abs(rows[gain]) for gain in ("kp", "kd")}
    yield (
        "plant/truth",
        messages.GroundTruth(
            **now, **pose, position_base_in_world=rng.normal(size=3), foot_force=rng.random(4), height=rng.random(30)
        ),
    )
    if step % 2 == 0:
        yield "camera/depth", depth(step)
    yield (
        "controller/state",
        messages.RobotState(
            **now, **pose, acceleration_base=rng.normal(size=3), joint_velocity=rng.normal(size=12),
            joint_torque=rng.normal(size=12), base_height=0.27, leg_contact=np.ones(4, bool), leg_progress=np.zeros(4),
            leg_trusted=np.ones(4, bool), cycle=step // 30, mode=messages.ControllerMode.RUN, depth_due=-1,
        ),
    )  # fmt: skip
    yield (
        "heightmap/heightmap",
        messages.Heightmap(
            **now, x=np.linspace(-0.4, 0.8, 30), height=rng.normal(size=30), half_width_90=rng.random(30),
            status=messages.HeightmapStatus.OK, depth_age_s=0.05, frame_id=3, model_id="0123456789abcdef",
        ),
    )  # fmt: skip
    yield (
        "policy/plan",
        messages.MotionPlan(
            **now, status=messages.PlanStatus.GO, stepping_frequency_hz=3.0, velocity_x=1.0, velocity_z=0.0,
            pitch_rate=0.0, foot_residual_front=np.zeros(3), foot_residual_rear=np.zeros(3), reason="",
        ),
    )  # fmt: skip
    yield "controller/joints", messages.JointLog(**now, dt_s=0.002, **rows)
    yield (
        "status/controller",
        messages.ProcessStatus(time_ns=step * 10 * MS, process="controller", ready=True, ticks=step, overruns=0),
    )


def raw(key: str, message: Message, sequence: int, epoch_ns: int = 0) -> RawSample:
    envelope = Envelope(sequence, message.time_ns, SENDER)
    return RawSample(key, codec.encode(message), envelope.to_bytes(), epoch_ns + message.time_ns + LATENCY_NS)


def run_samples(steps: int = STEPS, epoch_ns: int = 0) -> Iterator[RawSample]:
    count: dict[str, int] = {}
    for step in range(steps):
        for key, message in run_messages(step):
            count[key] = count.get(key, 0) + 1
            yield raw(key, message, count[key], epoch_ns)


def write(path: Path, samples: list[RawSample], pace: Pace = "lockstep", epoch_ns: int = 0) -> Recording:
    config = RunConfig(pace=pace, seed=7, epoch_ns=epoch_ns, terrain=TerrainConfig(terrain="gap"))
    with Recorder(path, config, ROBOT, make_terrain(config.terrain), SHIPPED["ideal"]) as file:
        for sample in samples:
            file.write(sample)
    return read_recording(path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    patch = pytest.MonkeyPatch()
    patch.setattr(recorder, "CHUNK_BYTES", 16 * 1024)  # many chunks in a short run
    path = tmp_path_factory.mktemp("recording") / "recording.mcap"
    recording = write(path, list(run_samples()))
    patch.undo()
    return recording


def payloads(recording: Recording) -> list[tuple[str, int, bytes]]:
    return [(t, e.sequence, p) for t in TOPICS for _, e, p in recording.payloads(t)]


def test_what_is_written_is_read(whole: Recording) -> None:
    assert whole.complete
    assert whole.lost == []
    assert whole.config == RunConfig(seed=7, terrain=TerrainConfig(terrain="gap"))
    sent = {topic: [s for s in run_samples() if s.key.startswith(topic)] for topic in TOPICS}
    for topic, samples in sent.items():
        read = list(whole.payloads(topic))
        assert [payload for _, _, payload in read] == [s.payload for s in samples]
        assert [envelope.to_bytes() for _, envelope, _ in read] == [s.attachment for s in samples]
    assert set(whole.topics()) == {topic for topic, samples in sent.items() if samples}
    for _, envelope, message in whole.messages("camera/depth"):
        np.testing.assert_array_equal(message.depth, depth(2 * envelope.sequence - 2).depth)  # type: ignore[union-attr]
    assert len(list(whole.messages("status/controller"))) == len(list(whole.messages("status"))) == STEPS


def test_another_reader_opens_it_and_finds_the_definitions(whole: Recording) -> None:
    with whole.path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    schemas = {schema.name: schema for schema in summary.schemas.values()}
    assert {TYPE_NAME[messages.Heightmap], "sensor_msgs/msg/Image", "tf2_msgs/msg/TFMessage"} <= set(schemas)
    assert {schema.encoding for schema in schemas.values()} == {"ros2msg"}
    topics = {channel.topic for channel in summary.channels.values()}
    assert {f"/viewer/{name}" for name in ("depth", "camera_info", "tf", "heightmap", "terrain")} <= topics
    assert {channel.metadata["boot_id"] for channel in summary.channels.values()} == {SENDER.hex()}
    for channel in summary.channels.values():
        name = summary.schemas[channel.schema_id].name
        assert channel.message_encoding == "cdr"
        assert b"MSG: std_msgs/Header" in schemas[name].data or name == "rcl_interfaces/msg/Log"


def test_viewer_messages_parse_as_their_ros_types(whole: Recording) -> None:
    with whole.path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            wire = codec.STORE.deserialize_cdr(message.data, schema.name)
            if channel.topic == "/viewer/heightmap":
                assert wire.width == 30  # type: ignore[attr-defined]
            if channel.topic == "/viewer/tf":
                rotations = [t.transform.rotation for t in wire.transforms]  # type: ignore[attr-defined]
                norms = [r.x**2 + r.y**2 + r.z**2 + r.w**2 for r in rotations]
                np.testing.assert_allclose(norms, 1.0, rtol=1e-12)


def in_order(path: Path) -> list[tuple[str, int, bytes]]:
    """All messages of a file in its order, as another reader has them."""
    with path.open("rb") as file:
        reader = make_reader(file)
        return [(c.topic, m.sequence, m.data) for _, c, m in reader.iter_messages(log_time_order=False)]


def chunk_ends(path: Path) -> list[tuple[int, int]]:
    """Where each chunk of a whole file ends [bytes], and how many messages the file has up to there."""
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
@settings(max_examples=100, deadline=None)
@example(share=1.0)
def test_a_file_cut_off_at_any_byte_has_every_message_before_the_cut(
    share: float, whole: Recording, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """And a repaired one is a whole file to other readers, which still says that something was lost."""
    data, full = whole.path.read_bytes(), in_order(whole.path)
    cut = min(round(share * len(data)), len(data) - 1)
    path, out = (tmp_path_factory.getbasetemp() / name for name in ("cut.mcap", "repaired.mcap"))
    path.write_bytes(data[:cut])
    out.unlink(missing_ok=True)
    if cut < HEADER_BYTES:
        with pytest.raises(RecordingError, match="not a recording"):
            read_recording(path)
        return
    recording = repair(path, out)
    assert not recording.complete
    assert recording.lost
    before = in_order(out)
    assert before == full[: len(before)]
    assert len(before) >= max((count for end, count in chunk_ends(whole.path) if end <= cut), default=0)
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
    repair(path, tmp_path / "repaired.mcap")
    assert len(in_order(tmp_path / "repaired.mcap")) >= np.searchsorted(sizes, sizes[-1] - BLOCK_BYTES)


def test_repairing_keeps_what_is_there_and_other_files(whole: Recording, tmp_path: Path) -> None:
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    cut.write_bytes(whole.path.read_bytes()[:-9])
    out.write_text("kept")
    with pytest.raises(RecordingError, match="is there already"):
        repair(cut, out)
    assert repair(whole.path, tmp_path / "new.mcap").complete
    foreign = tmp_path / "foreign.mcap"
    with foreign.open("wb") as file:
        writer = Writer(file)
        writer.start()
    with pytest.raises(RecordingError, match="not a recording of Saltus"):
        repair(foreign, tmp_path / "new.mcap")
    assert out.read_text() == "kept"
    assert {path.name for path in tmp_path.iterdir()} == {"cut.mcap", "out.mcap", "foreign.mcap"}


def test_a_chunk_that_unpacks_to_more_than_it_says_takes_no_more_memory(whole: Recording, tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    bomb = zstandard.compress(bytes(2**30))
    for claimed in (1000, 2**30, 2**63):
        chunk = Chunk(compression="zstd", data=bomb, message_end_time=0, message_start_time=0, uncompressed_crc=0,
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
@settings(max_examples=60, deadline=None)
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


def test_fields_of_another_version_are_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`half_width_90` was called `std` once, and meant something else in the same place."""
    definition_of = codec.definition_of
    monkeypatch.setattr(codec, "definition_of", lambda name: definition_of(name).replace("half_width_90", "std"))
    older = write(tmp_path / "older.mcap", list(run_samples(3)))
    monkeypatch.undo()
    assert len(list(older.messages("controller/state"))) == 3
    with pytest.raises(RecordingError, match=r"older.mcap: heightmap/heightmap .*'float64\[30\] std'"):
        list(older.messages("heightmap/heightmap"))


def test_a_recording_holds_its_robot(whole: Recording) -> None:
    assert whole.robot == ROBOT
    older = Recording(whole.path, config=RunConfig(robot="go1/0"))  # its prefix stood there
    assert older.robot == ROBOT
    assert Recording(whole.path).robot == ROBOT


def test_what_was_flushed_survives_the_writer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)
    path = tmp_path / "recording.mcap"
    file = Recorder(path, RunConfig(), ROBOT, TERRAIN, SHIPPED["ideal"])
    for sample in run_samples(5):
        file.write(sample)
    time.sleep(0.001)
    file.flush()
    recording = read_recording(path)
    assert not recording.complete
    assert len(list(recording.messages("controller/state"))) == 5
    file.close()
    assert read_recording(path).complete


def test_malformed_samples_are_counted_not_recorded(tmp_path: Path) -> None:
    good = raw("policy/plan", next(m for k, m in run_messages(0) if k == "policy/plan"), 1)
    path = tmp_path / "recording.mcap"
    with Recorder(path, RunConfig(), ROBOT, TERRAIN, SHIPPED["ideal"]) as file:
        for bad in (
            replace(good, payload=b""),
            replace(good, attachment=b""),
            replace(good, payload=good.payload[:-1]),
        ):
            file.write(bad)
        file.write(replace(good, key="nonsense/key"))
        file.write(good)
    assert file.rejected == {f"policy/plan/{reason}": 1 for reason in ("empty", "envelope", "malformed")}
    assert len(payloads(read_recording(path))) == 1


def test_the_digest_is_that_of_the_run_not_of_the_file(whole: Recording, tmp_path: Path) -> None:
    samples = list(run_samples())
    expected = digest(whole)
    later = [replace(s, arrival_ns=s.arrival_ns + 10**9) for s in samples]
    assert digest(write(tmp_path / "later.mcap", later)) == expected
    reordered = sorted(samples, key=lambda s: s.key)
    assert digest(write(tmp_path / "reordered.mcap", reordered)) == expected
    shorter = [s for s in samples if not s.key.startswith("camera")]
    assert digest(write(tmp_path / "shorter.mcap", shorter)) == expected


@pytest.mark.parametrize("topic", ["heightmap/heightmap", "policy/plan", "controller/state"])
def test_the_digest_sees_every_bit_and_every_gap(whole: Recording, tmp_path: Path, topic: str) -> None:
    samples = list(run_samples())
    index = [i for i, s in enumerate(samples) if s.key == topic][STEPS // 2]
    payload = bytearray(samples[index].payload)
    payload[16] ^= 1  # the lowest bit of the step, or of the header's frame
    kind = TOPICS[topic].message
    changed = codec.encode(replace(codec.decode(kind, samples[index].payload), step=12345))  # type: ignore[call-arg]
    altered = [*samples[:index], replace(samples[index], payload=changed), *samples[index + 1 :]]
    assert digest(write(tmp_path / "altered.mcap", altered)) != digest(whole)
    with pytest.raises(RecordingError, match=f"{topic} {STEPS // 2 + 1} is missing"):
        digest(write(tmp_path / "gap.mcap", [*samples[:index], *samples[index + 1 :]]))


def test_a_message_that_was_resent_counts_once(whole: Recording, tmp_path: Path) -> None:
    samples = list(run_samples())
    index = [i for i, s in enumerate(samples) if s.key == "controller/state"][-1]
    sequence, capture_ns = struct.unpack_from("<qq", samples[index].attachment)
    again = replace(samples[index], attachment=Envelope(sequence + 1, capture_ns, SENDER).to_bytes())
    assert digest(write(tmp_path / "resent.mcap", [*samples, again])) == digest(whole)


def test_rates_and_ages_in_real_time(tmp_path: Path) -> None:
    epoch_ns = 123_456_789
    timing = rates_and_ages(
        write(tmp_path / "recording.mcap", list(run_samples(epoch_ns=epoch_ns)), "realtime", epoch_ns)
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
    timing = rates_and_ages(write(tmp_path / "recording.mcap", samples))["policy/plan"]
    assert 0 < timing.lost <= sent - timing.count
