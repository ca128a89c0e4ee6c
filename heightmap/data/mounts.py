"""Errors of the camera mount that training data are drawn with."""

import numpy as np

from saltus.heightmap.service.network import MOUNT_PITCH_ERROR, MOUNT_POSITION_ERROR_M
from saltus.render.camera import Mount
from saltus.robots.robot import Robot


def random_mount(robot: Robot, rng: np.random.Generator, count: int | None = None) -> Mount:
    """The camera of one robot as it really sits; the cameras of `count` robots, each with a place of its own."""
    offset = rng.uniform(-MOUNT_POSITION_ERROR_M, MOUNT_POSITION_ERROR_M, 3 if count is None else (count, 3))
    pitch = rng.uniform(-MOUNT_PITCH_ERROR, MOUNT_PITCH_ERROR, count)
    return Mount(position=robot.camera_position + offset, pitch=robot.camera_pitch + pitch)
