"""Planner randomisation: planners differ from robot to robot,
so that the network does not overfit one gait.
"""

from dataclasses import fields, replace

import numpy as np

from saltus.policy.scripted import ScriptedParameters

# The policy reacts to what it reaches: slower and other rhythms than its own, but not so that it
# falls.
SPEED, RHYTHM = (0.7, 1.1), (0.93, 1.07)
"""Share of the policy's speed and of its stepping frequency, from and to."""


def varied(rng: np.random.Generator, variation: float, count: int) -> ScriptedParameters:
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
