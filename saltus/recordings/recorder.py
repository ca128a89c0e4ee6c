"""Writes a run as one MCAP file that viewers open and
that survives a crash up to its last half second.

Every topic is a channel of CDR messages with its ROS 2 definition, one channel for each
sender; the channel's metadata hold the sender's boot id. A record keeps the sequence, the capture
time (publish time) and the arrival (log time), all in the run's clock, so that a replay can check
order and age as live.

A recording holds each message once. In lockstep a step is asked again where its answer takes long,
and then answered again, under new numbers: what was said of a step before is not recorded a second
time, and the sequence of what follows is less by one, so that a gap in it means a message that was
lost.
"""

import contextlib
import json
import os
import platform
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from types import TracebackType

from mcap.records import Message as Record

from saltus import config
from saltus.clock import RunClock
from saltus.config import RunConfig
from saltus.errors import MessageError, RecordingError
from saltus.interrupts import WHOLE
from saltus.provenance import current_commit, package_version
from saltus.recordings.indexed_writer import IndexedWriter
from saltus.recordings.ros_messages import stored_definition
from saltus.recordings.viewer import Viewer
from saltus.setup import Setup
from saltus.used_networks import network_names
from saltus.wire import codec
from saltus.wire.bus import MessageStream, RawSample, topic_of, unpack_sample
from saltus.wire.codec import Envelope
from saltus.wire.messages import GroundTruth, Message, RobotState
from saltus.wire.schemas import TYPE_NAME

CHUNK_BYTES = 256 * 1024
FLUSH_S = 0.5  # what a crash may cost
SYNC_S = 1.0  # and a power cut beyond it: a system may keep for 30 s in memory what it was given
LIBRARY = "saltus"
SCHEMA = "saltus-recording/1"
RECORDING_FILE = "recording.mcap"
"""Name of a recording in the folder of its run."""
METADATA = "saltus"
METADATA_END = "saltus/end"
LOST = "lost"
"""Key of the latter: what the recording lacks, as a JSON list of lines."""
PROFILE = "ros2"
PACKAGES = ("saltus", "numpy", "mujoco", "eclipse-zenoh", "onnxruntime", "mcap", "rosbags")
SEQUENCE_MASK = 2**32 - 1  # MCAP counts in a uint32


class Recorder:
    """Writes the recording of one run (MCAP), message by message.

    Raises:
        RecordingError: the file cannot be created, or, from `write` and `close`, no longer be
            written.
    """

    def __init__(self, path: Path, run_config: RunConfig, setup: Setup) -> None:
        self.path = path
        self.rejected: Counter[str] = Counter()
        """Samples that were not recorded because they are malformed, by "topic/reason"."""
        self.missed = 0
        """Samples that came faster than they were recorded, as who calls `write` counts them."""
        self._clock = RunClock.of(run_config)
        self.simulated_ns = 0
        """Lockstep: time of the newest step that was recorded."""
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, bytes], int] = {}
        self._said: dict[tuple[str, bytes], _Said] = {}
        self._viewer = Viewer(setup.robot, setup.terrain)
        for kind in TYPE_NAME:
            codec.prepare(kind)
        self._begun = False
        self._flushed_s = time.monotonic()
        about = describe(run_config, setup)
        with WHOLE:  # a file that is there has a beginning
            with _writing(path):
                # A full disk shows at the first flush
                self._file = path.open("wb", buffering=CHUNK_BYTES)
                self._writer = IndexedWriter(
                    self._file,
                    path.parent,
                    chunk_bytes=CHUNK_BYTES,
                    profile=PROFILE,
                    library=LIBRARY,
                )
            self._writer.add_metadata(METADATA, about)
        self._ended = threading.Event()
        self._syncs = threading.Thread(target=self._sync, name="recording to disk", daemon=True)
        self._syncs.start()

    def write(self, raw: RawSample) -> None:
        """Records one sample of a known topic; counts what is malformed."""
        topic = topic_of(raw.key)
        if topic is None:
            return
        try:
            envelope, message = unpack_sample(topic, raw)
        except MessageError as error:
            self.rejected[f"{topic.name}/{error.reason}"] += 1
            return
        if self._clock.lockstep:
            said = self._said.setdefault((raw.key, envelope.boot_id), _Said())
            if said.before(message):
                return
            envelope = replace(envelope, sequence=envelope.sequence - said.again)
        arrival_ns = self._arrival_ns(raw, message)
        with WHOLE:
            self._add(f"/{raw.key}", TYPE_NAME[type(message)], envelope, arrival_ns, raw.payload)
            # With the first message: its sender and time
            still = [] if self._begun else self._viewer.first()
            self._begun = True
            for derived in (*still, *self._viewer.derive(raw.key, message, arrival_ns)):
                self._add(derived.topic, derived.type_name, envelope, arrival_ns, derived.payload)

    def write_all(self, stream: MessageStream) -> None:
        """Records what has come since the last call; who is interrupted loses nothing of it."""
        with WHOLE:
            for raw in stream.drain():
                self.write(raw)
        self.missed = stream.overflowed

    def flush(self) -> None:
        """Hands what was written to the operating system, if it is due."""
        now_s = time.monotonic()
        if now_s - self._flushed_s >= FLUSH_S:
            self._flushed_s = now_s
            with WHOLE, _writing(self.path):
                self._writer.flush()

    def close(self, summary: dict[str, str] | None = None) -> None:
        """Writes the end of the file; without it a reader calls the recording incomplete."""
        if self._file.closed:
            return
        missed = (
            [f"{self.missed} messages, which came faster than they were recorded"]
            if self.missed
            else []
        )
        with WHOLE:
            self._end({**(summary or {}), LOST: json.dumps(missed)})

    def _end(self, summary: dict[str, str]) -> None:
        self._ended.set()
        self._syncs.join()
        try:
            with _writing(self.path):
                self._writer.flush()
                self._writer.add_metadata(METADATA_END, summary)
                self._writer.finish()
                self._file.flush()
                os.fdatasync(self._file.fileno())
        finally:
            for file in (self._file, self._writer):
                with contextlib.suppress(OSError):  # it flushes once more, onto the same full disk
                    file.close()

    def _sync(self) -> None:
        """Sees to it that the disk has what was flushed.

        In a thread of its own: a disk may take its time.
        """
        while not self._ended.wait(SYNC_S):
            with contextlib.suppress(OSError):  # on a full disk the next flush says so
                os.fdatasync(self._file.fileno())

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        self.close({} if error is None else {"error": str(error)})

    def _arrival_ns(self, raw: RawSample, message: Message) -> int:
        """In lockstep the simulated time moves with what the robot last said."""
        if not self._clock.lockstep:
            return max(0, self._clock.of_monotonic(raw.arrival_ns))
        if isinstance(message, RobotState | GroundTruth):
            self.simulated_ns = max(self.simulated_ns, message.time_ns)
        return self.simulated_ns

    def _add(
        self, topic: str, type_name: str, envelope: Envelope, arrival_ns: int, payload: bytes
    ) -> None:
        channel = self._channels.get((topic, envelope.boot_id))
        with _writing(self.path):
            if channel is None:
                channel = self._writer.register_channel(
                    topic, "cdr", self._schema(type_name), {"boot_id": envelope.boot_id.hex()}
                )
                self._channels[topic, envelope.boot_id] = channel
            record = Record(
                channel_id=channel, log_time=arrival_ns, data=payload,
                publish_time=max(0, envelope.capture_ns),
                sequence=envelope.sequence & SEQUENCE_MASK,
            )  # fmt: skip
            self._writer.add_message(record)

    def _schema(self, type_name: str) -> int:
        if type_name not in self._schemas:
            text = stored_definition(type_name).encode()
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", text)
        return self._schemas[type_name]


class _Said:
    """The step of lockstep, or the image, of which a sender spoke last under a key."""

    def __init__(self) -> None:
        self.again = 0
        """Messages that had been said before."""
        self._last: int | None = None

    def before(self, message: Message) -> bool:
        """Counts a message that was sent before.

        Events and statuses, which have no number, never were.
        """
        number: int | None = getattr(message, "step", getattr(message, "frame_id", None))
        is_again = number is not None and number == self._last
        self.again += is_again
        self._last = number
        return is_again


@contextlib.contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror}") from error


def describe(run_config: RunConfig, setup: Setup) -> dict[str, str]:
    """The metadata of a recording: what is needed to make the run again."""
    return {
        "schema": SCHEMA,
        "config": config.to_toml(run_config),
        **{part.name: getattr(setup, part.name).to_toml() for part in fields(setup)},
        "seed": str(run_config.seed),
        "models": json.dumps(network_names(run_config)),
        "commit": current_commit(),
        "versions": json.dumps({name: package_version(name) for name in PACKAGES}),
        "python": platform.python_version(),
    }
