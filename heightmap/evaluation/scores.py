"""Scores of predictors in held-out runs: one table for each,
for all runs, by terrain, and by level.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.heightmap.evaluation.distance_travelled import way_figures
from saltus.heightmap.evaluation.height_edges import edge_errors
from saltus.heightmap.evaluation.held_out import NETWORK, HeldOutPrediction, HeldOutRun
from saltus.heightmap.evaluation.visibility import UNSEEN, VIEWS
from saltus.heightmap.service.quantiles import negative_log_likelihood


@dataclass(frozen=True, kw_only=True)
class HeightScore:
    """Errors of the heights of one predictor [m]; NaN where there is nothing to judge."""

    mae_m: float
    """Over the points that the camera ever saw, see `saltus.heightmap.evaluation.visibility`."""
    mae_visible_m: float
    """Seen in the last 0.2 s."""
    mae_remembered_m: float
    """Seen earlier in the run."""
    mae_unseen_m: float
    """Never seen."""
    edge_error_m: float
    """Error of the position of jumps of more than 3 cm, where they were seen and are predicted."""
    edges_found: float
    """Share of them that is predicted."""
    coverage90: float
    """Share of all points, unseen ones included, that lie in their 90 % interval."""
    coverage90_seen: float
    """Share of the points that the camera ever saw that lie in their 90 % interval."""
    nll: float
    """Mean negative log-likelihood of all points [nats, heights in metres], for a Laplace law with
    that interval."""
    points: int


FIGURES = tuple(field.name for field in fields(HeightScore) if field.name != "points")
"""Names of the figures of a `HeightScore` that are means."""


def score(runs: Sequence[HeldOutRun], predictor: str) -> HeightScore:
    """One predictor in some runs."""
    means = mean_of(np.sum([_totals_of(run, predictor) for run in runs], axis=0))
    points = sum(run.true_height.size for run in runs)
    return HeightScore(**dict(zip(FIGURES, means.tolist(), strict=True)), points=points)


def _totals_of(run: HeldOutRun, predictor: str) -> Floats:
    """The `score_totals` of a run, which is in several tables, once."""
    known = _TOTALS.setdefault(run, {})
    if predictor not in known:
        said = run.predictions[predictor]
        known[predictor] = score_totals(run.x, run.true_height, run.view, said)
    return known[predictor]


_TOTALS: WeakKeyDictionary[HeldOutRun, dict[str, Floats]] = WeakKeyDictionary()


def score_totals(
    x: Floats, true_height: Floats, view: NDArray[np.int8], said: HeldOutPrediction
) -> Floats:
    """Sum and number of what each of `FIGURES` is the mean of,
    shape (2, figures): those of runs add up.

    Args:
        x: Place of each point ahead [m], shape (30,).
        true_height: At the steps of a run [m], shape (n, 30).
        view: See `saltus.heightmap.evaluation.visibility`, shape (n, 30).
        said: What was predicted there.
    """
    error = np.abs(said.height - true_height)
    covered, seen = error <= said.half_width_90, view != UNSEEN
    edges = edge_errors(said.height, np.where(seen, true_height, np.nan), x).error
    found = np.isfinite(edges)
    judged: dict[str, Floats | NDArray[np.bool_]] = {
        "mae_m": error[seen],
        **{f"mae_{name}_m": error[view == number] for number, name in enumerate(VIEWS)},
        "edge_error_m": np.abs(edges[found]),
        "edges_found": found,
        "coverage90": covered,
        "coverage90_seen": covered[seen],
        "nll": negative_log_likelihood(error, said.half_width_90),
    }
    return np.array([(judged[name].sum(), judged[name].size) for name in FIGURES], np.float64).T


def mean_of(totals: Floats) -> Floats:
    """Each of `FIGURES` by the `score_totals` of some runs, shape (..., 2, figures);
    NaN where nothing is judged.
    """
    total, count = totals[..., 0, :], totals[..., 1, :]
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0.0)


def score_table(runs: Sequence[HeldOutRun]) -> dict[str, Any]:
    """The network's score on all runs, by terrain and by level, and those of the baselines.

    Plain values, each with how far its robots went
    (`saltus.heightmap.evaluation.distance_travelled`).
    """
    names = [name for name in runs[0].predictions if name != NETWORK]
    return {
        "runs": len(runs),
        **_table(runs, NETWORK),
        "by_level": _grouped(runs, NETWORK, lambda run: run.level),
        "baselines": {name: _table(runs, name) for name in names},
    }


def _table(runs: Sequence[HeldOutRun], predictor: str) -> dict[str, Any]:
    by_terrain = _grouped(runs, predictor, lambda run: run.terrain)
    return {**_figures(runs, predictor), "by_terrain": by_terrain}


def _grouped(
    runs: Sequence[HeldOutRun], predictor: str, group: Callable[[HeldOutRun], str]
) -> dict[str, Any]:
    names = sorted({group(run) for run in runs})
    return {
        name: _figures([run for run in runs if group(run) == name], predictor) for name in names
    }


def _figures(runs: Sequence[HeldOutRun], predictor: str) -> dict[str, Any]:
    return {**asdict(score(runs, predictor)), **way_figures([run.way for run in runs])}
