"""Problems of several logs as one: the effects belong to the robot, the claims to each log.

A robot that is logged twice, the second time on other terrain, with other gains or with a known
payload, has the same effects both times. Each log is replayed under its own claims and with its own
nuisances; the unknowns of the effects are shared.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import fields, replace

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.effects.effect import Effect
from saltus.effects.profile import PARTS, Profile
from saltus.real2sim.problem.problem import (
    Candidate,
    ExplanatoryVariable,
    LogSegment,
    Problem,
    WrappedProblem,
)
from saltus.real2sim.search.model_fit import ProblemEvaluator, fitted_null
from saltus.real2sim.search.unknowns_layout import UnknownsLayout
from saltus.robots.robot import JOINTS

EffectAtPlace = tuple[str, str]
"""Effect and where; the names of nuisances carry the number of their log."""


class StackedProblem(Problem):
    """One problem with the residuals of several.

    Args:
        problems: Problems of one kind of sensor; see `can_stack`.
        shifts_s: Seconds by which each clock is set later so that logs follow each other, shape
            (logs,).
    """

    collinear = 1.0
    """With several logs only the evidence counts: effects form a set if both explain all logs, not
    if they merely look alike."""

    def __init__(self, problems: Sequence[Problem], shifts_s: Sequence[float]) -> None:
        first = problems[0]
        self._problems = tuple(problems)
        self.name, self.blocks, self.places = first.name, first.blocks, first.places
        self.samples_per_residual = max(problem.samples_per_residual for problem in problems)
        self.simulator_disagreement = max(problem.simulator_disagreement for problem in problems)
        self.untestable = {
            name: why
            for name, why in first.untestable.items()
            if all(name in p.untestable for p in problems)
        }
        self._merge_candidates()
        self._merge_rows(shifts_s)
        for problem, columns in zip(self._problems, self._columns, strict=True):
            if problem.likely is not None:  # of what several logs show, the last one tells
                self.likely = np.zeros(len(self.absent)) if self.likely is None else self.likely
                self.likely[columns] = problem.likely

    def residuals(self, unknowns: Floats) -> Floats:
        """See `Problem`."""
        each = zip(self._problems, self._columns, self._alone, strict=True)
        return np.concatenate(
            [p.residuals(unknowns[..., columns] + alone) for p, columns, alone in each], axis=-1
        )

    def explanatory_variables(self) -> tuple[ExplanatoryVariable, ...]:
        """See `Problem`; NaN for logs whose problem lacks the variable."""
        found: dict[str, ExplanatoryVariable] = {}
        ends = np.cumsum([len(problem.time_s) for problem in self._problems])
        for problem, end in zip(self._problems, ends, strict=True):
            for variable in problem.explanatory_variables():
                values = (
                    found[variable.name].values
                    if variable.name in found
                    else np.full(len(self.time_s), np.nan)
                )
                values[end - len(problem.time_s) : end] = variable.values
                found[variable.name] = replace(variable, values=values)
        return tuple(found.values())

    def leaner(self) -> dict[str, Problem]:
        """See `Problem`."""
        each = [problem.leaner() for problem in self._problems]
        found: dict[str, Problem] = {}
        for name in dict.fromkeys(name for own in each for name in own):
            other = copy(self)
            other._problems = tuple(
                own.get(name, p) for own, p in zip(each, self._problems, strict=True)
            )
            found[name] = other
        return found

    def replayed_alike(self, effects: Sequence[str]) -> Problem:
        """See `Problem`."""
        each = tuple(problem.replayed_alike(effects) for problem in self._problems)
        if each == self._problems:
            return self
        other = copy(self)
        other._problems = each
        return other

    def _merge_candidates(self) -> None:
        self._alone = [_without_effects(problem) for problem in self._problems]
        """Unknowns of each problem where all unknowns of this one are 0, shape (blocks,
        unknowns)."""
        each = enumerate(zip(self._problems, self._alone, strict=True), start=1)
        listed_by_log = [_listed(problem, alone, number) for number, (problem, alone) in each]
        places = list(dict.fromkeys(place for listed in listed_by_log for place in listed))
        self.candidates = tuple(
            _merged(place, [listed[place] for listed in listed_by_log if place in listed])
            for place in places
        )
        sizes = [len(candidate.unknowns) for candidate in self.candidates]
        starts = dict(zip(places, np.cumsum([0, *sizes[:-1]]), strict=True))
        self._columns = [
            np.concatenate(
                [starts[place] + np.arange(len(c.unknowns)) for place, c in listed.items()]
            )
            for listed in listed_by_log
        ]
        """Columns of each problem's unknowns among all unknowns."""

    def _merge_rows(self, shifts_s: Sequence[float]) -> None:
        self.signals = tuple(
            dict.fromkeys(signal for problem in self._problems for signal in problem.signals)
        )
        segments: list[LogSegment] = []
        segment: list[Indices] = []
        signal: list[Indices] = []
        for number, (problem, shift_s) in enumerate(
            zip(self._problems, shifts_s, strict=True), start=1
        ):
            segment.append(np.asarray(problem.segment) + len(segments))
            signal.append(
                np.array([self.signals.index(name) for name in problem.signals])[problem.signal]
            )
            segments += [_moved(one, number, shift_s) for one in problem.segments]
        self.segments, self.segment, self.signal = (
            tuple(segments),
            np.concatenate(segment),
            np.concatenate(signal),
        )
        self.time_s = np.concatenate(
            [p.time_s + s for p, s in zip(self._problems, shifts_s, strict=True)]
        )


def can_stack(problems: Sequence[Problem]) -> bool:
    """True where the unknowns of all problems mean the same, so that they can be shared.

    They do not if they count from claims that differ, as a latency counts from the claimed one.
    """
    first, *others = problems
    if any(
        (p.name, p.blocks, p.places) != (first.name, first.blocks, first.places) for p in others
    ):
        return False
    return all(_mean_the_same(a, b) for i, a in enumerate(problems) for b in problems[:i])


def _without_effects(problem: Problem) -> Floats:
    """Nuisances fitted to one log alone, so that a fit to all logs starts near them."""
    layout = UnknownsLayout.of(problem)
    rest = np.zeros((len(problem.blocks), len(layout.scale)))
    if len(own := layout.nuisances):
        null, _ = fitted_null(problem, ProblemEvaluator(problem), layout)
        rest[:, own] = null.unknowns[:, own]
    return rest


def _mean_the_same(one: Problem, other: Problem) -> bool:
    theirs = {(c.effect, c.where): c for c in other.candidates if not c.is_nuisance}
    for mine in one.candidates:
        match = theirs.get((mine.effect, mine.where))
        if match is None:
            continue
        if [u.name for u in mine.unknowns] != [u.name for u in match.unknowns]:
            return False
        start = np.asarray(mine.starts[0], dtype=np.float64)
        for added in (0.0, 1.0):
            values = start + added * np.array(
                [0.0 if u.is_shape else u.scale for u in mine.unknowns]
            )
            here, there = mine.parameters(values), match.parameters(values)
            if here.keys() != there.keys():
                return False
            mine_says, theirs_says = ([says[name].value for name in here] for says in (here, there))
            if not np.allclose(mine_says, theirs_says, rtol=1e-6, atol=1e-12, equal_nan=True):
                return False
    return True


def _listed(problem: Problem, alone: Floats, number: int) -> dict[EffectAtPlace, Candidate]:
    """Candidates by place. The nuisances of each log are separate and count from `alone`."""
    listed: dict[EffectAtPlace, Candidate] = {}
    start = 0
    for candidate in problem.candidates:
        own = alone[:, start : start + len(candidate.unknowns)]
        start += len(candidate.unknowns)
        if not candidate.is_nuisance:
            listed[candidate.effect, candidate.where] = candidate
            continue
        unknowns = tuple(
            replace(
                unknown,
                low=unknown.low - float(value.max()),
                high=unknown.high - float(value.min()),
            )
            for unknown, value in zip(candidate.unknowns, own.T, strict=True)
        )
        listed[f"{candidate.effect} of log {number}", candidate.where] = replace(
            candidate, unknowns=unknowns
        )
    return listed


def _merged(place: EffectAtPlace, same: Sequence[Candidate]) -> Candidate:
    """One candidate with the narrowest bounds and all starts."""
    first = same[0]
    unknowns = tuple(
        replace(
            unknown,
            low=max(c.unknowns[k].low for c in same),
            high=min(c.unknowns[k].high for c in same),
        )
        for k, unknown in enumerate(first.unknowns)
    )
    low, high = ([getattr(unknown, end) for unknown in unknowns] for end in ("low", "high"))
    starts = [tuple(np.clip(start, low, high).tolist()) for c in same for start in c.starts]
    return replace(
        first,
        effect=place[0],
        unknowns=unknowns,
        starts=tuple(dict.fromkeys(starts)),
        model_error=max(c.model_error for c in same),
        resolution=max(c.resolution for c in same),
        closable_share=min(c.closable_share for c in same),
        least_closed=max(c.least_closed for c in same),
        leaves_chance=any(c.leaves_chance for c in same),
    )


def _moved(segment: LogSegment, number: int, shift_s: float) -> LogSegment:
    """The segment on the common clock; motions of different logs are not repeats of each other."""
    return replace(
        segment,
        name=f"{number}/{segment.name}",
        condition=f"{number}/{segment.condition}",
        start_s=segment.start_s + shift_s,
        end_s=segment.end_s + shift_s,
    )


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
            _from_offset(candidate, offset)
            for candidate, offset in zip(inner.candidates, offsets, strict=True)
        )

    def residuals(self, unknowns: Floats) -> Floats:
        """See `Problem`."""
        return self._inner.residuals(unknowns + self._offset)

    def replayed_alike(self, effects: Sequence[str]) -> Problem:
        """See `Problem`."""
        alike = self._bare.replayed_alike(effects)
        return self if alike is self._bare else RebasedProblem(alike, self._profile)

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


def _from_offset(candidate: Candidate, offset: Floats) -> Candidate:
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
