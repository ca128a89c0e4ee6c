"""From fitted models to findings: ruling, values and places,
gap on test segments, smallest detectable effects.
"""

from collections.abc import Collection, Sequence

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import ParameterEstimate, Problem
from saltus.real2sim.search import decide, estimates, signature
from saltus.real2sim.search.choose import choose_among
from saltus.real2sim.search.decide import ModelComparison, ScoredFit
from saltus.real2sim.search.findings import (
    FoundEffect,
    ModelResiduals,
    ProblemRuling,
    RankedModel,
    SearchFindings,
    SignalGap,
    SimplerMethods,
)
from saltus.real2sim.search.known_fits import KnownFits
from saltus.real2sim.search.model_fit import ModelFit, ProblemEvaluator
from saltus.real2sim.search.quadratic import (
    QuadraticCost,
    gains_spread,
    held_out_gains,
)
from saltus.real2sim.search.repeats import closed_of_repeating, repeats_of
from saltus.real2sim.search.reported import (
    Groups,
    misfits_of,
    stated_model,
    unseen_of,
    without_little,
)
from saltus.real2sim.search.residual_split import CHANCE, ResidualCells
from saltus.real2sim.search.unknowns_layout import ModelEffects, UnknownsLayout, with_effects

LASTING, UNEVEN = 0.4, 3.0
"""Noise that lasts longer than its level was read from shows in all segments, whatever they move:
up to this part of the least power that counts as a gap, and in one segment up to so many times as
much as in most."""
ALONE = 2.0
"""Times the least RMS of a gap that one segment of one signal must show if no other shows any, nor
a repeat of its motion: of several hundred such cells one may have a level of noise that is not
known well, as where one window is left of a segment and a foot rests there otherwise than
simulated."""
WORSE = 1.5
"""Ratio of a signal's gap after to before from which a model does not explain the log, whatever it
does for others: a dead zone of a drive looks like play in angles, but not in velocities. True
effects leave no signal worse by a tenth."""
RANKED = 12
"""Number of models in the report."""


def findings(
    problem: Problem,
    comparison: ModelComparison,
    evaluate: ProblemEvaluator,
    known: KnownFits,
) -> SearchFindings:
    """Findings from all fitted models; `evaluate` simulates the stated values."""
    choice = choose_among(comparison, known.fits.values())
    scored, wide, null, chosen = choice.scored, choice.dispersion, choice.null, choice.chosen
    around = known.quadratic(chosen.fit.model)
    # With the derivatives that `quadratic` has renewed
    chosen = comparison.score(known.fits[chosen.fit.model])
    model = stated_model(problem, comparison, evaluate, null, chosen)
    if rest := without_little(comparison, known.fits, chosen.fit, model.groups):
        around = known.quadratic(rest)
        chosen = comparison.score(known.fits[rest])
        model = stated_model(problem, comparison, evaluate, null, chosen)
    confusion = signature.confusion(comparison.layout, around, chosen.fit.model)
    alike = decide.ambiguities(comparison, chosen, scored, confusion, wide, problem.collinear)
    final = model.residuals
    tested = ResidualCells.of(problem, ~comparison.split.is_fit)
    ruling = _rule(problem, comparison, tested, null, chosen, alike, final)
    if (
        len(model.groups) == 1
        and ruling in ("named", "set")
        and not _is_beyond_resolution(problem, model.groups)
    ):
        ruling = _unnamed(problem, comparison, null)
    untestable = problem.untestable | unseen_of(problem, comparison, null.fit)
    seen = problem.leaner().keys() - untestable.keys() if ruling != "no_gap" else set()
    misfits = misfits_of(problem, comparison, [each.fit for each in scored], model, seen)
    ruling = "unexplained" if misfits else ruling
    is_stated = ruling in ("named", "set")
    fitted = {name: _state(problem, name, groups) for name, groups in model.groups.items()}
    effects = fitted if is_stated else {}
    return SearchFindings(
        problem=problem.name,
        verdict=ruling,
        effects=tuple(one for name, stated in effects.items() if not alike[name] for one in stated),
        sets=_sets(alike) if is_stated else (),
        rivals=(
            *(one for name, stated in effects.items() if alike[name] for one in stated),
            *(
                _instead(problem, comparison, known.fits, chosen.fit.model, alike)
                if is_stated
                else ()
            ),
        ),
        nearest=tuple(one for stated in fitted.values() for one in stated)
        if ruling == "unexplained"
        else (),
        ranking=_ranking(comparison, scored, null),
        confusion=confusion,
        gaps=_gaps(problem, tested, null.fit.residuals, final),
        residuals=ModelResiduals(
            before=null.fit.residuals,
            after=final,
            unknowns=model.unknowns,
            effects=chosen.fit.model,
            is_test=~comparison.split.is_fit,
        ),
        misfits=misfits,
        remainder=tested.largest_rms(tested.structure(final)),
        minimum_detectable=_minimum_detectable(problem, comparison, known, wide, untestable),
        untestable=untestable,
        baselines=_baselines(comparison, around, scored),
        evaluations=evaluate.evaluations,
    )


def _state(problem: Problem, effect: str, groups: list[estimates.EffectGroup]) -> list[FoundEffect]:
    total = len(problem.blocks) * sum(
        candidate.effect == effect for candidate in problem.candidates
    )
    parts = [part for group in groups for part in estimates.stated_apart(problem, group)]
    return [estimates.found_effect(problem, effect, part, total) for part in parts]


def _instead(
    problem: Problem,
    comparison: ModelComparison,
    fits: dict[ModelEffects, ModelFit],
    chosen: ModelEffects,
    alike: dict[str, list[str]],
) -> list[FoundEffect]:
    """Values of the other effects of a set, each in place of the chosen one."""
    found = []
    for effect, others in alike.items():
        for other in others:
            model = with_effects({*chosen, other} - {effect})
            if other not in chosen and model in fits:
                places = estimates.places_of(problem, comparison, fits[model], other)
                found += _state(problem, other, estimates.group(problem, places, comparison.size))
    return found


def _rule(
    problem: Problem,
    comparison: ModelComparison,
    tested: ResidualCells,
    null: ScoredFit,
    chosen: ScoredFit,
    alike: dict[str, list[str]],
    final: Floats,
) -> ProblemRuling:
    """The ruling: named, a set, unexplained or no gap.

    Nothing is named without a test that shows the gap.
    """
    least = decide.REMAINDER_RMS * problem.samples_per_residual**0.5
    if not chosen.fit.model:
        return _unnamed(problem, comparison, null)
    is_tested = bool(null.fit.residuals[:, tested.rows].any())
    left = tested.largest_rms(tested.structure(final))
    leaves_gap, leaves_more = left >= least, left >= least * problem.simulator_disagreement
    share = decide.explained_share(
        comparison, chosen.fit.model, leaves_gap=leaves_gap, leaves_more=leaves_more
    )
    is_closed = is_tested and _closed(comparison, tested, null.fit.residuals, final) >= share
    if is_tested and decide.leaves_chance(comparison, chosen.fit.model):
        shows = tested.shows(tested.structure(null.fit.residuals), comparison.size)
        is_closed |= closed_of_repeating(problem, tested, null.fit.residuals, final, shows) >= share
    if decide.shows_little(comparison, {(): null.fit}, chosen.fit):
        is_closed = _closes_all(tested, null.fit.residuals, final)
    if len(chosen.fit.model) > 2:  # three effects imitate a fourth, but not to within noise
        is_closed = is_closed and not leaves_gap
    gaps = _gaps(problem, tested, null.fit.residuals, final)
    if not is_closed or any(gap.after > WORSE * max(gap.before, 1.0) for gap in gaps):
        return _unnamed(problem, comparison, null)
    return "set" if any(alike.values()) else "named"


def _unnamed(problem: Problem, comparison: ModelComparison, null: ScoredFit) -> ProblemRuling:
    """The ruling where no effect can be named: there is a gap, or none.

    What a signal shows in most segments alike may be noise that lasts, up to `LASTING`. What one
    cell alone shows, or one of several repeats of a motion, may be chance, up to `ALONE`. Counts of
    a segment must tell as much as names an effect: two lost images of 38 are no gap.
    """
    least = decide.REMAINDER_RMS * problem.samples_per_residual**0.5
    cells, structure = comparison.cells, null.structure
    lasting = np.zeros_like(structure)
    for signal in np.unique(cells.signal):
        own = cells.signal == signal
        lasting[:, own] = np.median(structure[:, own], axis=1, keepdims=True)
    left = cells.rms(structure - np.minimum(UNEVEN * lasting, LASTING * least**2))
    left = np.where(cells.tells(structure, decide.GAIN_NATS), left, 0.0)
    shown = left > least
    is_chance = np.sum(shown) <= 1 or _is_shown_once(problem, null.fit.residuals, least)
    return "unexplained" if not is_chance or np.any(left > ALONE * least) else "no_gap"


def _is_shown_once(problem: Problem, residuals: Floats, least: float) -> bool:
    """True where one segment alone shows a gap, in whatever signals,
    and no repeat of its motion does.

    A foot that rests otherwise moves all joints of its leg. Segments count as a whole, with what
    fits have not seen.
    """
    whole = ResidualCells.of(problem, np.ones(len(problem.time_s), dtype=bool))
    shown = np.any(whole.rms(whole.structure(residuals)) > least, axis=0)
    segments = np.unique(whole.segment[shown])
    return len(segments) == 1 and bool(repeats_of(problem, int(segments[0])))


def _is_beyond_resolution(problem: Problem, groups: Groups) -> bool:
    """True where a stated value is certainly larger than two correct simulations differ by.

    Its interval then does not hold 0. Also true where no effect has a known resolution.
    """
    found = [group for several in groups.values() for group in several]
    resolutions = [problem.candidates[group.places[0].candidate].resolution for group in found]
    beyond = [
        abs(float(g.value[0])) > decide.CERTAIN * r
        for g, r in zip(found, resolutions, strict=True)
        if r > 0.0
    ]
    return any(beyond) or not beyond


def _closed(
    comparison: ModelComparison, tested: ResidualCells, before: Floats, after: Floats
) -> float:
    """Share of the structure on test segments that is gone, in the cells that showed any.

    Where none did, the test can only be nearer to the model or not: 1 or 0.
    """
    structure = tested.structure(before)
    shows = tested.shows(structure, comparison.size)
    if not shows.any():
        return float(np.sum(after[:, tested.rows] ** 2) < np.sum(before[:, tested.rows] ** 2))
    return tested.share_gone(structure, tested.structure(after), shows)


def _closes_all(tested: ResidualCells, before: Floats, after: Floats) -> bool:
    """True where all cells of the test together show more than chance,
    and a model closes `decide.LITTLE_SHARE` of it.
    """
    whole, left = tested.together(before), tested.together(after)
    chance = CHANCE * float(np.sqrt(len(before) * len(tested.rows)))
    return whole > chance and left < (1.0 - decide.LITTLE_SHARE) * whole


def _sets(alike: dict[str, list[str]]) -> tuple[tuple[str, ...], ...]:
    sets = [tuple(sorted([effect, *others])) for effect, others in alike.items() if others]
    return tuple(dict.fromkeys(sets))


def _ranking(
    comparison: ModelComparison, scored: Sequence[ScoredFit], null: ScoredFit
) -> tuple[RankedModel, ...]:
    ranked = []
    for each in sorted(scored, key=lambda each: each.total)[:RANKED]:
        gains = held_out_gains(null.held_out, each.held_out, comparison.split)
        _, interval = gains_spread(gains, comparison.rng)
        ranked.append(
            RankedModel(
                effects=each.fit.model,
                gain=comparison.gain(null, each),
                gain_ci90=interval,
                closed=comparison.closed(null, null, each),
            )
        )
    return tuple(ranked)


def _gaps(
    problem: Problem, tested: ResidualCells, before: Floats, after: Floats
) -> tuple[SignalGap, ...]:
    """Gap of each signal.

    The floor is what noise alone leaves of whitened residuals, or the model if that is less.
    """
    gaps = []
    powers = (tested.power(before), tested.power(after))
    for index, signal in enumerate(problem.signals):
        cells = np.flatnonzero(tested.signal == index)
        counts = tested.counts[cells]
        if counts.sum() == 0:
            continue
        means = [
            float((power[:, cells] * counts).sum() / (counts.sum() * len(power)))
            for power in powers
        ]
        if not any(means):  # nothing is known there
            continue
        gaps.append(
            SignalGap(
                signal=signal,
                residuals=int(counts.sum()) * len(before),
                before=means[0],
                after=means[1],
                floor=min(1.0, means[1]),
            )
        )
    return tuple(gaps)


def _minimum_detectable(
    problem: Problem,
    comparison: ModelComparison,
    known: KnownFits,
    wide: float,
    untestable: Collection[str],
) -> dict[str, ParameterEstimate]:
    """Smallest size of each effect that would be found, at the place that shows it best.

    With nuisances projected out, by derivatives at the model without effects, its gain must reach
    `decide.GAIN_NATS`, and its RMS `comparison.size` in the segment and signal that show it best,
    or its value `decide.least_value`.
    """
    layout, cells = comparison.layout, comparison.cells
    around, slopes = known.quadratic(()), known.library(())
    sizes: dict[str, tuple[float, int]] = {}
    for index, candidate in enumerate(layout.candidates):
        if candidate.is_nuisance or candidate.effect in untestable:
            continue
        column = int(layout.of_candidate(index)[0])
        for block in range(len(slopes)):
            signature = _signature(around.information(block), slopes[block], column, layout)
            power = cells.power(signature)
            gain = float(np.sum(power * cells.counts))
            if gain <= 0.0:
                continue
            size = max(
                np.sqrt(2.0 * decide.GAIN_NATS * wide / gain),
                min(comparison.size / np.sqrt(power.max()), decide.least_value(candidate)),
            )
            if candidate.effect not in sizes or size < sizes[candidate.effect][0]:
                sizes[candidate.effect] = (float(size), index)
    return {
        effect: _physical_size(problem, comparison, around, *found)
        for effect, found in sizes.items()
    }


def _physical_size(
    problem: Problem, comparison: ModelComparison, around: QuadraticCost, size: float, index: int
) -> ParameterEstimate:
    columns = comparison.layout.of_candidate(index)
    values = around.point[0, columns].copy()
    values[0] = min(size, float(comparison.layout.high[columns[0]]))
    return next(iter(problem.candidates[index].parameters(values).values()))


def _signature(information: Floats, slopes: Floats, column: int, layout: UnknownsLayout) -> Floats:
    """Change of the residuals of a block by an unknown, shape (m,), without what nuisances make up
    for in a fit.
    """
    nuisances = layout.nuisances
    inverse = np.linalg.pinv(information[np.ix_(nuisances, nuisances)], rcond=1e-10, hermitian=True)
    return np.asarray(slopes[column] - inverse @ information[nuisances, column] @ slopes[nuisances])


def _baselines(
    comparison: ModelComparison, around: QuadraticCost, scored: Sequence[ScoredFit]
) -> SimplerMethods:
    """Effects that simpler methods name: all above a threshold in one fit; the best single one."""
    layout = comparison.layout
    named = set()
    for block in range(len(around.cost)):
        value = around.point[block] + around.solve(block, np.ones(len(around.columns), dtype=bool))
        error = np.sqrt(
            np.diag(np.linalg.pinv(around.information(block), rcond=1e-12, hermitian=True))
        )
        for index, candidate in enumerate(layout.candidates):
            columns = layout.of_candidate(index)
            columns = columns[~layout.is_shape[columns]]
            if not candidate.is_nuisance and np.any(np.abs(value[columns]) > 3.0 * error[columns]):
                named.add(candidate.effect)
    seen = comparison.split.is_fit
    singles = [each.fit for each in scored if len(each.fit.model) == 1]
    lowest = min(
        singles, key=lambda each: float(np.sum(each.residuals[:, seen] ** 2)), default=None
    )
    return SimplerMethods(
        threshold=tuple(sorted(named)), lowest_training_error=lowest.model if lowest else ()
    )
