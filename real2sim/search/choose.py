"""The choice among fitted models: the smallest one that no larger one beats."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from saltus.real2sim.search.decide import (
    BESIDE,
    CERTAIN,
    CLEAR_SHARE,
    LITTLE_SHARE,
    REMAINDER_SHARE,
    SET_SIZE,
    TOGETHER,
    WHOLE_SHARE,
    ModelComparison,
    ScoredFit,
    counts_by_value,
    dispersion_of,
    in_resolutions,
    largest_rms,
)
from saltus.real2sim.search.model_fit import ModelFit
from saltus.real2sim.search.quadratic import score_dispersion
from saltus.real2sim.search.residual_split import CHANCE
from saltus.real2sim.search.unknowns_layout import ModelEffects


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelChoice:
    """All fitted models with their scores, and which of them is chosen."""

    scored: tuple[ScoredFit, ...]
    dispersion: float
    """Dispersion of the best of them, whose residuals are closest to noise."""
    null: ScoredFit
    """The model without effects."""
    chosen: ScoredFit


def choose_among(comparison: ModelComparison, fits: Iterable[ModelFit]) -> ModelChoice:
    """Scores fitted models and chooses one."""
    scored = tuple(comparison.score(each) for each in fits)
    best = min(scored, key=lambda each: each.total).fit
    dispersion = score_dispersion(
        best.quadratic(comparison.layout, comparison.split), np.ones(len(best.columns), dtype=bool)
    )
    return ModelChoice(
        scored=scored,
        dispersion=dispersion,
        null=next(each for each in scored if not each.fit.model),
        chosen=choose(comparison, scored, dispersion),
    )


def choose(
    comparison: ModelComparison, scored: Sequence[ScoredFit], dispersion: float
) -> ScoredFit:
    """The smallest model that no larger one beats by more than chance and misfit.

    Starts with the model without effects. A larger model replaces the current one if it leads,
    closes enough of what the current one leaves, and has no idle effect. Among models of one size
    the held-out cost decides. Of two or more new effects each must also stand beside the others.
    """
    held = next(each for each in scored if not each.fit.model)
    for size in range(1, max(len(each.fit.model) for each in scored) + 1):
        rivals = sorted(
            (each for each in scored if len(each.fit.model) == size), key=lambda each: each.total
        )
        for rival in rivals[: SET_SIZE if size > 1 else 1]:
            if not _replaces(comparison, scored, held, rival, dispersion):
                continue
            needed = _needed(comparison, scored, held, rival, dispersion)
            if needed is not None:
                held = needed
                break
    return held


def _needed(
    comparison: ModelComparison,
    scored: Sequence[ScoredFit],
    held: ScoredFit,
    rival: ScoredFit,
    dispersion: float,
) -> ScoredFit | None:
    """The rival, or a part of it that replaces the held model as well and that the rival does not
    replace; None where no such part is as good as the held one.
    """
    parts = [each for each in scored if is_part(each.fit.model, rival.fit.model)]
    enough = [p for p in parts if not _replaces(comparison, scored, p, rival, dispersion)]
    if not enough:
        return rival
    for part in sorted(enough, key=lambda each: each.total):
        if _replaces(comparison, scored, held, part, dispersion):
            return _needed(comparison, scored, held, part, dispersion)
    return None


def is_part(model: ModelEffects, larger: ModelEffects) -> bool:
    """True where a model has all effects of a larger one but one, and has any."""
    return 0 < len(model) == len(larger) - 1 and set(model) < set(larger)


def _replaces(
    comparison: ModelComparison,
    scored: Sequence[ScoredFit],
    held: ScoredFit,
    rival: ScoredFit,
    dispersion: float,
) -> bool:
    if not comparison.lead(held, rival, dispersion_of(comparison, held, rival, dispersion)):
        return False
    is_clear, further = False, 0.0
    if held.fit.model:
        null = next(each for each in scored if not each.fit.model)
        more = comparison.closed(null, null, rival) - comparison.closed(null, null, held)
        further = comparison.closed(null, held, rival)
        is_clear = further >= CLEAR_SHARE
        if further < REMAINDER_SHARE or (
            more < comparison.further_share and not _is_whole(comparison, rival, further)
        ):
            return False
        if more < _chance(comparison, held.fit.model) and not is_clear:
            return False
        if any(
            in_resolutions(comparison.layout, rival.fit.unknowns, e) <= CERTAIN
            for e in rival.fit.model
        ):
            return False
    fits = {each.fit.model: each.fit for each in scored}
    shown = {
        effect: largest_rms(comparison, fits, rival.fit, effect) / comparison.size
        for effect in rival.fit.model
    }
    smallest, sizes = min(shown, key=shown.__getitem__), sorted(shown.values())
    by_value = counts_by_value(comparison.layout, rival.fit.unknowns, smallest)
    if len(sizes) == 1:
        return sizes[0] >= 1.0 or by_value
    is_told = (
        is_clear
        and by_value
        and _is_whole(comparison, rival, further)
        and _takes_most(comparison, held, rival)
    )
    least = 0.0 if is_told else BESIDE if is_clear else TOGETHER
    return sizes[0] >= least and sizes[1] >= TOGETHER


def _is_whole(comparison: ModelComparison, rival: ScoredFit, further: float) -> bool:
    """True where a further effect explains all that was left but the simulators' disagreement."""
    return further >= WHOLE_SHARE and not comparison.is_gap(rival.fit.residuals)


def _takes_most(comparison: ModelComparison, held: ScoredFit, rival: ScoredFit) -> bool:
    """True where all cells together show more than chance after `held`, and the held-out gain is
    `LITTLE_SHARE` of it; noise may hide its standard deviation.
    """
    residuals, cells = held.fit.residuals, comparison.cells
    count = len(residuals) * len(cells.rows)
    shown = cells.together(residuals)
    least = LITTLE_SHARE * (shown + np.sqrt(2.0 * count))
    return shown > CHANCE * np.sqrt(count) and 2.0 * comparison.gain(held, rival) > least


def _chance(comparison: ModelComparison, model: ModelEffects) -> float:
    """Share of the gap that a model may leave to chance,
    e.g. how a drive hunts between two steps.
    """
    return 1.0 - min(c.closable_share for c in comparison.layout.candidates if c.effect in model)
