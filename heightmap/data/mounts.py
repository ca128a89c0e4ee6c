"""Errors of the camera mount that training data are drawn with."""

import numpy as np

from saltus.render.camera import Mount
from saltus.robots.robot import Robot

POSITION_ERROR_M, PITCH_ERROR = 0.02, np.deg2rad(2.5)
"""Along each axis, and in pitch [rad]: a bracket that was bent in a fall, twice what a printed mount and its screws are
off. A model is only given to cameras nearer than this (`saltus.heightmap.service.network.MOUNT_PITCH_ERROR`)."""


def random_mount(robot: Robot, rng: np.random.Generator, count: int | None = None) -> Mount:
    """The camera of one robot as it really sits; the cameras of `count` robots, each with a place of its own."""
    offset = rng.uniform(-POSITION_ERROR_M, POSITION_ERROR_M, 3 if count is None else (count, 3))
    pitch = rng.uniform(-PITCH_ERROR, PITCH_ERROR, count)
    return Mount(position=robot.camera_position + offset, pitch=robot.camera_pitch + pitch)
