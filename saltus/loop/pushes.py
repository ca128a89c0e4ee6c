"""Pushes from the side in evaluations: each robot gets one."""

from collections.abc import Sequence

import numpy as np

from saltus.arrays import Floats
from saltus.constants import POLICY_DT, PUSH_STEPS
from saltus.terrain.terrain import Terrain
from saltus.trial import Trial

_STREAM = 9  # of a trial's seed: other numbers than those of the trial itself


class Pushes:
    """From the left or the right, when the trunk first passes a place.

    It lies between where time begins to run and the last edge, or the end of flat ground: a robot
    that is pushed behind the last edge has arrived before it could fall. Place and side follow from
    the seed of each trial, so that all policies get the same pushes.

    Args:
        impulse_ns: Of each push [Ns].
        terrains: One for each trial.
        trials: Whose seeds draw.
    """

    def __init__(
        self, impulse_ns: float, terrains: Sequence[Terrain], trials: Sequence[Trial]
    ) -> None:
        rngs = [np.random.default_rng([trial.seed, _STREAM]) for trial in trials]
        ends = [(t.timing_x, t.edges_x[-1] if t.edges_x.size else t.finish_x) for t in terrains]
        self._x = np.array([rng.uniform(*each) for rng, each in zip(rngs, ends, strict=True)])
        self._force = (
            impulse_ns
            / (PUSH_STEPS * POLICY_DT)
            * np.array([rng.choice((-1.0, 1.0)) for rng in rngs])
        )
        self._left = np.full(len(trials), PUSH_STEPS)

    def step(self, trunk_x: Floats) -> Floats:
        """Force along the world's y over the next policy step [N], of trunks at these x [m].

        Shapes (trials,).
        """
        pushed = (self._left > 0) & ((self._left < PUSH_STEPS) | (trunk_x >= self._x))
        self._left -= pushed
        return np.where(pushed, self._force, 0.0)
