"""Errors of the camera mount that training data are drawn with."""

import numpy as np

from saltus import go1
from saltus.render.camera import Mount

PITCH_ERROR = np.deg2rad(1.5)  # a printed mount and its screws
POSITION_ERROR_M = 0.01


def random_mount(rng: np.random.Generator) -> Mount:
    """The camera of one robot, as it really sits."""
    offset = rng.uniform(-POSITION_ERROR_M, POSITION_ERROR_M, 3)
    return Mount(position=go1.CAMERA_POSITION + offset, pitch=go1.CAMERA_PITCH + rng.uniform(-PITCH_ERROR, PITCH_ERROR))


def random_mounts(rng: np.random.Generator, count: int) -> Mount:
    """The cameras of `count` robots, each with a place of its own."""
    offset = rng.uniform(-POSITION_ERROR_M, POSITION_ERROR_M, (count, 3))
    pitch = rng.uniform(-PITCH_ERROR, PITCH_ERROR, count)
    return Mount(position=go1.CAMERA_POSITION + offset, pitch=go1.CAMERA_PITCH + pitch)
