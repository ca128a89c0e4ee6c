"""Which topics of a bag become which part of a run log."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader

from saltus.errors import RecordingError, nearest_hint, shorten_names
from saltus.recordings.recording_description import BagTopics
from saltus.recordings.ros_images import (
    COMPRESSED,
    ENCODINGS,
    IMAGE,
    base_topic,
    encoding_text,
    is_depth,
)

TYPES = {
    "joints": ("sensor_msgs/msg/JointState",),
    "commands": ("sensor_msgs/msg/JointState",),
    "imu": ("sensor_msgs/msg/Imu",),
    "base": ("nav_msgs/msg/Odometry",),
    "depth": (IMAGE, COMPRESSED),
    "camera_info": ("sensor_msgs/msg/CameraInfo",),
}
"""Types of message that each part may have."""
COMMANDS = ("q_des", "dq_des", "tau_ff")
"""Signals that commands bring."""


def choose_topics(
    reader: AnyReader, path: Path, topics: BagTopics, left_out: Collection[str], notes: list[str]
) -> dict[str, str]:
    """The topic of each part that is there and wanted; notes say what is passed over.

    Raises:
        RecordingError: no joints; a topic that is not there, of another type, or one of several.
    """
    types = {c.topic: c.msgtype for c in reader.connections if c.msgcount}
    if not types:
        raise RecordingError(f"{path} holds no messages")
    given = _given(path, topics, types)
    skipped = {*left_out} | ({"camera_info"} if "depth" in left_out else set())
    if {*COMMANDS} <= skipped:
        skipped.add("commands")
    chosen: dict[str, str] = {}
    taken = set(given.values())
    for part, kinds in TYPES.items():
        if part in skipped:
            continue
        candidates = [
            topic for topic, kind in types.items() if kind in kinds and topic not in taken
        ]
        if part == "depth":
            candidates = _of_depth(reader, path, given.get(part), candidates, notes)
        if part == "camera_info":
            if "depth" not in chosen:
                continue
            candidates = _of_camera(chosen["depth"], given.get(part), candidates, types, notes)
        if part not in given and len(candidates) > 1:
            told = " or ".join(sorted(candidates))
            raise RecordingError(
                f"{path}: {part} may come from {told}: name one with --topics.{part}"
            )
        if part in given or candidates:
            chosen[part] = given.get(part) or candidates[0]
            taken.add(chosen[part])
    if "joints" not in chosen:
        raise _without_joints(path, types)
    return chosen


def _given(path: Path, topics: BagTopics, types: dict[str, str]) -> dict[str, str]:
    """Topics that somebody named, which must be there and of the right type."""
    given = {part: topic for part, topic in vars(topics).items() if topic is not None}
    for part, topic in given.items():
        if types.get(topic) not in TYPES[part]:
            found = (
                f"is of type {types[topic]}"
                if topic in types
                else f"is not there: {nearest_hint(topic, types)}"
            )
            raise RecordingError(
                f"{path}: {part} are to come from {topic} ({' or '.join(TYPES[part])}), which "
                f"{found}"
            )
    return given


def _of_depth(
    reader: AnyReader, path: Path, given: str | None, candidates: list[str], notes: list[str]
) -> list[str]:
    """Topics whose images are depth; of raw and compressed ones of the same images the raw ones."""
    if given is not None:
        first = first_of(reader, given)
        if not is_depth(first):
            raise RecordingError(
                f"{path}: depth are to come from {given}, whose images are {encoding_text(first)}: "
                "depth is "
                f"{', '.join(ENCODINGS)}"
            )
        return []
    firsts = {topic: first_of(reader, topic) for topic in candidates}
    depth = [topic for topic, image in firsts.items() if is_depth(image)]
    others = [
        f"{topic} ({encoding_text(image)})" for topic, image in firsts.items() if topic not in depth
    ]
    if others:
        notes.append(f"no depth, and left out: {shorten_names(others)}")
    return [
        topic for topic in depth if base_topic(topic) == topic or base_topic(topic) not in depth
    ]


def _of_camera(
    depth: str, given: str | None, candidates: list[str], types: dict[str, str], notes: list[str]
) -> list[str]:
    """The calibration that stands beside the depth images,
    or the only one, if it stands beside no others.
    """
    if given is not None:
        return []
    beside = [
        topic
        for topic in candidates
        if folder_of(topic) == folder_of(depth) or topic.startswith(base_topic(depth))
    ]
    if beside or not candidates:
        return beside
    images = {
        folder_of(topic)
        for topic, kind in types.items()
        if kind in TYPES["depth"] and topic != depth
    }
    free = [topic for topic in candidates if folder_of(topic) not in images]
    if not free:
        told = f"{shorten_names(sorted(candidates))} stand beside other images"
        notes.append(
            f"no camera_info of {depth}: {told}; name one with --topics.camera_info, or say fx ... "
            "in [claims.camera]"
        )
    return free


def folder_of(topic: str) -> str:
    """The part of a topic's name before its last word, without the name of a transport."""
    return base_topic(topic).rpartition("/")[0]


def first_of(reader: AnyReader, topic: str) -> Any:
    """The first message of a topic."""
    connections = [c for c in reader.connections if c.topic == topic]
    connection, _, raw = next(reader.messages(connections))
    return reader.deserialize(raw, connection.msgtype)


def _without_joints(path: Path, types: dict[str, str]) -> RecordingError:
    if IMAGE in types.values() and any(topic.startswith("/device_") for topic in types):
        return RecordingError(
            f"{path} holds images without joints and poses, with which `find` compares nothing: "
            f"`saltus render fit {path}` fits the camera's errors to them"
        )
    return RecordingError(
        f"{path} holds no {TYPES['joints'][0]}; it has: {shorten_names(sorted(types))}"
    )
