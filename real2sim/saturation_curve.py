"""A saturation told in full: delivered torque at several commands,
as a dynamometer would give it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.real2sim.problem.joints.candidates import knee_and_plateau
from saltus.real2sim.problem.joints.drives import lost_to_saturation
from saltus.real2sim.problem.joints.problem import JointProblem
from saltus.real2sim.problem.joints.torque_curve import TorqueCurve, delivered_torque
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.search.findings import FoundEffect, ParameterInterval, SearchFindings
from saltus.real2sim.search.unknowns_layout import STEP, UnknownsLayout

SPACING = 5.0  # Nm between points at the strongest joint, as in the original's table
ITERATIONS = 4
SLOPE_STEP = 0.01
"""Step of finite differences: losses change by 0.05 Nm from point to point."""
STIFFNESS = 1e-6
"""Stiffness of a slope that the log does not tell, relative to the best told: it stays where it
was."""
FINEST = 400
"""Points of a law among which those of its curve are chosen."""
DRAWN_NM = 0.02
"""How near a curve of few points must come to its law: a tenth of the noise of a drive's torque."""
EFFECT = "torque_saturation"


def with_curves(problem: Problem, findings: SearchFindings) -> SearchFindings:
    """Findings whose saturation is stated for each kind of joint, with its curve.

    The curve is the fitted law, or one in pieces where that leaves less of the rows that no fit has
    seen; then knee and plateau are read off it. Several logs together, and what is beside a
    profile, have none.
    """
    if not isinstance(problem, JointProblem):
        return findings
    left, found = (
        findings.residuals,
        [effect for effect in findings.effects if effect.name == EFFECT],
    )
    places = list(problem.places[0])
    here = [
        [(effect, names) for effect in found if (names := _names(problem, effect, place))]
        for place in places
    ]
    if not found or left is None or any(len(effects) > 1 for effects in here):
        return findings  # legs that differ have no curve in common
    pieces = _Pieces.of_model(problem, left.unknowns)
    seen = np.where(left.is_test[None], 0.0, 1.0)
    slopes, residuals = _fitted(
        problem, left.unknowns, pieces, np.broadcast_to(seen, left.after.shape)
    )
    in_pieces = bool(
        np.sum((residuals**2)[:, left.is_test]) < np.sum(left.after[:, left.is_test] ** 2)
    )
    stated = []
    for j, effects in enumerate(here):
        for effect, names in effects:
            curve = pieces.curve(slopes, j)
            if in_pieces and _rises(curve):
                params = _moved(effect, curve, float(problem.limit[j]))
            else:
                column = problem.columns_of(EFFECT, places[j])
                fitted = np.median(left.unknowns[pieces.blocks[j], column], axis=0)
                params, curve = effect.params, _drawn(fitted, problem.reach[j].torque)
            stated.append(replace(effect, where=names, params=params, curve=curve))
    return replace(findings, effects=(*(e for e in findings.effects if e.name != EFFECT), *stated))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pieces:
    """Which slopes are sought: of each place with a saturation up
    to the largest command of the log.
    """

    corners: Floats
    """[Nm], shape (places, pieces)."""
    blocks: tuple[NDArray[np.bool_], ...]
    """For each place which blocks have the saturation, shape (blocks,)."""
    of: tuple[tuple[int, int], ...]
    """Place and piece of each slope that is sought."""

    @classmethod
    def of_model(cls, problem: JointProblem, unknowns: Floats) -> "_Pieces":
        """The pieces for a model that was fitted, unknowns of shape (blocks, unknowns)."""
        blocks = tuple(
            unknowns[:, problem.columns_of(EFFECT, place).start] != 0.0
            for place in problem.places[0]
        )
        # At weaker joints all happens at smaller torques
        spacing = SPACING * problem.limit / problem.limit.max()
        counts = [
            int(np.ceil(reach.torque / dx))
            for reach, dx in zip(problem.reach, spacing, strict=True)
        ]
        return cls(
            corners=spacing[:, None] * np.arange(max(counts)),
            blocks=blocks,
            of=tuple(
                (j, k) for j in range(len(counts)) if blocks[j].any() for k in range(counts[j])
            ),
        )

    def everywhere(self, slopes: Floats) -> Floats:
        """Slopes, shape (sets, sought), for all blocks and places:
        shape (sets, blocks, places, pieces).
        """
        full = np.zeros((len(slopes), len(self.blocks[0]), *self.corners.shape))
        for i, (place, piece) in enumerate(self.of):
            full[:, self.blocks[place], place, piece] = slopes[:, i, None]
        return full

    def curve(self, slopes: Floats, place: int) -> TorqueCurve:
        """Commanded and delivered torque of a place at the end of each piece."""
        own = np.array([slopes[i] for i, (j, _) in enumerate(self.of) if j == place])
        points = self.corners[place, 1] * np.arange(1, len(own) + 1)
        taken = np.sum(
            own * np.maximum(points[:, None] - self.corners[place, : len(own)], 0.0), axis=1
        )
        return tuple((float(a), float(a - b)) for a, b in zip(points, taken, strict=True))


def _fitted(
    problem: JointProblem, unknowns: Floats, pieces: _Pieces, weight: Floats
) -> tuple[Floats, Floats]:
    """Gauss-Newton on slopes and on the nuisances,
    which had to make up for the law that was fitted before.

    Returns:
        Slopes, shape (sought,), and the residuals that they leave, shape (blocks, m), of which
        `weight` has the weights in the fit.
    """
    layout = UnknownsLayout.of(problem)
    rest, slopes = _without(problem, unknowns, pieces)
    free, count = layout.nuisances, len(slopes)
    sought = np.concatenate([slopes, np.median(rest[:, free], axis=0)])
    steps = np.concatenate([np.full(count, SLOPE_STEP), STEP * layout.scale[free]])

    def residuals(tries: Floats) -> Floats:
        sets = np.repeat(rest[None], len(tries), axis=0)
        sets[:, :, free] = tries[:, None, count:]
        return problem.residuals_with_kinks(
            sets, pieces.corners, pieces.everywhere(tries[:, :count])
        )

    for _ in range(ITERATIONS):
        r = (
            residuals(sought + np.concatenate([np.zeros((1, len(steps))), np.diag(steps)]))
            * weight.ravel()
        )
        jacobian = (r[1:] - r[0]) / steps[:, None]
        hessian = jacobian @ jacobian.T
        hessian += STIFFNESS * np.trace(hessian[:count, :count]) * np.eye(len(steps))
        sought = sought - np.linalg.solve(hessian, jacobian @ r[0])
        sought[count:] = np.clip(sought[count:], layout.low[free], layout.high[free])
    return sought[:count], residuals(sought[None])[0].reshape(weight.shape)


def _without(problem: JointProblem, unknowns: Floats, pieces: _Pieces) -> tuple[Floats, Floats]:
    """The model without its saturation, and that saturation as slopes."""
    rest, falls = unknowns.copy(), np.zeros(pieces.corners.shape)
    for j, place in enumerate(problem.places[0]):
        column = problem.columns_of(EFFECT, place)
        rest[:, column] = 0.0
        if pieces.blocks[j].any():
            fitted, spacing = (
                np.median(unknowns[pieces.blocks[j], column], axis=0),
                pieces.corners[j, 1],
            )
            missing = np.concatenate(
                [[0.0], lost_to_saturation(pieces.corners[j] + spacing, *fitted)]
            )
            # By how much the slope falls at each corner
            falls[j] = np.diff(np.diff(missing) / spacing, prepend=0.0)
    return rest, np.array([falls[j, k] for j, k in pieces.of])


def _names(problem: JointProblem, effect: FoundEffect, place: str) -> tuple[str, ...]:
    """The joints of one kind at which an effect was found."""
    names = tuple(places[place] for places in problem.places)
    return names if effect.where == "all" else tuple(name for name in names if name in effect.where)


def _rises(curve: TorqueCurve) -> bool:
    delivered = np.array([0.0, *(given for _, given in curve)])
    return bool(np.all(np.diff(delivered) > 0.0))


def _moved(effect: FoundEffect, curve: TorqueCurve, limit: float) -> dict[str, ParameterInterval]:
    """Knee and plateau of a curve.

    By how far they are from those of the law counts as half of an interval's width.
    """
    params = {}
    for name, value in knee_and_plateau(
        lambda torque: torque - delivered_torque(curve, torque), limit
    ).items():
        before = effect.params[name]
        half_width = float(
            np.hypot(0.5 * (before.ci90[1] - before.ci90[0]), 0.5 * (value - before.value))
        )
        params[name] = ParameterInterval(
            value=value, ci90=(value - half_width, value + half_width), unit=before.unit
        )
    return params


def _drawn(fitted: Floats, reach: float) -> TorqueCurve:
    """A law as a curve of few points: where it is farthest from the curve so far comes the next."""
    asked = np.linspace(0.0, reach, FINEST + 1)
    given = asked - lost_to_saturation(asked, *fitted)
    chosen = [0, FINEST]
    while True:
        apart = np.abs(np.interp(asked, asked[chosen], given[chosen]) - given)
        if apart.max() < DRAWN_NM:
            return tuple((float(asked[i]), float(given[i])) for i in chosen[1:])
        chosen = sorted([*chosen, int(apart.argmax())])
