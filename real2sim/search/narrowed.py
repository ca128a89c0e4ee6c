"""A problem without some effects of the library: what does a search say if the true effect is missing?"""

from collections.abc import Collection

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import Problem, WrappedProblem


class NarrowedProblem(WrappedProblem):
    """`inner` without some of its effects, by name, which stay absent."""

    def __init__(self, inner: Problem, without: Collection[str]) -> None:
        super().__init__(inner)
        self.untestable = {name: why for name, why in inner.untestable.items() if name not in without}
        self.candidates = tuple(c for c in inner.candidates if c.effect not in without)
        is_kept = [c.effect not in without for c in inner.candidates for _ in c.unknowns]
        self._kept = np.flatnonzero(is_kept)
        self.likely = None if inner.likely is None else inner.likely[self._kept]

    def residuals(self, unknowns: Floats) -> Floats:
        """See `Problem`."""
        full = np.tile(self._inner.absent, (*unknowns.shape[:2], 1))
        full[:, :, self._kept] = unknowns
        return self._inner.residuals(full)
