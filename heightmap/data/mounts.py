"""Errors of the camera mount that training data are drawn with."""

from dataclasses import replace

import numpy as np

from saltus.robots.mount import Mount
from saltus.robots.robot import Robot

POSITION_ERROR_M, PITCH_ERROR = 0.02, np.deg2rad(2.5)
"""Along each axis, and in pitch [rad], at most: a bracket that was bent in a fall, twice what a
printed mount and its screws are off. Less is more frequent: the density falls from the nominal
place to nothing. A model is only given to cameras nearer than this
(`saltus.heightmap.service.network.MOUNT_PITCH_ERROR`)."""


def random_mount(robot: Robot, rng: np.random.Generator, count: int | None = None) -> Mount:
    """The camera of one robot as it really sits.

    The cameras of `count` robots, each with a place of its own.
    """
    offset = rng.triangular(
        -POSITION_ERROR_M, 0.0, POSITION_ERROR_M, 3 if count is None else (count, 3)
    )
    pitch = rng.triangular(-PITCH_ERROR, 0.0, PITCH_ERROR, count)
    claimed = Mount.of(robot)
    return replace(claimed, position=claimed.position + offset, pitch=claimed.pitch + pitch)
