"""Files of every kind that Saltus opens, each with what reads it,
and what chance may do to bytes.
"""

import hashlib
import json
import shutil
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from saltus.config import RunConfig, TerrainConfig, load_config
from saltus.depth_camera import load_camera
from saltus.effects.profile import load_profile
from saltus.errors import RecordingError
from saltus.grid import LINE
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.inventory import validate_dataset
from saltus.heightmap.data.shards import MANIFEST, read_dataset, write_shard
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.heightmap.settings import PredictorTraining
from saltus.heightmap.training.train import HELD_OUT, checkpoint_settings, train_heightmap
from saltus.model_file import checksum_path
from saltus.policy.planner import make_planner
from saltus.policy.training.checkpoint import read_policy_checkpoint, training_config
from saltus.recordings.realsense import read_realsense
from saltus.recordings.recorder import RECORDING_FILE
from saltus.recordings.recording import read_recording
from saltus.recordings.recording_description import BagTopics
from saltus.recordings.rosbag import read_rosbag
from saltus.recordings.run_log import read_run_log
from saltus.recordings.run_log_export import export_run_log
from saltus.recordings.summary import summarise_run
from saltus.resources import shipped_file
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.robots.shipped import DEFAULT_ROBOT, shipped_profiles
from saltus.runtime.run_folder import RUN_FILE, SETUP_FILE
from saltus.runtime.stack import Stack
from saltus.setup import Setup
from saltus.terrain.curriculum import make_terrain

HUGE = (2**31 - 1, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1)
RUN_S = 0.5
STORES = {"ros1": get_typestore(Stores.ROS1_NOETIC), "ros2": get_typestore(Stores.ROS2_HUMBLE)}


def damage(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with one damage: some flipped, the end lost,
    some inserted or lost, or a number that is huge.
    """
    kind, place = rng.integers(5), int(rng.integers(max(len(data), 1)))
    changed = bytearray(data)
    if kind == 0:
        for at in rng.integers(len(data), size=rng.integers(1, 17)):
            changed[at] ^= int(rng.integers(1, 256))
    elif kind == 1:
        del changed[place:]
    elif kind == 2:
        changed[place:place] = rng.bytes(int(rng.integers(1, 4096)))
    elif kind == 3:
        del changed[place : place + int(rng.integers(1, 4096))]
    else:
        width = int(rng.choice([4, 8]))
        number = int(HUGE[rng.integers(len(HUGE))]) & (2 ** (8 * width) - 1)
        changed[place : place + width] = number.to_bytes(width, "little")
    return bytes(changed)


@dataclass(frozen=True, kw_only=True)
class SoundFile:
    """A sound file, and what reads it."""

    path: Path
    read: Callable[[Path], object]
    """Is given the path of a file in the same place that may be damaged."""


MODELS = {
    f"{name}{suffix}": name
    for name in ("heightmap", "policy")
    for suffix in ("", "_without_checksum")
}
BAGS = ("mcap", "sqlite3", "ros1")


def make_samples(folder: Path, robot: Robot) -> None:
    """Writes a sound file of each kind."""
    config = RunConfig(
        robot="go1",
        grid="line",
        terrain=TerrainConfig(terrain="flat"),
        planner="scripted",
        time_limit_s=RUN_S,
    )
    with Stack(config, folder / "run") as stack:
        stack.wait()
    export_run_log(read_recording(stack.recording), folder / "log")
    make_dataset(folder / "data")
    for kind in BAGS:
        make_bag(folder / kind, kind)
    make_realsense(folder / "depth.bag")
    for place, name in MODELS.items():
        model = folder / f"{place}.onnx"
        shutil.copy(shipped_file(f"models/{name}.onnx"), model)
        if place == name:
            shutil.copy(checksum_path(shipped_file(f"models/{name}.onnx")), checksum_path(model))
    shutil.copy(shipped_file("models/checkpoints/policy.pt"), folder)
    make_dataset(folder / "trained on", HELD_OUT)
    train_heightmap(
        folder / "trained on",
        folder / "heightmap.pt",
        PredictorTraining(updates=1, batch=2, window=50, device="cpu"),
    )
    (folder / "profile.toml").write_text(
        shipped_profiles()[robot.profile].read_text(encoding="utf-8"), encoding="utf-8"
    )
    (folder / "terrain.toml").write_text(make_terrain(config.terrain).to_toml(), encoding="utf-8")
    (folder / "camera.toml").write_text(load_camera("d435i").to_toml(), encoding="utf-8")


def samples(folder: Path, robot: Robot) -> dict[str, SoundFile]:
    """Files that `make_samples` wrote into a folder, with their readers."""

    def planner(path: Path) -> object:
        return make_planner("learned", robot, LINE, path)

    def network(path: Path) -> object:
        return HeightmapNetwork(robot, path)

    def bag(path: Path) -> object:
        return read_rosbag(path, BagTopics())

    run, log = folder / "run", folder / "log"
    bags = {
        kind: next((folder / kind).glob(f"*{end}"))
        for kind, end in (("mcap", ".mcap"), ("sqlite3", ".db3"))
    }
    found: dict[str, tuple[Path, Callable[[Path], object]]] = {
        "recording": (run / RECORDING_FILE, report),
        **{f"bag {kind}": (path, bag) for kind, path in bags.items()},
        "bag ros1": (folder / "ros1.bag", bag),
        "bag realsense": (folder / "depth.bag", lambda path: list(read_realsense(path))),
        **{
            f"run log {name}": (log / name, lambda path: read_run_log(path.parent))
            for name in ("meta.json", "joints.csv", "depth.npz")
        },
        "dataset manifest": (folder / "data" / MANIFEST, lambda path: read_dataset(path.parent)),
        "dataset shard": (folder / "data" / "round_000.h5", read_shard),
        **{
            f"model {place.replace('_', ' ')}": (
                folder / f"{place}.onnx",
                network if name == "heightmap" else planner,
            )
            for place, name in MODELS.items()
        },
        "checkpoint heightmap": (folder / "heightmap.pt", checkpoint_settings),
        "checkpoint policy": (
            folder / "policy.pt",
            lambda path: training_config(read_policy_checkpoint(path)),
        ),
        "toml profile": (folder / "profile.toml", lambda path: load_profile(str(path), robot)),
        "toml camera": (folder / "camera.toml", lambda path: load_camera(str(path))),
        "toml terrain": (
            folder / "terrain.toml",
            lambda path: make_terrain(TerrainConfig(terrain=str(path))),
        ),
        "toml setup": (run / SETUP_FILE, lambda path: load_config(Setup, path)),
        "toml run": (run / RUN_FILE, lambda path: load_config(RunConfig, path)),
    }
    return {kind: SoundFile(path=path, read=read) for kind, (path, read) in found.items()}


def report(path: Path) -> None:
    """Returns what a report of a run reads of its recording."""
    recording = read_recording(path)
    if not recording.complete:  # it is read all the same, and says so
        raise RecordingError(recording.lost[0])
    for topic in recording.topics():
        for _ in recording.messages(topic):
            pass
    summarise_run(recording)


def read_shard(path: Path) -> None:
    """A shard whose manifest agrees with what it has become:
    nothing but its own reading can notice.
    """
    table = json.loads((path.parent / MANIFEST).read_text(encoding="utf-8"))
    table["shards"][0]["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    (path.parent / MANIFEST).write_text(json.dumps(table), encoding="utf-8")
    validate_dataset(path.parent)
    read_dataset(path.parent)


def make_dataset(folder: Path, episodes: int = 2) -> None:
    """Writes episodes of noise."""
    rng, ticks = np.random.default_rng(0), 300
    episode = Episode(
        terrain="flat",
        proprioception=rng.normal(size=(ticks, len(PROPRIOCEPTION))).astype(np.float32),
        height=rng.normal(size=(ticks, 30)).astype(np.float32),
        depth=rng.integers(300, 2500, (ticks // 2, 48, 16)).astype(np.uint16),
        frame_tick=np.arange(0, ticks, 2, dtype=np.int32),
    )
    write_shard(folder, [episode] * episodes, seed=0, config={})


def make_bag(folder: Path, kind: str) -> None:
    """Half a second of twelve joints, as a robot of ROS records them."""
    store = STORES["ros1" if kind == "ros1" else "ros2"]
    types: Any = store.types
    if kind == "ros1":
        folder = folder.with_suffix(".bag")
        writer: Any = rosbag1.Writer(folder)
    else:
        writer = rosbag2.Writer(
            folder, version=9, storage_plugin=rosbag2.StoragePlugin[kind.upper()]
        )
    joint_state, names = "sensor_msgs/msg/JointState", [f"joint_{i}" for i in range(12)]
    writer.open()
    with closing(writer):
        topic = writer.add_connection("/joint_states", joint_state, typestore=store)
        for i in range(250):
            stamp = types["builtin_interfaces/msg/Time"](sec=1, nanosec=2_000_000 * i)
            sequence = {"seq": i} if kind == "ros1" else {}
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **sequence)
            values = np.sin(0.1 * i + np.arange(12))
            message = types[joint_state](
                header=header, name=names, position=values, velocity=values, effort=values
            )
            data = (store.serialize_ros1 if kind == "ros1" else store.serialize_cdr)(
                message, joint_state
            )
            writer.write(topic, 10**9 + 2_000_000 * i, data)


def make_realsense(path: Path) -> None:
    """Ten images of a RealSense in a bag, as the vendor's viewer writes them."""
    store, stream, side = STORES["ros1"], "/device_0/sensor_0/Depth_0", 64
    types: Any = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id="")
    lens = np.array([40.0, 0.0, 32.0, 0.0, 40.0, 32.0, 0.0, 0.0, 1.0])
    region = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    info = types["sensor_msgs/msg/CameraInfo"](
        header, side, side, "", np.zeros(5), lens, np.eye(3).ravel(), np.zeros(12), 0, 0, region
    )
    pixels = np.full(side * side, 600, "<u2").view(np.uint8)
    image = types["sensor_msgs/msg/Image"](header, side, side, "mono16", 0, 2 * side, pixels)
    with rosbag1.Writer(path) as bag:
        for topic, message, count in (
            (f"{stream}/info/camera_info", info, 1),
            (
                "/device_0/sensor_0/option/Depth Units/value",
                types["std_msgs/msg/Float32"](0.001),
                1,
            ),
            (f"{stream}/image/data", image, 10),
        ):
            connection = bag.add_connection(topic, message.__msgtype__, typestore=store)
            for i in range(count):
                bag.write(
                    connection, 33_000_000 * i, store.serialize_ros1(message, message.__msgtype__)
                )


def shipped() -> Robot:
    """The robot for which the shipped models are."""
    return load_robot(DEFAULT_ROBOT)
