"""Where an effect acts, its size there, and the interval of that size."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.problem import Candidate, ParameterEstimate, Problem
from saltus.real2sim.search.decide import ModelComparison
from saltus.real2sim.search.findings import FoundEffect, ParameterInterval
from saltus.real2sim.search.model_fit import ModelFit
from saltus.real2sim.search.quadratic import unknowns_covariance, white_covariance

SAME = 0.1
"""Values at several places count as equal if they differ by less than this share beyond their
errors: as much as friction or gain of equal drives scatter."""
CONSISTENT = 1e-3
"""Significance level below which a pattern of places is rejected."""
ROUNDING = 1e-12
"""Share of a variance that rounding may take from it."""
PRESENT = 3.0
"""Smallest size of an effect at a place where it is present, in standard errors."""
PRESENT_SHARE = 0.1
"""Smallest share of its RMS at the place that shows it best: joints are coupled, and so are their
models."""

ALONG = 1.0 / 3.0
"""Size of the part of a misfit that a fit hides in its values, relative to the part that it
leaves. A misfit is taken to lie as any other effect does: of 4,100 pairs of effects in the joint
logs of two benchmarks, one has along the signature of the other 0.33 times (RMS) what it has beside
it, pairs with |cos| above 0.9 not counted."""
TINY = 1e-30
"""Keeps shares finite where an effect leaves no trace."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectPlace:
    """Estimate of an effect at one place.

    Attributes:
        block: Index of the block.
        candidate: Index of the candidate.
        name: Name of the place in the verdict.
        value: Unknowns of the candidate.
        covariance: Covariance of the value by noise, shape (k, k).
        misfit: Covariance of the value because the effect has another shape than its model, shape
            (k, k).
        rms: RMS of the effect there, in the segment and signal that show it best [sigma].
    """

    block: int
    candidate: int
    name: str
    value: Floats
    covariance: Floats
    misfit: Floats
    rms: float


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectGroup:
    """Places at which an effect has one value; its covariances are those of `EffectPlace`."""

    places: tuple[EffectPlace, ...]
    value: Floats
    covariance: Floats
    misfit: Floats


def places_of(
    problem: Problem, comparison: ModelComparison, fit: ModelFit, effect: str
) -> list[EffectPlace]:
    """Estimates of a fitted effect at all its places."""
    quadratic = fit.quadratic(comparison.layout, comparison.split)
    free = np.ones(len(fit.columns), dtype=bool)
    found = []
    for block in range(len(problem.blocks)):
        scatter = unknowns_covariance(quadratic, block, free)
        white = white_covariance(quadratic, block, free)
        for index, candidate in enumerate(problem.candidates):
            if candidate.effect != effect:
                continue
            columns = comparison.layout.of_candidate(index)
            own = np.flatnonzero(np.isin(fit.columns, columns))
            sized = own[~comparison.layout.is_shape[fit.columns[own]]]
            trace = fit.unknowns[block, fit.columns[sized]] @ fit.jacobian[block, sized]
            wrong = _misfit_norm(comparison, fit, block, candidate, own)
            found.append(
                EffectPlace(
                    block=block,
                    candidate=index,
                    name=problem.places[block].get(candidate.where, candidate.where),
                    value=fit.unknowns[block, columns],
                    covariance=_with_unseen(scatter[np.ix_(own, own)], candidate),
                    misfit=white[np.ix_(own, own)] * np.outer(wrong, wrong),
                    rms=float(np.sqrt(comparison.cells.power(trace).max())),
                )
            )
    return found


def _misfit_norm(
    comparison: ModelComparison, fit: ModelFit, block: int, candidate: Candidate, own: Indices
) -> Floats:
    """Norm by which a true effect may differ from its model along the signature of each unknown,
    shape (own,).

    It is a share of what the unknown adds, and a shape of what the whole effect adds: that of two
    correct models; and `ALONG` of what the model leaves where the signature shows. `own` are the
    unknowns of the effect among those that are fitted.
    """
    cells, jacobian = comparison.cells, fit.jacobian[block, own]
    columns = fit.columns[own]
    is_shape = comparison.layout.is_shape[columns]
    sizes = fit.unknowns[block, columns]
    whole = cells.counts @ cells.power(sizes[~is_shape] @ jacobian[~is_shape])
    shown = cells.power(jacobian)  # (own, cells)
    norm = shown @ cells.counts
    added = np.where(is_shape, whole, sizes**2 * norm)
    weight = cells.counts * shown
    unexplained = np.maximum(weight @ cells.beyond_noise(fit.residuals[block]), 0.0)
    left = unexplained / np.maximum(np.sum(weight * shown, axis=1), TINY) * norm
    return np.asarray(np.sqrt(candidate.model_error**2 * added + ALONG**2 * left))


def group(problem: Problem, places: list[EffectPlace], least: float) -> list[EffectGroup]:
    """The simplest pattern of places and values that agrees with the estimates.

    Patterns, simplest first: one value everywhere; at one kind of place; in one block; at one
    place. If none agrees, all places at which the effect is present get one value if they agree
    on it, else one for each kind of place (e.g. a saturation of small motors and of a large
    one) or, where one kind does not agree, one for each place. `least` is the RMS from which an
    effect is present.
    """
    everywhere = list(range(len(places)))
    present = present_at(problem, places, least)
    has_shape = any(
        unknown.is_shape for unknown in problem.candidates[places[0].candidate].unknowns
    )
    kinds = {problem.candidates[place.candidate].where for place in places}
    tiers: list[list[list[int]]] = [
        [everywhere],
        [
            [i for i in everywhere if problem.candidates[places[i].candidate].where == kind]
            for kind in sorted(kinds)
        ],
        [
            [i for i in everywhere if places[i].block == block]
            for block in range(len(problem.blocks))
        ],
        [[i] for i in everywhere],
    ]
    for tier in tiers:
        misfits = [_misfit(problem, places, members, present) for members in tier]
        best = int(np.argmax(misfits))
        if misfits[best] > CONSISTENT:
            own = [places[i] for i in tier[best]]
            # an effect without a trace may have any shape
            telling = [places[i] for i in tier[best] if not has_shape or i in present]
            return [replace(_pool(telling), places=tuple(own))]
    members = [places[i] for i in present]
    if _agreement(problem, members) > CONSISTENT:
        return [_pool(members)]
    alike = [kind for kind in _by_kind(problem, members) if _agreement(problem, kind) > CONSISTENT]
    rest = [place for kind in _by_kind(problem, members) if kind not in alike for place in kind]
    return [_pool(each) for each in (*alike, *([place] for place in rest))]


def each_alone(problem: Problem, places: list[EffectPlace], least: float) -> list[EffectGroup]:
    """Every place at which an effect is present, with its own value; arguments as `group`."""
    return [_pool([places[i]]) for i in present_at(problem, places, least)]


def each_trace(places: list[EffectPlace], least: float) -> list[EffectGroup]:
    """Every place at which the effect has an RMS of `least`,
    and the place that shows it best, with its own value.
    """
    least = min(least, max(place.rms for place in places))
    return [_pool([place]) for place in places if place.rms >= least]


def present_at(problem: Problem, places: list[EffectPlace], least: float) -> list[int]:
    """Indices of the places at which an effect is larger than chance and simulator disagreement.

    At least one.
    """
    largest = int(np.argmax([place.rms for place in places]))
    least = max(least, PRESENT_SHARE * places[largest].rms)
    found = []
    for i, place in enumerate(places):
        sized = _sized(problem.candidates[place.candidate])
        error = np.sqrt(np.diag(place.covariance))[sized]
        if place.rms >= least and np.any(np.abs(place.value[sized]) > PRESENT * error):
            found.append(i)
    return found or [largest]


def stated_apart(problem: Problem, one: EffectGroup) -> list[EffectGroup]:
    """The group, in parts where its value means other parameters,
    as it counts from what a profile has there.
    """
    parts: dict[tuple[float, ...], list[EffectPlace]] = {}
    for place in one.places:
        told = problem.candidates[place.candidate].parameters(one.value, place.block)
        parts.setdefault(tuple(found.value for found in told.values()), []).append(place)
    return [replace(one, places=tuple(places)) for places in parts.values()]


def found_effect(problem: Problem, effect: str, one: EffectGroup, total: int) -> FoundEffect:
    """A group, of `total` places at which the effect could be, in the form of the verdict."""
    names = tuple(place.name for place in one.places)
    where: str | tuple[str, ...] = names
    if total == 1:
        where = names[0]
    elif len(names) == total:
        where = "all"
    return FoundEffect(name=effect, where=where, params=_intervals(problem, one))


def _intervals(problem: Problem, one: EffectGroup) -> dict[str, ParameterInterval]:
    """Physical parameters with errors by noise and by a wrong shape.

    The second is at least the share of correct models, of the parameter or, for a size, of its
    distance from where the effect is absent.
    """
    candidate, block = problem.candidates[one.places[0].candidate], one.places[0].block
    values = candidate.parameters(one.value, block)
    absent = np.where([unknown.is_shape for unknown in candidate.unknowns], one.value, 0.0)
    variance = _variances(candidate, one.value, one.covariance, block)
    misfit = _variances(candidate, one.value, one.misfit, block)
    for name, null in candidate.parameters(absent, block).items():
        distance = abs(values[name].value - null.value)
        # A shape has no null value
        size = min(abs(values[name].value), distance if distance > 0.0 else np.inf)
        variance[name] += max(misfit[name], (candidate.model_error * size) ** 2)
    variance[next(iter(variance))] += candidate.resolution**2
    return {name: _interval(at, float(np.sqrt(variance[name]))) for name, at in values.items()}


def _variances(
    candidate: Candidate, value: Floats, covariance: Floats, block: int
) -> dict[str, float]:
    """Variances of physical parameters by differences along the axes of a covariance."""
    low = np.array([unknown.low for unknown in candidate.unknowns])
    high = np.array([unknown.high for unknown in candidate.unknowns])
    variance = dict.fromkeys(candidate.parameters(value, block), 0.0)
    powers, axes = np.linalg.eigh(covariance)
    for power, axis in zip(powers, axes.T, strict=True):
        reach = np.sqrt(max(0.0, power)) * axis
        above = candidate.parameters(np.clip(value + reach, low, high), block)
        below = candidate.parameters(np.clip(value - reach, low, high), block)
        for name in variance:
            variance[name] += (0.5 * (above[name].value - below[name].value)) ** 2
    return variance


def _interval(at: ParameterEstimate, error: float) -> ParameterInterval:
    half_width = float(stats.norm.ppf(0.95)) * error
    ci90 = (float(at.value - half_width), float(at.value + half_width))
    return ParameterInterval(value=float(at.value), ci90=ci90, unit=at.unit)


def _sized(candidate: Candidate) -> Indices:
    return np.flatnonzero([not unknown.is_shape for unknown in candidate.unknowns])


def _with_unseen(covariance: Floats, candidate: Candidate) -> Floats:
    """Covariance in which unknowns without influence on
    residuals may be anywhere within their bounds.

    It can be inverted, also where residuals tell only a sum of two unknowns.
    """
    # Sigma of a uniform
    widths = np.array([(unknown.high - unknown.low) / 3.5 for unknown in candidate.unknowns])
    own = np.diag(covariance)
    return covariance + np.diag(np.where(own <= 0.0, widths**2, ROUNDING * own))


def _weights(places: list[EffectPlace], share: float) -> list[Floats]:
    """Inverse covariances of estimates, with a model error
    that is a share of the most certain value.
    """
    surest = max(places, key=lambda place: place.rms)
    largest = np.abs(surest.value)
    return [
        np.asarray(np.linalg.inv(place.covariance + np.diag((share * largest) ** 2 + 1e-18)))
        for place in places
    ]


def _agreement(problem: Problem, places: list[EffectPlace]) -> float:
    """Probability of a scatter as large as that of the estimates if all places have one value.

    Kinds of places are also compared with each other: a difference of one kind would be lost in the
    scatter of all places.
    """
    kinds = [_pool(own) for own in _by_kind(problem, places)]
    return min(
        _scatter([place.value for place in places], _weights(places, SAME)),
        _scatter([kind.value for kind in kinds], [_between(kind, kinds) for kind in kinds]),
    )


def _by_kind(problem: Problem, places: list[EffectPlace]) -> list[list[EffectPlace]]:
    kinds = dict.fromkeys(problem.candidates[place.candidate].where for place in places)
    return [
        [place for place in places if problem.candidates[place.candidate].where == kind]
        for kind in kinds
    ]


def _between(kind: EffectGroup, kinds: list[EffectGroup]) -> Floats:
    """Inverse covariance of the value of a kind,
    with drives that differ by a share of the largest value.
    """
    share = (
        SAME * np.max([np.abs(each.value) for each in kinds], axis=0) / np.sqrt(len(kind.places))
    )
    return np.asarray(np.linalg.inv(kind.covariance + np.diag(share**2 + 1e-18)))


def _scatter(values: list[Floats], weights: list[Floats]) -> float:
    """Probability of values as far apart as these if they are equal."""
    mean = np.linalg.solve(sum(weights), sum(w @ x for w, x in zip(weights, values, strict=True)))
    square = sum(float((x - mean) @ w @ (x - mean)) for w, x in zip(weights, values, strict=True))
    freedom = (len(values) - 1) * len(mean)
    return float(stats.chi2.sf(square, freedom)) if freedom else 1.0


def _misfit(
    problem: Problem, places: list[EffectPlace], members: list[int], present: list[int]
) -> float:
    """Probability of these estimates for a pattern: one value at its members, absent elsewhere."""
    if not set(present) <= set(members):
        return 0.0
    return _agreement(problem, [places[i] for i in members])


def _pool(places: list[EffectPlace]) -> EffectGroup:
    """One value for several places, weighted by their errors; its error covers their scatter.

    Places have one law, so that a wrong shape moves the values of all of them alike: its error does
    not average out.
    """
    weights = _weights(places, 0.0)
    covariance: Floats = np.asarray(np.linalg.inv(sum(weights)))
    value = covariance @ sum(w @ p.value for w, p in zip(weights, places, strict=True))
    if len(places) > 1:
        square = sum(
            float((p.value - value) @ w @ (p.value - value))
            for w, p in zip(weights, places, strict=True)
        )
        covariance = covariance * max(1.0, square / ((len(places) - 1) * len(value)))
    shown = np.array([place.rms**2 for place in places])
    misfit = np.average([p.misfit for p in places], axis=0, weights=np.maximum(shown, TINY))
    return EffectGroup(places=tuple(places), value=value, covariance=covariance, misfit=misfit)
