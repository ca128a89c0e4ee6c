"""A problem whose simulator starts with the effects of a profile:
only what is still missing is searched for.
"""

from dataclasses import fields, replace

import numpy as np

from saltus.arrays import Floats
from saltus.effects.effect import Effect
from saltus.effects.profile import PARTS, Profile
from saltus.real2sim.problem.problem import Candidate, Problem, WrappedProblem
from saltus.robots.robot import JOINTS

NOT_HELD = "the profile's values lie beyond what replays can hold: this search went on without them"
FITS = 0.02
"""Largest relative error with which a candidate may represent a value of the profile: well below
what a log shows."""


class RebasedProblem(WrappedProblem):
    """`inner`, whose simulator has no effects,
    with unknowns that are 0 at the values of a profile.
    """

    def __init__(self, inner: Problem, profile: Profile) -> None:
        self._bare, self._profile = inner, profile
        inner, profile = inner.holding(profile)
        super().__init__(inner)
        found = [_offset(inner, candidate, profile) for candidate in inner.candidates]
        lost = {
            c.effect
            for c, offset in zip(inner.candidates, found, strict=True)
            if np.isnan(offset).any()
        }
        self.untestable = inner.untestable | dict.fromkeys(lost, NOT_HELD)
        offsets = [np.nan_to_num(offset) for offset in found]
        self._offset = (
            np.concatenate(offsets, axis=1) if offsets else np.zeros((len(inner.blocks), 0))
        )
        """Shape (blocks, unknowns)."""
        self.likely = None if inner.likely is None else inner.likely - self._offset.mean(axis=0)
        self.candidates = tuple(
            _moved(candidate, offset)
            for candidate, offset in zip(inner.candidates, offsets, strict=True)
        )

    def residuals(self, unknowns: Floats) -> Floats:
        """See `Problem`."""
        return self._inner.residuals(unknowns + self._offset)

    def leaner(self) -> dict[str, Problem]:
        """See `Problem`."""
        # what a profile says as the log claims it anyway, or as no replay can hold, is not there to
        # be taken out
        held = self._bare.held
        there = {
            candidate.effect
            for candidate in self.candidates
            if candidate.base or candidate.effect in held
        }
        parts = {part: getattr(self._profile, part) for part in PARTS.values()}
        return {
            gone.name: RebasedProblem(
                self._bare,
                replace(self._profile, **{part: tuple(e for e in effects if e is not gone)}),
            )
            for part, effects in parts.items()
            for gone in effects
            if gone.name in there
        }


def _moved(candidate: Candidate, offset: Floats) -> Candidate:
    """The candidate with unknowns that are 0 at `offset`, shape (blocks, its unknowns)."""
    if not offset.any():
        return candidate
    # If the profile has the effect already, its shape matters from the start and is an unknown like
    # the others.
    unknowns = tuple(
        replace(
            u,
            low=u.low - float(own.min()),
            high=u.high - float(own.max()),
            is_shape=False,
            stated=None if u.stated is None else 0.0,
        )
        for u, own in zip(candidate.unknowns, offset.T, strict=True)
    )
    base = tuple(map(tuple, offset.tolist()))
    return replace(candidate, unknowns=unknowns, starts=((0.0,) * len(unknowns),), base=base)


def _offset(problem: Problem, candidate: Candidate, profile: Profile) -> Floats:
    """Unknowns at which the candidate is as the profile says, for each block;
    0 where the profile lacks the effect.

    NaN where no unknowns within their bounds make such an effect.
    """
    offset = np.zeros((len(problem.blocks), len(candidate.unknowns)))
    effect = profile.effects.get(candidate.effect)
    if effect is None or candidate.is_nuisance:
        return offset
    told = candidate.parameters(candidate.absent)
    if any(
        not np.all(np.equal(getattr(effect, name), null))
        for name, null in _of_body(effect)
        if name not in told
    ):
        return np.full_like(offset, np.nan)
    for block, places in enumerate(problem.places):
        wanted = _values(effect, places.get(candidate.where, candidate.where), candidate)
        if np.isfinite(list(wanted.values())).all():
            unknowns = candidate.unknowns_of(wanted)
            found = candidate.parameters(unknowns)
            fits = all(
                abs(found[name].value - value) <= FITS * abs(value)
                for name, value in wanted.items()
            )
            offset[block] = unknowns if fits else np.nan
    return offset


def _of_body(effect: Effect) -> list[tuple[str, float]]:
    """Parameters of an effect on body or ground,
    which are all of the same thing, with their null values.
    """
    declared = [(f.name, f.metadata) for f in fields(effect)]
    return [(name, m["null"]) for name, m in declared if effect.site == "model" and "null" in m]


def _values(effect: Effect, place: str, candidate: Candidate) -> dict[str, float]:
    """Parameters of the effect at one place, as far as the candidate has them."""
    values: dict[str, float] = {}
    for name in candidate.parameters(np.asarray(candidate.starts[0], dtype=np.float64)):
        value = np.asarray(getattr(effect, name, np.nan), dtype=np.float64)
        values[name] = float(
            value[JOINTS.index(place) if place in JOINTS else 0] if value.ndim else value
        )
    return values
