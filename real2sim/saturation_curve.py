"""A saturation told in full: delivered torque at several commands, as a dynamometer would give it."""

from dataclasses import dataclass

import numpy as np

from real2sim.joint_drives import lost
from real2sim.joints import JointProblem
from real2sim.layout import STEP, Layout
from real2sim.problem import Floats

SPACING = 5.0  # Nm between points, as in the original's table
ITERATIONS = 4
SLOPE_STEP = 0.01
"""Of finite differences: losses change by 0.05 Nm from point to point."""
STIFFNESS = 1e-6
"""Of a slope that the log does not tell, relative to the best told: it stays where it was."""
EFFECT = "torque_saturation"

Curve = tuple[tuple[float, float], ...]
"""Pairs of commanded and delivered torque [Nm]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pieces:
    """Which slopes are sought: of each place with a saturation up to the largest command of the log."""

    corners: Floats
    """[Nm], shape (places, pieces)."""
    blocks: tuple[np.ndarray, ...]
    """For each place which blocks have the saturation, shape (blocks,)."""
    of: tuple[tuple[int, int], ...]
    """Place and piece of each slope that is sought."""

    def everywhere(self, slopes: Floats) -> Floats:
        """Slopes, shape (sets, sought), for all blocks and places: shape (sets, blocks, places, pieces)."""
        full = np.zeros((len(slopes), len(self.blocks[0]), *self.corners.shape))
        for i, (place, piece) in enumerate(self.of):
            full[:, self.blocks[place], place, piece] = slopes[:, i, None]
        return full


def saturation_curves(problem: JointProblem, unknowns: Floats) -> dict[str, Curve]:
    """Curves by place, e.g. "calf", one for all legs that have a saturation there.

    The curves of all places are fitted together, as the joints of a leg move each other.

    Args:
        problem: Of the joints.
        unknowns: Of a model with a saturation, as fitted; shape (blocks, unknowns).
    """
    columns = [problem.columns_of(EFFECT, place) for place in problem.places[0]]
    blocks = tuple(unknowns[:, column.start] != 0.0 for column in columns)
    spacing = SPACING * problem.limit / problem.limit.max()  # at weaker joints all happens at smaller torques
    counts = [int(np.ceil(reached.torque / dx)) for reached, dx in zip(problem.reached, spacing, strict=True)]
    pieces = _Pieces(
        corners=spacing[:, None] * np.arange(max(counts)),
        blocks=blocks,
        of=tuple((j, k) for j in range(len(columns)) if blocks[j].any() for k in range(counts[j])),
    )
    rest = unknowns.copy()
    start = np.zeros(pieces.corners.shape)
    for j, column in enumerate(columns):
        rest[:, column] = 0.0
        if blocks[j].any():
            start[j] = _falls(np.median(unknowns[blocks[j], column], axis=0), pieces.corners[j], spacing[j])
    slopes = _fitted(problem, rest, pieces, np.array([start[j, k] for j, k in pieces.of]))
    found = pieces.everywhere(slopes[None])[0].max(axis=0)
    return {
        place: _curve(pieces.corners[j, : counts[j]], found[j], spacing[j])
        for j, place in enumerate(problem.places[0])
        if blocks[j].any()
    }


def _falls(fitted: Floats, corners: Floats, spacing: float) -> Floats:
    """By how much the slope of the fitted law falls at each corner."""
    missing = np.concatenate([[0.0], lost(corners + spacing, *fitted)])
    return np.diff(np.diff(missing) / spacing, prepend=0.0)


def _fitted(problem: JointProblem, rest: Floats, pieces: _Pieces, slopes: Floats) -> Floats:
    """Gauss-Newton on slopes, shape (sought,), and on the nuisances, which had to make up for the law fitted before."""
    layout = Layout.of(problem)
    free = layout.nuisances
    sought = np.concatenate([slopes, np.median(rest[:, free], axis=0)])
    steps = np.concatenate([np.full(len(slopes), SLOPE_STEP), STEP * layout.scale[free]])
    for _ in range(ITERATIONS):
        tries = sought + np.concatenate([np.zeros((1, len(steps))), np.diag(steps)])
        unknowns = np.repeat(rest[None], len(tries), axis=0)
        unknowns[:, :, free] = tries[:, None, len(slopes) :]
        falls = pieces.everywhere(tries[:, : len(slopes)])
        residuals = problem.residuals_with_hinges(unknowns, pieces.corners, falls)
        jacobian = (residuals[1:] - residuals[0]) / steps[:, None]
        hessian = jacobian @ jacobian.T
        hessian += STIFFNESS * np.trace(hessian[: len(slopes), : len(slopes)]) * np.eye(len(steps))
        sought = sought - np.linalg.solve(hessian, jacobian @ residuals[0])
        sought[len(slopes) :] = np.clip(sought[len(slopes) :], layout.low[free], layout.high[free])
    return sought[: len(slopes)]


def _curve(corners: Floats, slopes: Floats, spacing: float) -> Curve:
    points = corners + spacing
    taken = np.sum(slopes[: len(corners)] * np.maximum(points[:, None] - corners, 0.0), axis=1)
    return tuple((float(a), float(a - b)) for a, b in zip(points, taken, strict=True))
