"""A row of the benchmark's table: what a predictor scores, and how sure that is."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.depth_to_heights.split import Truth
from saltus.arrays import Floats
from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.evaluation.held_out import HeldOutPrediction
from saltus.heightmap.evaluation.scores import FIGURES, mean_of, score_totals
from saltus.loop.loop import STAND_STEPS

LEAST_HALF_WIDTH_M = 1e-3
"""Narrower intervals count as this wide: to a millimetre the truth is told apart, and without a
bound the likelihood of flat ground would have none."""
RESAMPLES = (
    1000  # of the runs: of a normal law the ends of an interval are then right to 2 % of its width
)
_SEED = 0  # of the resamples: two people get the same interval


@dataclass(frozen=True, kw_only=True)
class ScoreRow:
    """Scores of one predictor.

    Figures are those of `saltus.heightmap.evaluation.scores.HeightScore`, NaN for none.
    """

    predictor: str
    figures: dict[str, float]
    interval90: dict[str, tuple[float, float]]
    """Ends of the 90 % interval of each figure, over choices of as many runs of each terrain;
    NaN where in one of them nothing is judged."""
    by_terrain: dict[str, dict[str, float]]

    @property
    def table(self) -> dict[str, Any]:
        """As plain values."""
        return {**self.figures, "interval90": self.interval90, "by_terrain": self.by_terrain}


def row(
    predictor: str, truths: Sequence[Truth], predictions: Sequence[HeldOutPrediction]
) -> ScoreRow:
    """Scores one predictor; steps count from the first that is not standing."""
    judged = np.array([_judged(*pair) for pair in zip(truths, predictions, strict=True)])
    kinds = np.array([truth.terrain for truth in truths])
    groups = {str(kind): np.flatnonzero(kinds == kind) for kind in dict.fromkeys(kinds)}
    low, high = np.percentile(_resampled(judged, list(groups.values())), (5.0, 95.0), axis=0)
    return ScoreRow(
        predictor=predictor,
        figures=_named(mean_of(judged.sum(axis=0))),
        interval90={
            name: (float(a), float(b)) for name, a, b in zip(FIGURES, low, high, strict=True)
        },
        by_terrain={
            kind: _named(mean_of(judged[runs].sum(axis=0))) for kind, runs in groups.items()
        },
    )


def _judged(truth: Truth, said: HeldOutPrediction) -> Floats:
    """Totals of the steps that count in one run."""
    counted = slice(STAND_STEPS, None)
    width = np.maximum(said.half_width_90[counted], LEAST_HALF_WIDTH_M)
    prediction = HeldOutPrediction(height=said.height[counted], half_width_90=width)
    return score_totals(
        HEIGHTMAP_X, truth.height[counted].astype(np.float64), truth.view[counted], prediction
    )


def _resampled(judged: Floats, groups: Sequence[Any]) -> Floats:
    """Figures of choices of the runs, with as many of each terrain as there are,
    shape (choices, figures).
    """
    rng = np.random.default_rng(_SEED)
    chosen = np.concatenate([rng.choice(runs, (RESAMPLES, len(runs))) for runs in groups], axis=1)
    return mean_of(judged[chosen].sum(axis=1))


def _named(means: Floats) -> dict[str, float]:
    return dict(zip(FIGURES, means.tolist(), strict=True))
