"""Plausible messages of every kind, for tests of what carries them."""

from pathlib import Path
from typing import Any

import numpy as np

from saltus.config import RunConfig
from saltus.depth_camera import load_camera
from saltus.effects.profile import load_profile
from saltus.effects.torque_saturation import TorqueSaturation
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.runtime.run_folder import CAMERA_FILE, ROBOT_FILE, TERRAIN_FILE
from saltus.terrain.curriculum import make_terrain
from saltus.wire import messages, schemas
from saltus.wire.messages import GroundTruth, Message

ROBOT = load_robot("go1")
KINEMATICS = LegKinematics(ROBOT)
PROFILE = load_profile("go1", ROBOT)
CURVE = next(effect.curve for effect in PROFILE.actuator if isinstance(effect, TorqueSaturation))


def put_robot(folder: Path) -> Path:
    """Makes a folder that of a run of this robot; returns it."""
    (folder / ROBOT_FILE).write_text(ROBOT.to_toml())
    return folder


def put_run(folder: Path, config: RunConfig) -> Path:
    """Makes a folder that of a run: with this robot, and terrain and camera of the configuration; returns it."""
    (folder / CAMERA_FILE).write_text(load_camera(config.camera).to_toml())
    (folder / TERRAIN_FILE).write_text(make_terrain(config.terrain).to_toml())
    return put_robot(folder)


def level_truth(step: int, x: float, z: float, time_ns: int | None = None) -> GroundTruth:
    """A robot in its stand pose that is level at (x, 0, z) [m] at a policy step of 10 ms; no feet, no heights."""
    return GroundTruth(
        time_ns=step * 10_000_000 if time_ns is None else time_ns,
        step=step,
        position_base_in_world=np.array([x, 0.0, z]),
        quaternion_base_in_world=np.array([1.0, 0.0, 0.0, 0.0]),
        velocity_base_in_world=np.zeros(3),
        angular_velocity_base=np.zeros(3),
        joint_position=ROBOT.stand_pose,
        foot_force=np.zeros(4),
        height=np.zeros(30),
    )


def message_of(kind: type[Message], seed: int = 0) -> Any:
    """A plausible message with random content."""
    rng = np.random.default_rng(seed)
    time_ns = int(rng.integers(0, 10**12))
    if kind is messages.DepthFrame:
        depth = rng.integers(0, 2**16, size=(48, 16), dtype=np.uint16)
        return messages.DepthFrame(
            time_ns=time_ns, frame_id=7, depth=depth, depth_unit_m=0.001, fx=213.5, fy=214.25, cx=8.0, cy=24.5
        )
    if kind is messages.Event:
        return messages.Event(time_ns=time_ns, process="heightmap", code="depth_lost", detail="nothing for 110 ms – ü")
    if kind is messages.ProcessStatus:
        rejected = {"camera/depth/range": 3, "policy/plan/malformed": 1}
        return messages.ProcessStatus(
            time_ns=time_ns,
            process="render",
            ready=True,
            ticks=12,
            overruns=1,
            rejected=rejected,
            received={"plant/truth": 50, "camera/depth": 0},
            silence_us={"plant/truth": 12_345, "camera/depth": 500_000},
        )
    return kind(time_ns=time_ns, **{field.name: value_of(field, rng) for field in schemas.FIELDS[kind]})


def value_of(field: schemas.Field, rng: np.random.Generator) -> Any:
    if field.enum is not None:
        return field.enum(int(rng.integers(0, len(field.enum))))
    if field.wire == "string":
        return "".join(rng.choice(list("0123456789abcdef"), 16))
    if field.wire == "int64":
        return int(rng.integers(max(field.low, 0), 10**6))
    if field.wire == "bool":
        return rng.random(field.shape) < 0.5
    low, high = max(field.low, -1.0), min(field.high, 1.0)
    if field.shape is None:
        return float(rng.uniform(low, high))
    array = rng.uniform(low, high, tuple(5 if n == -1 else n for n in field.shape))
    return array / np.linalg.norm(array) if field.name.startswith("quaternion") else array
