"""Predictors that Saltus brings, on the inputs of the benchmark alone: baselines, and a network."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.depth_to_heights.files import StoredSplit, read_inputs
from benchmarks.depth_to_heights.split import CAMERA, Inputs
from saltus.constants import POLICY_DT
from saltus.depth import MODEL_CAMERA, depth_frame
from saltus.depth_camera import load_camera
from saltus.grid import HEIGHTMAP_X, LINE
from saltus.heightmap.evaluation.comparison import BASELINES as GEOMETRIC
from saltus.heightmap.evaluation.geometric import GeometricHeightmap
from saltus.heightmap.evaluation.held_out import HeldOutPrediction, step_ns
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.quantiles import UNKNOWN_HALF_WIDTH_M
from saltus.heightmap.service.replay import HeightPredictor, replay_predictor
from saltus.heightmap.service.service import HeightmapService
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.states import ProprioceptionArrays, robot_state_message
from saltus.wire.messages import ControllerMode, DepthFrame, Heightmap, HeightmapStatus, RobotState


class FlatGround:
    """All ground is as high as the feet that stand, and how wrong that is nobody knows."""

    def __init__(self, robot: Robot) -> None:
        del robot  # its own estimate says how high it stands

    def step(self, state: RobotState, frame: DepthFrame | None, now_ns: int) -> Heightmap:
        """See `saltus.heightmap.service.replay.HeightPredictor`."""
        del frame, now_ns
        return Heightmap(
            time_ns=state.time_ns, step=state.step, x=HEIGHTMAP_X,
            height=np.full(len(HEIGHTMAP_X), -state.base_height),
            half_width_90=np.full(len(HEIGHTMAP_X), UNKNOWN_HALF_WIDTH_M),
            status=HeightmapStatus.OK,
            depth_age_s=math.inf, frame_id=-1, model_id="flat",
        )  # fmt: skip


BASELINES: dict[str, Callable[[Robot], HeightPredictor]] = {
    "flat": FlatGround,
    "newest": partial(GeometricHeightmap, grid=LINE, images=1),
    **{
        name: partial(GeometricHeightmap, grid=LINE, foot_gain=gain)
        for name, gain in GEOMETRIC.items()
    },
}
"""Without training: flat ground at the feet; the newest image deprojected; those of 2 s, in the
robot's own odometry; the same, moved to the standing feet."""
NETWORK = "network"


def predict_run(split: StoredSplit, task: tuple[str, Path | None, int]) -> HeldOutPrediction:
    """Prediction of a baseline, or of a model's service, in one run.

    The name and the run are of the task.
    """
    name, model, run = task
    robot = load_camera(CAMERA).mounted_on(load_robot(DEFAULT_ROBOT))
    made = (
        BASELINES[name](robot)
        if model is None
        else HeightmapService(HeightmapNetwork(robot, model))
    )
    return predict(made, read_inputs(split, run))


def predict(predictor: HeightPredictor, inputs: Inputs) -> HeldOutPrediction:
    """Returns what a predictor that has not been used before says in one run."""
    steps = len(inputs.depth)
    taken = np.arange(steps) - np.rint(inputs.depth_age_s / POLICY_DT).astype(np.int64)
    taken[inputs.depth_age_s < 0.0] = -1
    new = np.flatnonzero(np.diff(taken, prepend=-1)).tolist()
    frames = [
        depth_frame(
            MODEL_CAMERA, inputs.depth[step], time_ns=step_ns(int(taken[step])), frame_id=number
        )
        for number, step in enumerate(new)
    ]
    maps = replay_predictor(predictor, frames, _states(inputs), [step_ns(step) for step in new])
    return HeldOutPrediction(
        height=np.array([said.height for said in maps], np.float64),
        half_width_90=np.array([said.half_width_90 for said in maps], np.float64),
    )


def _states(inputs: Inputs) -> list[RobotState]:
    """Returns what the robot says of itself; what predictors are not given is 0."""
    steps = len(inputs.depth)
    states = ProprioceptionArrays(
        **inputs.robot, step=0, leg_progress=np.zeros((steps, 4)), cycle=np.zeros(steps, np.int64)
    )
    return [
        robot_state_message(states, step, time_ns=step_ns(step), step=step, mode=ControllerMode.RUN)
        for step in range(steps)
    ]
