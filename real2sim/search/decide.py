"""Which of the fitted models the data support: thresholds and the rules that use them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.search import bootstrap
from saltus.real2sim.search.cells import Cells
from saltus.real2sim.search.findings import Confusion
from saltus.real2sim.search.fit import Fit
from saltus.real2sim.search.layout import Layout, Model
from saltus.real2sim.search.split import TEST, Split

GAIN_NATS = 10.0
"""Least held-out gain of an effect [nats], after division by the dispersion. Under no effect twice the gain of k
unknowns is about chi-squared with k degrees of freedom, less what is lost by fitting on other data; with 40 effects of
12 unknowns tried, 10 nats keep the false-alarm rate of the whole search below 1 %."""
SPREAD = 3.0
"""A gain, or the lead of a model over its rival, counts from this many standard deviations."""
SIZE_RMS = 0.45
"""Least RMS of an effect in the segment and signal that show it best [sigma of one sample]. Two correct simulations of
one robot were seen to differ by 0.15 to 0.4 through their integrators and time steps; statistics alone would call that
a finding."""
TOGETHER = 2.0
"""How much larger effects must be that are named together: weak ones imitate in pairs what no library holds."""
BESIDE = 1.2
"""It is enough for one of them to be so much larger, beside others that are `TOGETHER` times as large, when it closes
`CLEAR_SHARE` of what the model without it leaves: weak ones that imitate need each other."""
CLEAR_SHARE = 0.75
REMAINDER_SHARE = 0.4
"""A further effect must close at least this share of what the model without it leaves. A false one picks up a part of
a misfit, a true one leaves noise."""
FURTHER_SHARE = 0.01
"""And at least this share of the whole gap: one further effect a tenth as strong as the others. Less is within what
two correct simulations of those others differ by; see `WHOLE_SHARE`."""
WHOLE_SHARE = 0.9
"""Less than that share of the whole gap is enough for a further effect that takes this share of what the model without
it leaves, down to what simulations differ by."""
CLOSED_SHARE = (0.75, 0.98, 0.99)
"""A model of one, two, three effects that closes less of the gap than this does not explain it: the more effects, the
easier is it to imitate another. A flexible gear, which no library holds, is a lag and a lost gain to 0.97."""
PROMISING_SHARE = 0.8
"""A pair that closes less lacks more than one further effect: larger models are not tried."""
REMAINDER_RMS = 0.5
"""RMS of unexplained structure [sigma] from which a gap is one, where no effect explains it."""
SET_SIZE = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class ScoredFit:
    """A fit and what it is worth.

    Attributes:
        fit: The fit.
        held_out: Cost of each chunk by a fit that has not seen its fold, shape (blocks, chunks).
        structure: Mean square of what is left above noise, shape (blocks, cells).
    """

    fit: Fit
    held_out: Floats
    structure: Floats

    @property
    def total(self) -> float:
        """Held-out cost of all that is not test."""
        return float(self.held_out.sum())


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelComparison:
    """What every comparison needs."""

    layout: Layout
    split: Split
    cells: Cells
    rng: np.random.Generator
    size: float
    """Least RMS of an effect [sigma of a residual]."""
    further_share: float = FURTHER_SHARE
    """Share of the whole gap that a further effect must close at least."""

    def score(self, fit: Fit) -> ScoredFit:
        """Held-out cost and remainder of a fit."""
        quadratic = fit.quadratic(self.layout, self.split)
        held_out = quadratic.held_out_cost(np.ones(len(fit.columns), dtype=bool))
        held_out[:, self.split.fold == TEST] = 0.0
        return ScoredFit(fit=fit, held_out=held_out, structure=self.cells.structure(fit.residuals))

    def gain(self, before: ScoredFit, after: ScoredFit) -> float:
        """Held-out gain of one model over another [nats]."""
        return 0.5 * (before.total - after.total)

    def lead(self, before: ScoredFit, after: ScoredFit, dispersion: float) -> bool:
        """Whether a gain is more than chance."""
        gains = bootstrap.held_out_gains(before.held_out, after.held_out, self.split)
        return self.gain(before, after) > max(GAIN_NATS * dispersion, SPREAD * bootstrap.downside(gains))

    def closed(self, null: ScoredFit, before: ScoredFit, after: ScoredFit) -> float:
        """Share of the structure left by `before` that `after` removes, in the cells where any shows."""
        shows = self.cells.shows(np.maximum(null.structure, before.structure), self.size)
        return self.cells.share_gone(before.structure, after.structure, shows)


def choose(comparison: ModelComparison, scored: Sequence[ScoredFit], dispersion: float) -> ScoredFit:
    """The model that the data support: the smallest that no larger one beats by more than chance and misfit.

    Starts from the model without effects; a larger model replaces the one held when it leads it, closes enough of what
    that one leaves, and no effect in it is idle. Among those of one size the best held-out cost counts.
    """
    null = next(each for each in scored if not each.fit.model)
    held = null
    for size in range(1, max(len(each.fit.model) for each in scored) + 1):
        rivals = sorted((each for each in scored if len(each.fit.model) == size), key=lambda each: each.total)
        for rival in rivals[: SET_SIZE if size > 1 else 1]:
            if _replaces(comparison, scored, held, rival, dispersion):
                held = rival
                break
    return held


def _replaces(
    comparison: ModelComparison, scored: Sequence[ScoredFit], held: ScoredFit, rival: ScoredFit, dispersion: float
) -> bool:
    if not comparison.lead(held, rival, dispersion):
        return False
    is_clear = False
    if held.fit.model:
        null = next(each for each in scored if not each.fit.model)
        more = comparison.closed(null, null, rival) - comparison.closed(null, null, held)
        further = comparison.closed(null, held, rival)
        is_clear = further >= CLEAR_SHARE
        if further < REMAINDER_SHARE or (more < comparison.further_share and not _is_whole(comparison, rival, further)):
            return False
    fits = {each.fit.model: each.fit for each in scored}
    sizes = sorted(largest_rms(comparison, fits, rival.fit, effect) / comparison.size for effect in rival.fit.model)
    if len(sizes) == 1:
        return sizes[0] >= 1.0
    return sizes[0] >= (BESIDE if is_clear else TOGETHER) and sizes[1] >= TOGETHER


def _is_whole(comparison: ModelComparison, rival: ScoredFit, further: float) -> bool:
    """Whether a further effect explains all that was left: what two simulations differ by, no effect takes wholly."""
    return further >= WHOLE_SHARE and comparison.cells.largest_rms(rival.structure) <= comparison.size


def may_gain(comparison: ModelComparison, null: Fit, fit: Fit) -> bool:
    """Whether a model with one more effect than this fit could be chosen: it leaves enough, and not far too much."""
    before, after = comparison.cells.structure(null.residuals), comparison.cells.structure(fit.residuals)
    if comparison.cells.largest_rms(after) <= comparison.size:
        return False
    left = 1.0 - comparison.cells.share_gone(before, after, comparison.cells.shows(before, comparison.size))
    is_left = left >= comparison.further_share or comparison.cells.largest_rms(after) > TOGETHER * comparison.size
    return is_left and (len(fit.model) < 2 or left <= 1.0 - PROMISING_SHARE)


def explained_share(comparison: ModelComparison, model: Model) -> float:
    """Share of the gap that a model must close to explain it."""
    closable_share = min(c.closable_share for c in comparison.layout.candidates if c.effect in model)
    return CLOSED_SHARE[len(model) - 1] * closable_share


def largest_rms(comparison: ModelComparison, fits: dict[Model, Fit], fit: Fit, effect: str) -> float:
    """RMS of what an effect adds to a model, in the cell that shows it best [sigma].

    Against the fit of the model without it, where there is one: what the other effects cannot take over.
    """
    rest = tuple(name for name in fit.model if name != effect)
    if rest in fits:
        trace = fit.residuals - fits[rest].residuals
    else:
        columns = comparison.layout.of_effects([effect])
        own = np.flatnonzero(np.isin(fit.columns, columns[~comparison.layout.is_shape[columns]]))
        trace = np.einsum("bk,bkm->bm", fit.unknowns[:, fit.columns[own]], fit.jacobian[:, own])
    return float(np.sqrt(comparison.cells.power(trace).max()))


def ambiguities(
    comparison: ModelComparison,
    chosen: ScoredFit,
    scored: Sequence[ScoredFit],
    confusion: Confusion,
    dispersion: float,
    collinear: float,
) -> dict[str, list[str]]:
    """For each effect of the chosen model, the others that these data do not tell from it, likeliest first.

    Others are those of models of the same size that the chosen one does not lead beyond chance and beyond what two
    simulations differ by, and those collinear with it, if a model with them instead closes a share of the gap that
    would count as an explanation.
    """
    by_model = {each.fit.model: each for each in scored}
    null = by_model[()]
    found: dict[str, list[str]] = {effect: [] for effect in chosen.fit.model}
    for rival in sorted(scored, key=lambda each: each.total):
        gone = set(chosen.fit.model) - set(rival.fit.model)
        new = set(rival.fit.model) - set(chosen.fit.model)
        if len(gone) != 1 or len(new) != 1 or comparison.closed(null, null, rival) < CLOSED_SHARE[0]:
            continue
        effect, other = gone.pop(), new.pop()
        is_tied = not comparison.lead(rival, chosen, dispersion)
        # derivatives tell of the limit of small effects; at their sizes a delay and a filter may well differ
        imitates = comparison.closed(null, null, rival) >= collinear**2 * comparison.closed(null, null, chosen)
        if is_tied or (imitates and confusion.between(effect, other) >= collinear):
            found[effect].append(other)
    for effect in chosen.fit.model:
        for other in chosen.fit.model:
            if other != effect and confusion.between(effect, other) >= collinear:
                found[effect].append(other)
    return {effect: others[: SET_SIZE - 1] for effect, others in found.items()}
