"""Run logs of a robot that jumps: a run of control loop,
plant and camera, recorded and exported.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from samples import ROBOT

from benchmarks.landing import TICK_NS, true_heightmap
from saltus.config import RunConfig, TerrainConfig
from saltus.constants import POLICY_STEPS
from saltus.controller.control_loop import ControlLoop
from saltus.controller.robot.mujoco import MujocoRobot
from saltus.depth import MODEL_CAMERA
from saltus.depth_camera import load_camera
from saltus.effects.profile import IDEAL, Profile
from saltus.grid import LINE
from saltus.named_setup import named_setup
from saltus.policy.mover import Jumper
from saltus.policy.planner import make_planner
from saltus.policy.process import PlannerProcess
from saltus.recordings.recorder import Recorder
from saltus.recordings.recording import read_recording
from saltus.recordings.run_log import RunLog, read_run_log
from saltus.recordings.run_log_export import export_run_log
from saltus.render.backends import make_renderer
from saltus.render.camera import RobotCamera
from saltus.render.exposure import PerfectExposure
from saltus.render.process import CameraProcess
from saltus.setup import Setup
from saltus.wire import codec
from saltus.wire.bus import RawSample
from saltus.wire.codec import Envelope
from saltus.wire.messages import Message

STEP_NS = TICK_NS * POLICY_STEPS


def jumping_log(
    folder: Path, seconds: float = 4.5, profile: Profile = IDEAL, seed: int = 1
) -> RunLog:
    """The log of a run onto a step; the robot sets out after a second.

    Effects of `profile` are not claimed.
    """
    config = RunConfig(
        robot="go1",
        grid="line",
        seed=seed,
        profile="ideal",
        terrain=TerrainConfig(terrain="step", height_m=0.15),
    )
    setup = named_setup(config)
    with Recorder(folder / "recording.mcap", config, setup) as file:
        for key, message in _run(replace(setup, profile=profile), round(1e9 * seconds / STEP_NS)):
            envelope = Envelope(message.time_ns // STEP_NS, message.time_ns, bytes(16))
            file.write(
                RawSample(key, codec.encode_message(message), envelope.to_bytes(), message.time_ns)
            )
    export_run_log(read_recording(folder / "recording.mcap"), folder / "log")
    return read_run_log(folder / "log")


def _run(setup: Setup, steps: int) -> Iterator[tuple[str, Message]]:
    robot = MujocoRobot(setup)
    robot.reset()
    loop, planner = (
        ControlLoop(ROBOT),
        PlannerProcess(LINE, Jumper(ROBOT, make_planner("scripted", ROBOT, LINE))),
    )
    renderer = make_renderer("embree", setup.terrain, RobotCamera.on(ROBOT))
    camera = CameraProcess(
        load_camera("ideal"),
        PerfectExposure(renderer, MODEL_CAMERA),
        IDEAL.camera_chain,
        np.random.default_rng(0),
    )
    for step in range(steps):
        now_ns = step * STEP_NS
        for tick in range(POLICY_STEPS):
            loop.sense(robot.read())
            if tick == 0:
                yield "plant/truth", (truth := robot.truth(now_ns, step))
                if (frame := camera.step(truth, now_ns)) is not None:
                    yield "camera/depth", frame
                yield "controller/state", (state := loop.state(now_ns, step))
                plan = planner.step(state, true_heightmap(robot, setup.trial, now_ns, step), now_ns)
            robot.write(loop.act(plan, 0.0))
        yield "controller/joints", loop.take_joint_log(now_ns, step)
