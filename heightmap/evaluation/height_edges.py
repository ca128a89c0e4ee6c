"""Where a terrain profile jumps, and how far a predicted jump is from the true one."""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats

JUMP_M = 0.03  # a smaller one the feet do not mind: the swing clears 6 cm
STEP_M = 0.005  # a jump goes on while each point of the grid adds this much in the same direction
MATCH_M = 0.15  # half the run of the shortest stair: a jump farther away is another one


@dataclass(frozen=True, kw_only=True)
class HeightEdge:
    """One step up or down in a profile of heights."""

    x: float
    """Where the profile passes half of the jump [m]."""
    size: float
    """Height after it less height before [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeErrors:
    """All true steps of many profiles of heights, and how they were predicted."""

    true_x: Floats
    """Place of each true jump [m], shape (n,)."""
    error: Floats
    """Predicted less true position [m]; NaN where it was not predicted. Shape (n,)."""
    false: int
    """Predicted jumps of which there is no true one within `MATCH_M`."""

    @property
    def found(self) -> float:
        """Share of the true jumps that were predicted."""
        return float(np.isfinite(self.error).mean()) if len(self.error) else float("nan")

    @property
    def mean_m(self) -> float:
        """Mean absolute error of position over those that were found [m]."""
        found = self.error[np.isfinite(self.error)]
        return float(np.abs(found).mean()) if len(found) else float("nan")

    @property
    def bias_m(self) -> float:
        """Mean error; positive: the predicted edge is too far ahead [m]."""
        found = self.error[np.isfinite(self.error)]
        return float(found.mean()) if len(found) else float("nan")


def jumps(height: Floats, x: Floats) -> list[HeightEdge]:
    """Finds the jumps of one profile at points ahead,
    both of shape (points,) [m]; a NaN ends a jump.
    """
    change = np.diff(height)
    # A comparison with NaN is false
    direction = np.where(np.abs(change) > STEP_M, np.sign(change), 0.0).tolist()
    found = []
    i = 0
    while i < len(direction):
        end = i + 1
        while end < len(direction) and direction[end] == direction[i]:
            end += 1
        size = height[end] - height[i]
        if direction[i] != 0.0 and abs(size) > JUMP_M:
            rising = np.abs(height[i : end + 1] - height[i])
            found.append(
                HeightEdge(
                    x=float(np.interp(0.5 * abs(size), rising, x[i : end + 1])), size=float(size)
                )
            )
        i = end
    return found


def edge_errors(predicted: Floats, true: Floats, x: Floats) -> EdgeErrors:
    """Matches the jumps of predicted profiles with those of true ones,
    shape (n, points) each, at points ahead.

    A true jump takes the nearest predicted one in the same direction that no nearer one has taken.
    """
    true_x, errors, false = [], [], 0
    for height, reference in zip(predicted, true, strict=True):
        mine, wanted = jumps(height, x), jumps(reference, x)
        pairs = sorted(
            (abs(a.x - b.x), i, j)
            for i, a in enumerate(mine)
            for j, b in enumerate(wanted)
            if a.size * b.size > 0.0 and abs(a.x - b.x) <= MATCH_M
        )
        taken: dict[int, int] = {}
        for _, i, j in pairs:
            if i not in taken.values() and j not in taken:
                taken[j] = i
        true_x += [jump.x for jump in wanted]
        errors += [
            mine[taken[j]].x - jump.x if j in taken else np.nan for j, jump in enumerate(wanted)
        ]
        known = np.isfinite(
            reference
        ).all()  # where the reference is not known, nobody can say what is false
        false += len(mine) - len(taken) if known else 0
    return EdgeErrors(true_x=np.array(true_x), error=np.array(errors), false=false)
