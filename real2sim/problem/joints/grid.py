"""A signal of its own for encoders that know a finite number of angles.

Where a joint moves, true angles pass through all phases of a step alike; what a coarse encoder reads stays near whole
multiples. The mean of cos(2 pi q / step) over a sample tells the two apart in a few samples, whatever the model of the
motion, which near rest depends on chance: a drive that hunts between two steps does so differently each time.
"""

from collections.abc import Sequence

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.joints.excitation import LEAST_MOVING
from saltus.real2sim.problem.joints.motion import Rows


class Grid:
    """The signal of a log, in units of its noise.

    Args:
        rows: Of the log.
        steps: Of each joint's encoder as its angles suggest [rad], None where they suggest none.
        within: Rows of each sample, shape (samples, rows each).
        branches: Joints of each leg, shape (branches, joints).
    """

    def __init__(self, rows: Rows, steps: Sequence[float | None], within: Indices, branches: Indices) -> None:
        step = np.array([np.inf if s is None else s for s in steps])
        moves = (np.abs(rows.speed) > LEAST_MOVING) & np.isfinite(step) & rows.q_is_known
        # of variance 1 where phases are uniform
        phase = np.where(moves, np.sqrt(2.0) * np.cos(2.0 * np.pi * rows.q / step), 0.0)
        self._weight = np.sqrt(moves[within].sum(axis=1))[:, branches]  # (samples, branches, joints)
        sums = phase[within].sum(axis=1)[:, branches]
        self._measured = np.divide(sums, self._weight, where=self._weight > 0.0, out=np.zeros_like(sums))
        self._coarse = (phase.sum(axis=0) / np.maximum(moves.sum(axis=0), 1))[branches]
        self.exists = bool(np.any(self._weight))

    def residuals(self, quantisation: tuple[Floats, Floats] | None, count: int) -> Floats:
        """Measured minus expected, shape (samples, branches, joints, sets).

        Args:
            quantisation: Weight and step of each set, as in `Drives`.
            count: Number of sets.
        """
        weight = np.zeros((*self._coarse.shape, count)) if quantisation is None else quantisation[0]
        return np.asarray(self._measured[..., None] - self._weight[..., None] * self._coarse[..., None] * weight)
