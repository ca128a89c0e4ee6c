"""Frames and states for the tests of the heightmap service."""

from pathlib import Path

import numpy as np
from samples import ROBOT

from saltus.depth import MODEL_CAMERA, depth_frame
from saltus.heightmap.level_robot import LevelRobot
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.service import HeightmapService
from saltus.wire.messages import DepthFrame, RobotState

MS = 1_000_000
WARMUP = 4
"""Images that the model of the tests needs."""
SHORT_STAND_STEPS = 50
"""Of robots in closed loops: a shorter run than this and some steps is no episode."""


def frame(frame_id: int, time_ms: float, depth: np.ndarray | None = None) -> DepthFrame:
    """An image of the model's camera; random but always the same for one id."""
    if depth is None:
        depth = np.random.default_rng(frame_id).integers(300, 2500, (48, 16)).astype(np.uint16)
    return depth_frame(MODEL_CAMERA, depth, time_ns=round(time_ms * MS), frame_id=frame_id)


def service_of(model_path: Path) -> HeightmapService:
    """A service with the model of the tests."""
    return HeightmapService(HeightmapNetwork(ROBOT, model_path))


def states(count: int) -> list[RobotState]:
    """A robot that stands, one state every 10 ms."""
    ticks = [frame(step, 10.0 * step - 50.0) for step in range(count)]
    return LevelRobot().states(ROBOT, ticks)


def on_time(step: int) -> DepthFrame | None:
    """The image that arrives at a step of a run without faults: 50 Hz, 50 ms late."""
    if step < 5 or step % 2 == 0:
        return None
    return frame((step - 5) // 2, 10.0 * (step - 5))
