"""A robot that glides over a terrain with exact odometry,
and recordings of it, for tests of what measures heights.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from samples import ROBOT

from saltus import rotations
from saltus.config import RunConfig, TerrainConfig
from saltus.depth import MODEL_CAMERA, Intrinsics, depth_frame, depth_in_millimetres
from saltus.grid import HEIGHTMAP_X, LINE
from saltus.named_setup import named_setup
from saltus.recordings.recorder import Recorder
from saltus.recordings.recording import Recording, read_recording
from saltus.render.camera import RobotCamera
from saltus.render.embree import EmbreeRenderer
from saltus.terrain.curriculum import make_terrain
from saltus.wire import codec
from saltus.wire.bus import RawSample
from saltus.wire.codec import Envelope
from saltus.wire.messages import (
    ControllerMode,
    DepthFrame,
    GroundTruth,
    Heightmap,
    Message,
    RobotState,
)

MS = 1_000_000
LATENCY_NS = 50 * MS
SPEED_MPS = 1.0
CYCLE = 30  # steps


@dataclass(frozen=True, kw_only=True, eq=False)
class Glide:
    """All messages of a run but the heightmaps; one state every 10 ms, one image every 20 ms."""

    terrain: TerrainConfig
    states: list[RobotState]
    truths: list[GroundTruth]
    frames: list[DepthFrame]

    @property
    def arrival_ns(self) -> list[int]:
        """When each image can first be used."""
        return [frame.time_ns + LATENCY_NS for frame in self.frames]

    @property
    def true_height(self) -> np.ndarray:
        """Shape (steps, 30)."""
        return np.array([truth.height for truth in self.truths])


def glide(
    terrain: TerrainConfig,
    *,
    steps: int = 240,
    height_m: float = 0.4,
    camera: Intrinsics = MODEL_CAMERA,
) -> Glide:
    """A base that moves ahead at 1 m/s and nods, `height_m` above the start.

    It rises with the stairs: 0.3 m ahead of it the ground is as far below as at the start.
    """
    ground = make_terrain(terrain)
    time_s = 0.01 * np.arange(steps)
    x = 0.5 + SPEED_MPS * time_s
    slope = ground.params.get("rise_m", 0.0) / ground.params.get("run_m", 1.0)
    z = height_m + slope * np.maximum(x + 0.3 - ground.first_edge_x, 0.0)
    zero = np.zeros(steps)
    position = np.stack([x, zero, z], axis=-1)
    velocity = np.gradient(position, 0.01, axis=0)
    quaternion = rotations.quaternion_from_roll_pitch_yaw(
        zero, 0.06 * np.sin(2 * np.pi * time_s / 0.3), zero
    )
    joints = np.tile(ROBOT.stand_pose, (steps, 1))
    images = EmbreeRenderer(
        ground, RobotCamera.on(ROBOT, camera, legs=False), threads=1
    ).render_batch(position[::2], quaternion[::2], joints[::2])
    heights = ground.height_at(x[:, None] + HEIGHTMAP_X, 0.0) - z[:, None]
    return Glide(
        terrain=terrain,
        states=[_state(k, quaternion[k], velocity[k], joints[k]) for k in range(steps)],
        truths=[
            _truth(k, position[k], quaternion[k], velocity[k], joints[k], heights[k])
            for k in range(steps)
        ],
        frames=[_frame(i, camera, image) for i, image in enumerate(images)],
    )


def record(
    path: Path,
    run: Glide,
    heightmaps: Sequence[Heightmap],
    *,
    truth: bool = True,
    config: RunConfig | None = None,
) -> Recording:
    """Writes and reads a recording."""
    config = config or RunConfig(robot="go1", grid="line", terrain=run.terrain)
    with Recorder(path, config, named_setup(replace(config, terrain=run.terrain))) as file:
        for state, true, heightmap in zip(run.states, run.truths, heightmaps, strict=True):
            if truth:
                file.write(_raw("plant/truth", true, state.step + 1, state.time_ns))
            frame_id, odd = divmod(state.step - 5, 2)
            if frame_id >= 0 and not odd:
                file.write(_raw("camera/depth", run.frames[frame_id], frame_id + 1, state.time_ns))
            file.write(_raw("controller/state", state, state.step + 1, state.time_ns))
            file.write(_raw("heightmap/heightmap", heightmap, state.step + 1, state.time_ns))
    return read_recording(path)


def _raw(key: str, message: Message, sequence: int, arrival_ns: int) -> RawSample:
    envelope = Envelope(sequence, message.time_ns, b"0123456789abcdef")
    return RawSample(key, codec.encode_message(message), envelope.to_bytes(), arrival_ns)


def _frame(frame_id: int, camera: Intrinsics, depth: np.ndarray) -> DepthFrame:
    return depth_frame(
        camera, depth_in_millimetres(depth), time_ns=20 * MS * frame_id, frame_id=frame_id
    )


def _state(
    step: int, quaternion: np.ndarray, velocity: np.ndarray, joints: np.ndarray
) -> RobotState:
    part = (step % CYCLE) / CYCLE  # front stance, flight, rear stance, flight
    contact = np.array([part < 0.25] * 2 + [0.5 <= part < 0.75] * 2)
    return RobotState(
        time_ns=10 * MS * step, step=step, quaternion_base_in_world=quaternion,
        angular_velocity_base=np.zeros(3),
        acceleration_base=np.array([0.0, 0.0, 9.81]), joint_position=joints,
        joint_velocity=np.zeros(12),
        joint_torque=np.zeros(12), velocity_base_in_world=velocity, base_height=ROBOT.stand_height,
        leg_contact=contact,
        leg_progress=np.full(4, 4 * part % 1), leg_trusted=np.zeros(4, np.bool_),
        cycle=step // CYCLE,
        mode=ControllerMode.RUN, depth_due=-1,
    )  # fmt: skip


def _truth(
    step: int,
    position: np.ndarray,
    quaternion: np.ndarray,
    velocity: np.ndarray,
    joints: np.ndarray,
    height: np.ndarray,
) -> GroundTruth:
    return GroundTruth(
        time_ns=10 * MS * step, step=step, position_base_in_world=position,
        quaternion_base_in_world=quaternion,
        velocity_base_in_world=velocity, angular_velocity_base=np.zeros(3), joint_position=joints,
        foot_force=np.zeros(4), x=np.array(LINE.x), height=height,
    )  # fmt: skip
