"""A problem whose library lacks effects: what a search says of a gap that none of the others makes."""

from collections.abc import Collection

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import Candidate, Driver, Estimate, Problem


class Narrowed(Problem):
    """`inner` without some of its effects; they stay absent.

    Args:
        inner: A problem.
        without: Names of effects.
    """

    def __init__(self, inner: Problem, without: Collection[str]) -> None:
        self._inner = inner
        self.name, self.blocks, self.places = inner.name, inner.blocks, inner.places
        self.segments, self.segment = inner.segments, inner.segment
        self.signals, self.signal, self.time_s = inner.signals, inner.signal, inner.time_s
        self.samples_per_residual, self.simulation_doubt = inner.samples_per_residual, inner.simulation_doubt
        self.untestable = {name: why for name, why in inner.untestable.items() if name not in without}
        self.candidates = tuple(c for c in inner.candidates if c.effect not in without)
        is_kept = [c.effect not in without for c in inner.candidates for _ in c.unknowns]
        self._kept = np.flatnonzero(is_kept)
        starts = [start for c in inner.candidates for start in c.starts[0]]
        is_shape = [unknown.is_shape for c in inner.candidates for unknown in c.unknowns]
        self._absent = np.where(is_shape, starts, 0.0)

    def residuals(self, unknowns: Floats) -> Floats:
        """See `Problem`."""
        full = np.tile(self._absent, (*unknowns.shape[:2], 1))
        full[:, :, self._kept] = unknowns
        return self._inner.residuals(full)

    def physical(self, candidate: Candidate, values: Floats) -> dict[str, Estimate]:
        """See `Problem`."""
        return self._inner.physical(candidate, values)

    def drivers(self) -> tuple[Driver, ...]:
        """See `Problem`."""
        return self._inner.drivers()
