"""Recordings of messages that no run has sent, for tests of reading them, whole and damaged."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from saltus.config import Pace, RunConfig, TerrainConfig
from saltus.grid import LINE
from saltus.named_setup import named_setup
from saltus.recordings.recorder import Recorder
from saltus.recordings.recording import Recording, read_recording
from saltus.terrain.curriculum import make_terrain
from saltus.wire import codec, messages
from saltus.wire.bus import RawSample
from saltus.wire.codec import Envelope
from saltus.wire.messages import Message
from saltus.wire.topics import TOPICS

MS = 1_000_000
SENDER = b"0123456789abcdef"
STEPS = 40
LATENCY_NS = 3 * MS
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
            **now,
            **pose,
            position_base_in_world=rng.normal(size=3),
            foot_force=rng.random(4),
            x=np.array(LINE.x),
            height=rng.random(30),
        ),
    )
    if step % 2 == 0:
        yield "camera/depth", depth(step)
    yield (
        "controller/state",
        messages.RobotState(
            **now, **pose, acceleration_base=rng.normal(size=3), joint_velocity=rng.normal(size=12),
            joint_torque=rng.normal(size=12), base_height=0.27, leg_contact=np.ones(4, bool),
            leg_progress=np.zeros(4),
            leg_trusted=np.ones(4, bool), cycle=step // 30, mode=messages.ControllerMode.RUN,
            depth_due=-1,
        ),
    )  # fmt: skip
    yield (
        "heightmap/heightmap",
        messages.Heightmap(
            **now, x=np.linspace(-0.4, 0.8, 30), height=rng.normal(size=30),
            half_width_90=rng.random(30),
            status=messages.HeightmapStatus.OK, depth_age_s=0.05, frame_id=3,
            model_id="0123456789abcdef",
        ),
    )  # fmt: skip
    yield (
        "policy/plan",
        messages.MotionPlan(
            **now, status=messages.PlanStatus.GO, stepping_frequency_hz=3.0, velocity_x=1.0,
            velocity_z=0.0,
            pitch_rate=0.0, foot_residual_front=np.zeros(3), foot_residual_rear=np.zeros(3),
            reason="",
        ),
    )  # fmt: skip
    yield "controller/joints", messages.JointLog(**now, dt_s=0.002, **rows)
    yield (
        "status/controller",
        messages.ProcessStatus(
            time_ns=step * 10 * MS, process="controller", ready=True, ticks=step, overruns=0
        ),
    )


def raw(key: str, message: Message, sequence: int, epoch_ns: int = 0) -> RawSample:
    envelope = Envelope(sequence, message.time_ns, SENDER)
    return RawSample(
        key,
        codec.encode_message(message),
        envelope.to_bytes(),
        epoch_ns + message.time_ns + LATENCY_NS,
    )


def run_samples(steps: int = STEPS, epoch_ns: int = 0) -> Iterator[RawSample]:
    count: dict[str, int] = {}
    for step in range(steps):
        for key, message in run_messages(step):
            count[key] = count.get(key, 0) + 1
            yield raw(key, message, count[key], epoch_ns)


def write(
    path: Path, samples: list[RawSample], pace: Pace = "lockstep", epoch_ns: int = 0
) -> Recording:
    config = RunConfig(
        robot="go1",
        grid="line",
        pace=pace,
        seed=7,
        epoch_ns=epoch_ns,
        terrain=TerrainConfig(terrain="gap"),
    )
    with Recorder(path, config, named_setup(config)) as file:
        for sample in samples:
            file.write(sample)
    return read_recording(path)


def payloads(recording: Recording) -> list[tuple[str, int, bytes]]:
    return [(t, e.sequence, p) for t in TOPICS for _, e, p in recording.payloads(t)]
