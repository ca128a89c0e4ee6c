"""How a held base that may roll answers legs that move as measured, and what their joints feel of it."""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.sim.held_robot import RollingBase

STILL_ROWS = 25
"""At the beginning of a stretch, over whose mean the base is taken to hang still."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sway:
    """A log on uniform rows, with coefficients halfway to the next row; stretches are first rows and ends."""

    base: RollingBase
    dt_s: float
    stretches: tuple[tuple[int, int], ...]

    def rolled(self, weight: Floats, give: Floats, damping: Floats) -> Floats:
        """Angle, rate and acceleration of the base halfway to the next row, shape (rows, 3, branches, sets).

        Args:
            weight: By which they are multiplied, shape (branches, sets).
            give: Of what holds it, as each branch has it [rad/Nm], shape (branches, sets).
            damping: [Nm s/rad], the same shape.
        """
        (gives, damped), which = np.unique(np.stack([give, damping]).reshape(2, -1), axis=1, return_inverse=True)
        moved = np.concatenate([self._moved(gives, damped, slice(*stretch)) for stretch in self.stretches])
        return np.asarray(weight * moved[..., which.reshape(give.shape)])

    def load(self, rolled: Floats, rows: Indices) -> Floats:
        """Torques that resist the joints from some rows to the next [Nm], shape (windows, branches, joints, sets).

        `rolled` is of all rows, `rows` of shape (windows,).
        """
        return np.asarray(np.einsum("wbjk,wkbs->wbjs", self.base.on_joints[rows], rolled[rows]))

    def _moved(self, give: Floats, damping: Floats, own: slice) -> Floats:
        """The midpoint rule over a stretch, shape (its rows, 3, pairs); where nothing gives, the base keeps still."""
        half, gives = 0.5 * self.dt_s, give > 0.0
        moment = self.base.moment[own, None]
        stiffness, damped, inertia = self.base.on_base[own].T[..., None]
        stiffness, damped = stiffness + 1.0 / np.where(gives, give, 1.0), damped + damping
        resists = inertia + half * (damped + half * stiffness)
        hangs = -np.mean(moment[:STILL_ROWS]) / np.mean(stiffness[:STILL_ROWS], axis=0)
        angle, rate = np.where(gives, hangs, 0.0), np.zeros(len(give))
        out = np.empty((len(moment), 3, len(give)))
        for k in range(len(moment)):
            pushed = moment[k] + stiffness[k] * (angle + half * rate) + damped[k] * rate
            acceleration = np.where(gives, -pushed / resists[k], 0.0)
            middle = rate + half * acceleration
            out[k] = angle + half * middle, middle, acceleration
            angle, rate = angle + 2.0 * half * middle, rate + 2.0 * half * acceleration
        return out
