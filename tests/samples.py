"""Plausible messages of every kind, for tests of what carries them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from saltus.config import RunConfig, TerrainConfig
from saltus.depth_camera import load_camera
from saltus.effects.motors import TorqueSaturation
from saltus.effects.profile import IDEAL, Profile, load_profile
from saltus.grid import LINE
from saltus.named_setup import named_setup
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.runtime.run_folder import SETUP_FILE
from saltus.setup import Setup
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain
from saltus.trial import Trial
from saltus.wire import messages, schemas
from saltus.wire.messages import GroundTruth, Message

ROBOT = load_robot("go1")
KINEMATICS = LegKinematics(ROBOT)
PROFILE = load_profile("go1", ROBOT)
CURVE = next(effect.curve for effect in PROFILE.actuator if isinstance(effect, TorqueSaturation))
EVERYTHING = Profile.from_toml(
    """
[actuator]
command_delay.delay = 0.0053
feedforward_delay.delay = 0.0093
encoder_bias.bias = 0.03
encoder_quantisation.step = 0.01
velocity_filter.time_constant = 0.01
velocity_scale.scale = 1.2
actuator_lag.time_constant = 0.006
torque_speed_limit = {corner = 0.0, no_load = [15, 15, 10, 15, 15, 10, 15, 15, 10, 15, 15, 10]}
torque_saturation.curve = [[5.0, 5.0], [15.0, 14.12], [25.0, 20.34], [35.0, 25.68]]
torque_gain.gain = [0.8, 0.9, 1.1, 0.8, 0.9, 1.1, 0.8, 0.9, 1.1, 0.8, 0.9, 1.1]
battery_sag = {loss_at_end = 0.5, duration_s = 0.1}
voltage_sag = {per_kw = 0.1, brown_out = 0.2}
backlash.width = 0.02
joint_spring = {torque = 1.0, stiffness = 2.0}
end_stop = {upper = [0.1, 1.0, -1.5, 0.1, 1.0, -1.5, 0.1, 1.0, -1.5, 0.1, 1.0, -1.5], stiffness = 100.0}
viscous_friction.coefficient = 0.3
coulomb_friction.torque = 0.5
stiction = {breakaway = 1.0, stribeck_velocity = 1.0}
armature.added = 0.005

[body]
payload_mass.mass = 0.5
com_offset.x = 0.01
base_inertia.scale = 1.2
foot_friction.coefficient = 0.6
base_roll = {give = 0.05, damping = 0.2}
soft_feet = {torsion = 0.02, rolling = 0.01, touch = 0.5, depth = 0.005}

[imu]
imu_bias = {gyro_x = 0.02, roll = 0.01}
imu_latency.delay = 0.005

[camera]
camera_pitch.offset = 0.05
camera_height.offset = 0.03
camera_fov.scale = 1.05
sample_and_hold.period = 0.05
depth_scale.scale = 1.03
depth_bias.bias = 0.02
depth_noise.subpixel_sigma = 0.3
edge_holes.width = 10
range_clip.max = 1.0
hole_fill.reach = 10
frame_drop.fraction = 0.3
temporal_smear.alpha = 0.4
camera_latency.latency = 0.093
"""
)
"""An example of every effect that robots and their cameras have."""


def setup_of(
    terrain: TerrainConfig | Terrain,
    trial: Trial | None = None,
    profile: Profile | None = None,
    robot: Robot = ROBOT,
) -> Setup:
    """A robot with a camera without errors on such a terrain.

    By default the nominal trial, without effects.
    """
    return Setup(
        robot=robot, grid=LINE,
        terrain=terrain if isinstance(terrain, Terrain) else make_terrain(terrain),
        profile=profile or IDEAL, camera=load_camera("ideal"), trial=trial or Trial(),
    )  # fmt: skip


def setups_of(
    terrains: Sequence[Terrain],
    trials: Sequence[Trial],
    profile: Profile | None = None,
    robot: Robot = ROBOT,
) -> list[Setup]:
    """A batch of robots, by default with the hardware that theirs has as shipped."""
    profile = profile or load_profile("shipped", robot)
    return [
        setup_of(terrain, trial, profile, robot)
        for terrain, trial in zip(terrains, trials, strict=True)
    ]


def put_robot(folder: Path) -> Path:
    """Makes a folder that of a run of this robot; returns it."""
    return put_run(folder, RunConfig(robot="go1", grid="line"))


def put_run(folder: Path, config: RunConfig) -> Path:
    """Makes a folder that of a run, without its run.toml; returns it."""
    (folder / SETUP_FILE).write_text(named_setup(config).to_toml())
    return folder


def level_truth(step: int, x: float, z: float, time_ns: int | None = None) -> GroundTruth:
    """A robot in its stand pose that is level at (x, 0, z) [m] at a policy step of 10 ms;
    no feet, no heights.
    """
    return GroundTruth(
        time_ns=step * 10_000_000 if time_ns is None else time_ns,
        step=step,
        position_base_in_world=np.array([x, 0.0, z]),
        quaternion_base_in_world=np.array([1.0, 0.0, 0.0, 0.0]),
        velocity_base_in_world=np.zeros(3),
        angular_velocity_base=np.zeros(3),
        joint_position=ROBOT.stand_pose,
        foot_force=np.zeros(4),
        x=np.array(LINE.x),
        height=np.zeros(30),
    )


def message_of(kind: type[Message], seed: int = 0) -> Any:
    """A plausible message with random content."""
    rng = np.random.default_rng(seed)
    time_ns = int(rng.integers(0, 10**12))
    if kind is messages.DepthFrame:
        depth = rng.integers(0, 2**16, size=(48, 16), dtype=np.uint16)
        return messages.DepthFrame(
            time_ns=time_ns,
            frame_id=7,
            depth=depth,
            depth_unit_m=0.001,
            fx=213.5,
            fy=214.25,
            cx=8.0,
            cy=24.5,
        )
    if kind is messages.Event:
        return messages.Event(
            time_ns=time_ns, process="heightmap", code="depth_lost", detail="nothing for 110 ms – ü"
        )
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
    values = {field.name: value_of(field, rng) for field in schemas.FIELDS[kind]}
    return kind(time_ns=time_ns, **(values | _heights(kind, rng)))


def _heights(kind: type[Message], rng: np.random.Generator) -> dict[str, Any]:
    """Heights on a grid, by their fields; nothing for messages without heights."""
    names = [field.name for field in schemas.FIELDS[kind] if field.shape == (schemas.ANY,)]
    if "x" not in names:
        return {}
    x, y = (np.cumsum(rng.uniform(0.01, 0.1, rng.integers(1, most))) - 1.0 for most in (40, 12))
    return {name: rng.uniform(0.0, 1.0, x.size * y.size) for name in names} | {"x": x, "y": y}


def value_of(field: schemas.MessageField, rng: np.random.Generator) -> Any:
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
