"""Forces on the trunk that no library has."""

import numpy as np

from benchmarks.hidden_effects.robot import Floats
from benchmarks.hidden_effects.scene import Setting

STEP_S = 0.002
DAMPING = 0.05
"""Damping of a load on straps: swings some times before it rests."""


class Pushes:
    """Horizontal forces on the trunk, one step of the control loop after another.

    Args:
        by: Hidden effects by name.
        rows: Steps of the log.
    """

    def __init__(self, by: dict[str, Setting], rows: int) -> None:
        self._rows = rows
        self._wind, self._load = by.get("side_wind"), by.get("loose_load")
        self._push = _nudges(by["nudges"], rows) if "nudges" in by else np.zeros((rows, 2))
        self._before: Floats | None = None
        self._swing, self._swing_rate = np.zeros(2), np.zeros(2)

    def force(self, step: int, velocity: Floats) -> Floats:
        """Force along x and y of the world [N]; nothing but the load acts before step 0."""
        force = self._load_force(velocity)
        if step < 0:
            return force
        if self._wind is not None:
            force[1] += self._wind.size * np.sin(
                2 * np.pi * self._wind.shape["rate"] * step * STEP_S
            )
        return force + self._push[step]

    def _load_force(self, velocity: Floats) -> Floats:
        """Force of a mass on a spring that the trunk carries along."""
        if self._load is None:
            return np.zeros(2)
        before = velocity if self._before is None else self._before
        self._before = velocity.copy()
        natural = 2 * np.pi * self._load.shape["rate"]
        restoring = natural**2 * self._swing + 2 * DAMPING * natural * self._swing_rate
        self._swing_rate = self._swing_rate - (velocity - before) - restoring * STEP_S
        self._swing = self._swing + self._swing_rate * STEP_S
        return np.asarray(self._load.size * restoring)


def _nudges(setting: Setting, rows: int) -> Floats:
    """Short pushes at random moments, in random directions; shape (rows, 2)."""
    rng = np.random.default_rng(int(setting.shape["seed"]))
    push = np.zeros((rows, 2))
    width = round(0.15 / STEP_S)
    for start in rng.integers(0, rows - width, max(rows // 1000, 3)):
        angle = rng.uniform(0, 2 * np.pi)
        shape = np.sin(np.pi * np.arange(width) / width)
        push[start : start + width] += (
            setting.size * shape[:, None] * np.array([np.cos(angle), np.sin(angle)])
        )
    return push
