"""How far a comparison has got: each stage counts for what it typically costs,
and within a search more work moves on.

Typical costs were measured on logs of 15 to 30 s, on one core: eight logs of the experiments and of
the benchmark.
"""

import math
from collections.abc import Callable, Sequence

from saltus.real2sim.sensors import Sensor

ProgressListener = Callable[[str, float], None]
"""Called with the name of a stage and the share of all that is done."""

SCREEN_S, CONCLUDE_S = 1.5, 3.0
"""Screening and aligning, and the verdict with its report [s]."""
LEVELS = ("slopes", "single effects", "2 effects", "3 effects", "reported values")
"""Stages of a search that raise its level; other stages belong to the level that has been
reached."""
REACHED = (0.25, 0.6, 0.85, 0.97, 1.0)
"""Share of a search at the end of each level. Most logs end after the second: what is then left is
jumped over."""
SIMULATIONS = (65, 100, 200, 200, 10)
"""Sets of unknowns that a level typically simulates."""


class ComparisonProgress:
    """How far a whole comparison of logs with the simulator is: shares of its sensors; tells a
    stage and the share that is done.
    """

    def __init__(self, tell: ProgressListener | None, sensors: Sequence[Sensor]) -> None:
        self._tell = tell
        self._total_s = (
            SCREEN_S + sum(sensor.prepare_s + sensor.search_s for sensor in sensors) + CONCLUDE_S
        )
        self._done_s = SCREEN_S

    def begin(self, stage: str) -> None:
        """A stage begins."""
        self._show(stage, self._done_s)

    def end(self, seconds: float) -> None:
        """A stage that typically takes so many seconds is over."""
        self._done_s += seconds

    def search(self, name: str, seconds: float) -> Callable[[str, int], None]:
        """Function that a search of so many typical seconds calls
        with its stage and the simulations it has made.
        """
        level, share = 0, 0.0

        def simulated(stage: str, count: int) -> None:
            nonlocal level, share
            if stage in LEVELS[level + 1 :]:
                share = REACHED[LEVELS.index(stage) - 1]
                level = LEVELS.index(stage)
            share += (REACHED[level] - share) * -math.expm1(-count / SIMULATIONS[level])
            self._show(name, self._done_s + share * seconds)

        return simulated

    def _show(self, stage: str, done_s: float) -> None:
        if self._tell is not None:
            self._tell(stage, min(1.0, done_s / self._total_s))
