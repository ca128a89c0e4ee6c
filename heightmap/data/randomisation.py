"""Randomisation of training data: planners differ from robot to robot, so that the network does not
overfit one gait, and cameras sit not quite where they should.
"""

from dataclasses import fields, replace

import numpy as np

from saltus.policy.scripted import ScriptedParameters
from saltus.robots.mount import Mount
from saltus.robots.robot import Robot

# The policy reacts to what it reaches: slower and other rhythms than its own, but not so that it
# falls.
SPEED, RHYTHM = (0.7, 1.1), (0.93, 1.07)
"""Share of the policy's speed and of its stepping frequency, from and to."""


def vary_planner(rng: np.random.Generator, variation: float, count: int) -> ScriptedParameters:
    """The planner's numbers, each times its own random factor for each robot.

    Speeds also down to a half.
    """
    start = ScriptedParameters()
    factors = {f.name: 1.0 + variation * rng.normal(size=count) for f in fields(start)}
    factors["velocity_x"] *= rng.uniform(0.5, 1.1, count)
    return replace(
        start,
        **{name: np.asarray(getattr(start, name)) * factor for name, factor in factors.items()},
    )


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
