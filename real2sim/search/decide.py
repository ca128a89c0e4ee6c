"""Selection among the fitted models: thresholds and the rules that use them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import Candidate
from saltus.real2sim.search.findings import EffectConfusion
from saltus.real2sim.search.model_fit import ModelFit
from saltus.real2sim.search.quadratic import gains_downside, held_out_gains
from saltus.real2sim.search.quadratic import score_dispersion as quadratic_dispersion
from saltus.real2sim.search.residual_split import TEST, ResidualCells, ResidualSplit
from saltus.real2sim.search.unknowns_layout import ModelEffects, UnknownsLayout

GAIN_NATS = 10.0
"""Smallest held-out gain of an effect [nats], after division by the dispersion. Without the effect,
twice the gain of k unknowns follows about a chi-squared distribution with k degrees of freedom,
minus the loss of fitting on other data. With 40 effects of 12 unknowns, 10 nats keep the
false-alarm rate of the whole search below 1 %."""
SPREAD = 3.0
"""Smallest gain, or lead over a rival, in standard deviations."""
SIZE_RMS = 0.45
"""Smallest RMS of an effect in the segment and signal that show it best [sigma of one sample]. Two
correct simulations of one robot differed by 0.15 to 0.4 because of their integrators and time
steps; statistics alone would call that an effect."""
CLEARLY = 4.0
"""Resolutions of a candidate from which its effect counts alone, however few sigma it shows: noise
hides what simulators differ by as it hides the effect. In 50 joint logs without any effect (seed
52112801 of the benchmark of hidden effects) no effect that leads has more than 2.75, an encoder
bias 1.82, and none shows with more than 0.22 sigma."""
TOGETHER = 2.0
"""Effects that are named together must be larger by this factor: pairs of weak effects imitate what
no library holds."""
BESIDE = 1.1
"""This factor is enough for one of them if the others reach `TOGETHER` and it closes `CLEAR_SHARE`
of what the model without it leaves: weak effects that imitate something need each other."""
CLEAR_SHARE = 0.7
LITTLE_SHARE = 0.6
"""Smallest share of what all cells together show that an effect must close which no cell shows: an
encoder bias alone closed 0.79 (e262bb5614bf of the benchmark of hidden effects, seed 1826395078),
the effects nearest to it 0.46 at most."""
REMAINDER_SHARE = 0.4
"""Smallest share that a further effect must close of what the model without it leaves. A false
effect picks up a part of a misfit, a true one leaves noise."""
FURTHER_SHARE = 0.01
"""Smallest share of the whole gap that a further effect must close: a tenth of the strength of the
others. Correct simulations of the others differ by as much; see `WHOLE_SHARE`."""
WHOLE_SHARE = 0.85
"""A further effect that closes this share of what the model without it leaves, down to the
disagreement of simulators, may close a smaller share of the whole gap."""
CLOSED_SHARE = (0.75, 0.98, 0.99)
"""Smallest share of the gap that models of one, two and three effects must close: more effects
imitate others more easily. A lag and a lower gain imitate a flexible gear, which no library holds,
to 0.97."""
CLOSED_WITHIN = (0.75, 0.96, 0.99)
"""As `CLOSED_SHARE`, where no gap is left: what remains is no more than two correct simulations
differ by."""
CERTAIN = 1.645
"""Standard errors that half of a 90 % interval has."""
PROMISING_SHARE = 0.8
"""If a pair closes less, it lacks more than one effect, and larger models are not tried."""
REMAINDER_RMS = 0.5
"""RMS of unexplained structure [sigma] from which it is called a gap."""
SET_SIZE = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class ScoredFit:
    """A fitted model of effects with its cost on held-out segments.

    Attributes:
        fit: The fit.
        held_out: Cost of each chunk in a fit without its fold, shape (blocks, chunks).
        structure: Mean square beyond noise, shape (blocks, cells).
    """

    fit: ModelFit
    held_out: Floats
    structure: Floats

    @property
    def total(self) -> float:
        """Held-out cost of everything outside the test."""
        return float(self.held_out.sum())


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelComparison:
    """Split, cells and thresholds with which models of effects are compared."""

    layout: UnknownsLayout
    split: ResidualSplit
    cells: ResidualCells
    rng: np.random.Generator
    size: float
    """Smallest RMS of an effect [sigma of a residual]."""
    further_share: float = FURTHER_SHARE
    """Smallest share of the whole gap that a further effect must close."""

    def score(self, fit: ModelFit) -> ScoredFit:
        """The fit with its held-out cost and its structure."""
        quadratic = fit.quadratic(self.layout, self.split)
        held_out = quadratic.held_out_cost(np.ones(len(fit.columns), dtype=bool))
        held_out[:, self.split.fold == TEST] = 0.0
        return ScoredFit(fit=fit, held_out=held_out, structure=self.cells.structure(fit.residuals))

    def cost(self, residuals: Floats) -> float:
        """Sum of squares of the rows that fits see."""
        return float(np.sum(residuals[:, self.split.is_fit] ** 2))

    def is_gap(self, residuals: Floats) -> bool:
        """True where residuals, shape (blocks, m), show a gap in any segment and signal.

        A gap is more structure than two correct simulators differ by.
        """
        return self.cells.largest_rms(self.cells.structure(residuals)) > self.size

    def gain(self, before: ScoredFit, after: ScoredFit) -> float:
        """Held-out gain of one model over another [nats]."""
        return 0.5 * (before.total - after.total)

    def lead(self, before: ScoredFit, after: ScoredFit, dispersion: float) -> bool:
        """True where the held-out gain of `after` over `before` is larger than chance."""
        gains = held_out_gains(before.held_out, after.held_out, self.split)
        return self.gain(before, after) > max(
            GAIN_NATS * dispersion, SPREAD * gains_downside(gains)
        )

    def closed(self, null: ScoredFit, before: ScoredFit, after: ScoredFit) -> float:
        """Share of the structure after `before` that `after` removes,
        in the cells that show any.
        """
        shows = self.cells.shows(np.maximum(null.structure, before.structure), self.size)
        return self.cells.share_gone(before.structure, after.structure, shows)


def explains(comparison: ModelComparison, null: ModelFit, fit: ModelFit) -> bool:
    """True where a model closes enough of the gap to stand in place of another."""
    before, after = (
        comparison.cells.structure(null.residuals),
        comparison.cells.structure(fit.residuals),
    )
    shows = comparison.cells.shows(before, comparison.size)
    return comparison.cells.share_gone(before, after, shows) >= CLOSED_SHARE[0]


def dispersion_of(
    comparison: ModelComparison, held: ScoredFit, rival: ScoredFit, dispersion: float
) -> float:
    """Dispersion of what a rival gains: its own
    where its new effects change residuals that no other unknown does.

    How many images were lost is no less certain because depths scatter in a way of their own.
    """
    fit = rival.fit
    own = comparison.layout.of_effects(set(fit.model) - set(held.fit.model))
    is_new = np.isin(fit.columns, own)
    changed = np.any(fit.jacobian != 0.0, axis=0)  # (columns, m)
    if not is_new.any() or np.any(changed[is_new].any(axis=0) & changed[~is_new].any(axis=0)):
        return dispersion
    return quadratic_dispersion(fit.quadratic(comparison.layout, comparison.split), is_new)


def counts_by_value(layout: UnknownsLayout, unknowns: Floats, effect: str) -> bool:
    """True where an effect counts however few sigma it shows; unknowns of shape (blocks, unknowns).

    False where it is not known what two correct simulations differ by.
    """
    return CLEARLY <= in_resolutions(layout, unknowns, effect) < np.inf


def in_resolutions(layout: UnknownsLayout, unknowns: Floats, effect: str) -> float:
    """Size of an effect at the place where it is largest, in parts of what two correct simulations
    differ by; infinite where that is not known.

    A small one may still fit, e.g. play of no width, as play is replayed in finer steps.
    """
    own = [i for i, c in enumerate(layout.candidates) if c.effect == effect]
    sizes = [float(np.abs(unknowns[:, layout.of_candidate(i)[0]]).max()) for i in own]
    return max(
        size / layout.candidates[i].resolution if layout.candidates[i].resolution else np.inf
        for i, size in zip(own, sizes, strict=True)
    )


def least_value(candidate: Candidate) -> float:
    """Value from which an effect counts alone, however few sigma it shows."""
    return CLEARLY * candidate.resolution if candidate.resolution else np.inf


def may_gain(comparison: ModelComparison, null: ModelFit, fit: ModelFit) -> bool:
    """True where a model with one more effect could be chosen.

    The fit then leaves enough of the gap, and not far too much.
    """
    before, after = (
        comparison.cells.structure(null.residuals),
        comparison.cells.structure(fit.residuals),
    )
    if comparison.cells.largest_rms(after) <= comparison.size:
        return False
    left = 1.0 - comparison.cells.share_gone(
        before, after, comparison.cells.shows(before, comparison.size)
    )
    is_left = (
        left >= comparison.further_share
        or comparison.cells.largest_rms(after) > TOGETHER * comparison.size
    )
    return is_left and (len(fit.model) < 2 or left <= 1.0 - PROMISING_SHARE)


def explained_share(
    comparison: ModelComparison,
    model: ModelEffects,
    *,
    leaves_gap: bool = True,
    leaves_more: bool = True,
) -> float:
    """Share of the gap that a model must close to be an explanation; less where it leaves none.

    Also less where it leaves no more than correct simulations of its own problem differ by, which
    may be less than a gap: rays are exact.
    """
    candidates = [c for c in comparison.layout.candidates if c.effect in model]
    share = (CLOSED_SHARE if leaves_gap else CLOSED_WITHIN)[len(model) - 1]
    if len(model) == 1 and leaves_more:
        share = max(share, *(c.least_closed for c in candidates))
    return share * min(c.closable_share for c in candidates)


def leaves_chance(comparison: ModelComparison, model: ModelEffects) -> bool:
    """True where one of the effects leaves what differs from repeat to repeat."""
    return any(c.leaves_chance for c in comparison.layout.candidates if c.effect in model)


def shows_little(
    comparison: ModelComparison, fits: dict[ModelEffects, ModelFit], fit: ModelFit
) -> bool:
    """True where no cell shows the one effect of a model: its value alone tells it."""
    return len(fit.model) == 1 and largest_rms(comparison, fits, fit, *fit.model) < comparison.size


def largest_rms(
    comparison: ModelComparison, fits: dict[ModelEffects, ModelFit], fit: ModelFit, effect: str
) -> float:
    """RMS of what an effect adds to a model, in the cell that shows it best [sigma].

    Relative to the fit of the model without the effect, if there is one: what the other effects
    cannot replace.
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
    confusion: EffectConfusion,
    dispersion: float,
    collinear: float,
) -> dict[str, list[str]]:
    """For each effect of the chosen model, the other effects that may stand in its place,
    likeliest first.

    These are effects of models of the same size over which the chosen model has no lead beyond
    chance and the disagreement of simulators, and effects collinear with the chosen one, if a model
    with them closes enough of the gap, and of what the other effects of the chosen model leave.
    """
    by_model = {each.fit.model: each for each in scored}
    null = by_model[()]
    by_chosen = min(1.0, comparison.closed(null, null, chosen))
    found: dict[str, list[str]] = {effect: [] for effect in chosen.fit.model}
    for rival in sorted(scored, key=lambda each: each.total):
        gone = set(chosen.fit.model) - set(rival.fit.model)
        new = set(rival.fit.model) - set(chosen.fit.model)
        if (
            len(gone) != 1
            or len(new) != 1
            or comparison.closed(null, null, rival) < CLOSED_SHARE[0] * by_chosen
        ):
            continue
        effect, other = gone.pop(), new.pop()
        beside = by_model.get(tuple(name for name in chosen.fit.model if name != effect), null)
        if comparison.closed(null, beside, rival) < REMAINDER_SHARE:
            continue  # it explains nothing of what the others leave
        own = dispersion_of(comparison, rival, chosen, dispersion)
        is_tied = not comparison.lead(rival, chosen, own)
        # Cosines come from derivatives, in the limit of small effects; at their real sizes a delay
        # and a filter may differ.
        imitates = comparison.closed(null, null, rival) >= collinear**2 * comparison.closed(
            null, null, chosen
        )
        if is_tied or (imitates and confusion.between(effect, other) >= collinear):
            found[effect].append(other)
    for effect in chosen.fit.model:
        for other in chosen.fit.model:
            if other != effect and confusion.between(effect, other) >= collinear:
                found[effect].append(other)
    return {effect: others[: SET_SIZE - 1] for effect, others in found.items()}
