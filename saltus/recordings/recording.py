"""Reads a recorded run, whole or damaged, and measures it.

`saltus.recordings.recorded_file` says what of a damaged file is sound, `saltus.recordings.repair`
makes a whole file of it. Writing is `saltus.recordings.recorder`; run logs of plain tables are
`saltus.recordings.run_log`.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

from mcap.records import Channel, Chunk

from saltus.config import RunConfig, TomlValue, from_table
from saltus.depth_camera import DepthCamera, load_camera
from saltus.effects.profile import Profile, load_profile
from saltus.errors import MessageError, RecordingError
from saltus.grid import HeightGrid, load_grid
from saltus.recordings.chunks import ChunkRow, chunk_rows
from saltus.recordings.recorded_file import RecordedFile
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.setup import Setup
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain
from saltus.trial import Trial
from saltus.wire import cdr, codec, schemas
from saltus.wire.bus import topic_of
from saltus.wire.codec import Envelope
from saltus.wire.messages import Message
from saltus.wire.topics import TOPICS

MessageT = TypeVar("MessageT", bound=Message)
PartT = TypeVar("PartT", bound=TomlValue)

UNPACKED_CHUNKS = 64
"""Kept by `Recording.arrivals` for who asks for one moment after the other: some seconds of a run,
16 MB."""


class RecordedMessage(NamedTuple):
    """A message as it came in, not decoded."""

    arrival_ns: int
    """In the run's clock."""
    key: str
    """Below the robot's prefix, e.g. "status/render"."""
    envelope: Envelope
    payload: bytes


@dataclass(eq=False)
class Recording(RecordedFile):
    """A recorded run. `messages` reads lazily, so long runs fit in memory."""

    _unpacked: dict[int, list[RecordedMessage]] = field(default_factory=dict, repr=False)
    _former: dict[int, int | None] = field(default_factory=dict, repr=False)

    @property
    def known_config(self) -> RunConfig:
        """The configuration of the run; where the head of the file is lost, the default one."""
        return self.config or from_table(RunConfig, {})

    @cached_property
    def robot(self) -> Robot:
        """The robot of the run; where the head of the file is lost, the default one.

        Raises:
            ConfigError: it was written by another version.
        """
        # older recordings have the prefix of their keys in its name
        return self._value("robot", Robot, lambda name: load_robot(name.split("/")[0]))

    @cached_property
    def grid(self) -> HeightGrid:
        """Points at which the heights of the run were asked.

        Raises:
            ConfigError: it was written by another version.
        """
        return self._value("grid", HeightGrid, load_grid)

    @cached_property
    def terrain(self) -> Terrain:
        """The terrain of the run; where the head of the file is lost, the default one.

        Raises:
            ConfigError: it was written by another version, or is not in the recording and cannot be
                made.
        """
        return self._value("terrain", Terrain, make_terrain)

    @cached_property
    def camera(self) -> DepthCamera:
        """The camera of the run; where the head of the file is lost, the default one.

        Raises:
            ConfigError: it was written by another version.
        """
        return self._value("camera", DepthCamera, load_camera)

    @cached_property
    def setup(self) -> Setup:
        """Everything that the run was of; an older recording names the profile
        and the seed of its trial.

        Raises:
            ConfigError: it was written by another version.
        """
        return Setup(
            robot=self.robot,
            grid=self.grid,
            terrain=self.terrain,
            profile=self._value("profile", Profile, lambda name: load_profile(name, self.robot)),
            camera=self.camera,
            trial=self._value("trial", Trial, lambda _: Trial.draw(self.known_config.seed)),
        )

    def _value(self, name: str, kind: type[PartT], otherwise: Callable[[Any], PartT]) -> PartT:
        """A value of the run as it was written,
        or `otherwise` made of its name in the configuration.
        """
        if name in self.metadata:
            return kind.from_toml(self.metadata[name])
        return otherwise(getattr(self.known_config, name, None))

    @cached_property
    def models(self) -> dict[str, str]:
        """Name of each network that the run began with, by its kind.

        None where the recording does not say.
        """
        try:
            return dict(json.loads(self.metadata.get("models", "{}")))
        except (ValueError, TypeError, RecursionError) as error:
            raise RecordingError(f"{self.path}: its names of models are damaged") from error

    @property
    def senders(self) -> list[str]:
        """Keys below the robot's prefix that have messages, e.g. "status/render"."""
        found = (channel.topic[1:] for channel in self.channels.values())
        return [key for key in dict.fromkeys(found) if topic_of(key) is not None]

    def topics(self) -> list[str]:
        """Names of the topics that have messages; those of one topic table row count as one."""
        known = set(map(topic_of, self.senders))
        return [name for name, topic in TOPICS.items() if topic in known]

    def messages(self, topic: str) -> Iterator[tuple[int, Envelope, Message]]:
        """Yields (arrival in the run's clock [ns], envelope, message) in order of arrival.

        The topic "status" yields those of all processes, "status/render" those of one;
        "camera/depth" images of the first camera, "camera/depth/rear" of one named so. A message
        that does not fit this version's is a `RecordingError`.
        """
        for arrival_ns, key, envelope, payload in self.arrivals_of([topic]):
            row = topic_of(key)
            assert row is not None  # noqa: S101 - these are rows of the table only
            try:
                yield arrival_ns, envelope, codec.decode_message(row.message, payload)
            except MessageError as error:
                raise RecordingError(
                    f"{self.path}: {topic} was written by another version: {error}"
                ) from error

    def of(self, kind: type[MessageT], topic: str | None = None) -> list[MessageT]:
        """All messages of a type, in order of arrival.

        Of one sender where there is more than one ("status/render").
        """
        found = topic or next(name for name, row in TOPICS.items() if row.message is kind)
        return [cast(MessageT, message) for _, _, message in self.messages(found)]

    def payloads(self, topic: str) -> Iterator[tuple[int, Envelope, bytes]]:
        """Like `messages`, but not decoded."""
        for arrival_ns, _, envelope, payload in self._records([topic]):
            yield arrival_ns, envelope, payload

    def arrivals_of(self, topics: Iterable[str]) -> Iterator[RecordedMessage]:
        """Messages of some topics, named as those of `messages`, in the order of the file.

        Raises:
            RecordingError: their fields are those of another version.
        """
        topics = tuple(topics)
        for topic in topics:
            self._check_fields(topic)
        yield from self._records(topics)

    @property
    def span_ns(self) -> tuple[int, int]:
        """Arrival of the first and of the last message [ns], in the run's clock.

        Zeros where there is none.
        """
        chunks = [chunk for chunk in self.chunks if chunk.message_end_time]
        if not chunks:
            return 0, 0
        return min(c.message_start_time for c in chunks), max(c.message_end_time for c in chunks)

    def arrivals(self, after_ns: int, until_ns: int) -> Iterator[RecordedMessage]:
        """Messages of all topics that arrived after one time and until another,
        in the order of the file.

        Only what the interval needs is unpacked, so that any moment of a long run is at hand.
        """
        for number, chunk in enumerate(self.chunks):
            if chunk.message_end_time > after_ns and chunk.message_start_time <= until_ns:
                for row in self._rows(number, chunk):
                    if after_ns < row.arrival_ns <= until_ns:
                        yield row

    def _rows(self, number: int, chunk: Chunk) -> list[RecordedMessage]:
        if number not in self._unpacked:
            if len(self._unpacked) >= UNPACKED_CHUNKS:
                del self._unpacked[next(iter(self._unpacked))]
            known = {channel: _sender(self.channels[channel]) for channel in self.channels}
            wanted = {
                channel: sender
                for channel, sender in known.items()
                if topic_of(sender[0]) is not None
            }
            self._unpacked[number] = [
                self._arrival(row, *wanted[row.channel]) for row in chunk_rows(chunk, wanted)
            ]
        return self._unpacked[number]

    def _check_fields(self, topic: str) -> None:
        """Refuses fields of another version:
        the bytes of one that was renamed would be read under its new meaning.
        """
        for channel in self._channels_of(topic).values():
            schema = self.schemas.get(channel.schema_id)
            if schema is None or schema.name not in schemas.DEFINITIONS:
                continue
            written, known = (
                _fields(text)
                for text in (
                    schema.data.decode(errors="replace"),
                    cdr.ros2msg_definition(schema.name),
                )
            )
            if written != known and self._former_of(channel) is None:
                other = next((line for line in written if line not in known), "fewer fields")
                raise RecordingError(
                    f"{self.path}: {topic} was written by another version of saltus ('{other}' is "
                    "not in its messages "
                    "today): read it with that version, or record the run anew"
                )

    def _former_of(self, channel: Channel) -> int | None:
        """Place of its messages in `codec.former_definitions_of`;
        None where they are those of today.
        """
        schema, row = self.schemas.get(channel.schema_id), topic_of(channel.topic[1:])
        if schema is None or row is None:
            return None
        written = _fields(schema.data.decode(errors="replace"))
        known = [_fields(text) for text in codec.former_definitions_of(row.message)]
        return known.index(written) if written in known else None

    def _payload(self, number: int, key: str, payload: bytes) -> bytes:
        """The payload of a message of a channel as messages are today."""
        if number not in self._former:
            self._former[number] = self._former_of(self.channels[number])
        row, former = topic_of(key), self._former[number]
        return (
            payload
            if former is None or row is None
            else codec.of_today(row.message, former, payload)
        )

    def _channels_of(self, topic: str) -> dict[int, Channel]:
        found = {}
        for number, channel in self.channels.items():
            key = channel.topic[1:]
            row = topic_of(key)
            of_every_process = row is not None and row.publisher == "*" and topic == row.name
            if row is not None and (topic == key or of_every_process):
                found[number] = channel
        return found

    def _records(self, topics: Iterable[str]) -> Iterator[RecordedMessage]:
        wanted = {
            number: _sender(channel)
            for topic in topics
            for number, channel in self._channels_of(topic).items()
        }
        for chunk in self.chunks:
            for row in chunk_rows(chunk, wanted):
                yield self._arrival(row, *wanted[row.channel])

    def _arrival(self, row: ChunkRow, key: str, boot_id: bytes) -> RecordedMessage:
        envelope = Envelope(row.sequence, row.publish_time, boot_id)
        return RecordedMessage(
            row.log_time, key, envelope, self._payload(row.channel, key, row.payload)
        )


def read_recording(path: str | Path) -> Recording:
    """Opens a recording, checks every part of it, and keeps what is sound;
    `RecordingError` where nothing is.
    """
    recording = Recording(Path(path))
    recording.fill()
    return recording


def _sender(channel: Channel) -> tuple[str, bytes]:
    """Key of a channel below the robot's prefix, and boot id of who sent to it."""
    return channel.topic[1:], bytes.fromhex(channel.metadata.get("boot_id", ""))


def _fields(definition: str) -> list[str]:
    """Lines of a message definition, without those of the types that it contains."""
    return definition.split("=" * 80)[0].split("\n")
