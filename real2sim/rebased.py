"""A problem whose simulator starts with the effects of a profile: only what is still missing is searched for."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from saltus.arrays import Floats
from saltus.effects.effect import Effect
from saltus.effects.profile import Profile
from saltus.effects.torque_saturation import TorqueSaturation
from saltus.errors import ConfigError
from saltus.real2sim.problem.joints.problem import JointProblem
from saltus.real2sim.problem.problem import Candidate, Estimate, Problem, Unknown, WrappedProblem
from saltus.robots.robot import JOINTS, Robot

FITS = 0.02
"""Largest relative error with which a candidate may represent a value of the profile: well below what a log shows."""

STEP = 0.02
"""Relative step of finite differences."""


class RebasedProblem(WrappedProblem):
    """`inner` with unknowns that are 0 at the values of a profile.

    Args:
        inner: Problem of the simulator without effects.
        profile: Effects that the simulator has from the start.
    """

    def __init__(self, inner: Problem, profile: Profile) -> None:
        curve = next((e for e in profile.actuator if isinstance(e, TorqueSaturation) and e.curve), None)
        if curve is not None and isinstance(inner, JointProblem):  # no candidate can represent a measured curve
            inner = _saturated(inner, curve)
            profile = replace(profile, actuator=tuple(e for e in profile.actuator if e is not curve))
        super().__init__(inner)
        offsets = [_offset(inner, candidate, profile) for candidate in inner.candidates]
        self._offset = np.concatenate(offsets, axis=1) if offsets else np.zeros((len(inner.blocks), 0))
        """Shape (blocks, unknowns)."""
        self.candidates = tuple(
            _moved(candidate, offset) for candidate, offset in zip(inner.candidates, offsets, strict=True)
        )
        # The verdict states one value for all blocks: it counts from the mean of the blocks that have the effect.
        self._means = {
            (candidate.effect, candidate.where): _mean(offset)
            for candidate, offset in zip(inner.candidates, offsets, strict=True)
        }

    def residuals(self, unknowns: Floats) -> Floats:
        """See `Problem`."""
        return self._inner.residuals(unknowns + self._offset)

    def physical(self, candidate: Candidate, values: Floats) -> dict[str, Estimate]:
        """See `Problem`: the whole effect, including the part that the profile has."""
        key = (candidate.effect, candidate.where)
        original = next(c for c in self._inner.candidates if (c.effect, c.where) == key)
        return self._inner.physical(original, values + self._means[key])


def _saturated(problem: JointProblem, saturation: TorqueSaturation) -> JointProblem:
    """The problem of a simulator with this saturation.

    Raises:
        ConfigError: the log names an MJCF, which does not say to which motors a curve in a profile refers.
    """
    if not isinstance(problem.model, Robot):
        raise ConfigError(
            f"a saturation that is given as a curve is one of a named robot; the log is of {problem.model}"
        )
    names = [[block[place] for place in problem.places[0]] for block in problem.places]
    starts, falls = saturation.fitted(problem.model).corners
    columns = np.array([[JOINTS.index(name) for name in block] for block in names])
    corners: Floats = np.asarray(starts[:, columns[0]].T, dtype=np.float64)
    slopes: Floats = np.asarray(falls[:, columns].transpose(1, 2, 0), dtype=np.float64)
    return problem.with_saturation(corners, slopes)


def _mean(offset: Floats) -> Floats:
    present = offset[np.any(offset != 0.0, axis=1)]
    return present.mean(axis=0) if len(present) else np.zeros(offset.shape[1])


def _moved(candidate: Candidate, offset: Floats) -> Candidate:
    """The candidate with unknowns that are 0 at `offset`, shape (blocks, its unknowns)."""
    if not np.any(offset):
        return candidate
    # If the profile has the effect already, its shape matters from the start and is an unknown like the others.
    unknowns = tuple(
        Unknown(
            name=unknown.name,
            low=unknown.low - float(offset[:, i].min()),
            high=unknown.high - float(offset[:, i].max()),
            scale=unknown.scale,
        )
        for i, unknown in enumerate(candidate.unknowns)
    )
    nowhere = tuple(0.0 for _ in unknowns)
    return replace(candidate, unknowns=unknowns, starts=(nowhere,))


def _offset(problem: Problem, candidate: Candidate, profile: Profile) -> Floats:
    """Unknowns at which the candidate is as the profile says, for each block; 0 where the profile lacks the effect."""
    offset = np.zeros((len(problem.blocks), len(candidate.unknowns)))
    effect = _effect(profile, candidate.effect)
    if effect is None or candidate.is_nuisance:
        return offset
    solved: dict[tuple[float, ...], Floats] = {}
    for block, places in enumerate(problem.places):
        wanted = _values(effect, places.get(candidate.where, candidate.where), problem, candidate)
        if wanted is None:
            continue
        key = tuple(wanted.values())
        if key not in solved:
            solved[key] = _solve(problem, candidate, wanted)
        offset[block] = solved[key]
    return offset


def _effect(profile: Profile, name: str) -> Effect[Any] | None:
    for part in (profile.actuator, profile.camera, profile.imu, profile.body):
        for effect in part:
            if effect.name == name:
                return effect
    return None


def _values(effect: Effect[Any], place: str, problem: Problem, candidate: Candidate) -> dict[str, float] | None:
    """Parameters of the effect at one place, as far as the candidate has them; None if it has none."""
    names = problem.physical(candidate, np.asarray(candidate.starts[0], dtype=np.float64)).keys()
    values: dict[str, float] = {}
    for name in names:
        value = np.asarray(getattr(effect, name, np.nan), dtype=np.float64)
        if value.ndim:
            value = value[JOINTS.index(place)] if place in JOINTS else value[0]
        values[name] = float(value)
    return values if np.isfinite(list(values.values())).all() else None


def _solve(problem: Problem, candidate: Candidate, wanted: dict[str, float]) -> Floats:
    """Unknowns at which the candidate has the wanted parameters; zeros if there are none."""
    low = np.array([u.low for u in candidate.unknowns])
    high = np.array([u.high for u in candidate.unknowns])
    target = np.array(list(wanted.values()))

    def error(x: Floats) -> Floats:
        found = problem.physical(candidate, np.asarray(x, dtype=np.float64))
        values = np.array([found[name].value for name in wanted])
        return np.nan_to_num((values - target) / (np.abs(target) + 1e-9), nan=1e3, posinf=1e3, neginf=-1e3)

    best, least = np.zeros(len(low)), FITS
    inner = tuple(0.75 * low + 0.25 * high)  # at 0 the derivative of a squared sine is 0
    for start in (*candidate.starts, inner):
        inside = np.clip(start, low + 1e-6 * (high - low), high - 1e-6 * (high - low))
        scale = [u.scale for u in candidate.unknowns]
        # A knee is read from a grid, so steps must be larger than the grid's.
        x = least_squares(error, inside, bounds=(low, high), x_scale=scale, diff_step=[STEP] * len(scale)).x
        # Unknowns without influence on parameters take the value that a verdict states.
        x = np.array([at if u.stated is None else u.stated for u, at in zip(candidate.unknowns, x, strict=True)])
        if (worst := float(np.abs(error(x)).max())) < least:
            best, least = x, worst
    return best
