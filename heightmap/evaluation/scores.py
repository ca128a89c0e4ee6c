"""What predictors scored in held-out runs: one table for each, for all runs, by terrain, and by level."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.heightmap.evaluation.edges import edge_errors
from saltus.heightmap.evaluation.held_out import NETWORK, HeldOutRun
from saltus.heightmap.evaluation.visibility import UNSEEN, VIEWS
from saltus.heightmap.service.quantiles import negative_log_likelihood


@dataclass(frozen=True, kw_only=True)
class Score:
    """Errors of one predictor [m]; NaN where there is nothing to judge."""

    mae_m: float
    """Over the points that the camera ever saw, see `saltus.heightmap.evaluation.visibility`."""
    mae_visible_m: float
    """Seen in the last 0.2 s."""
    mae_remembered_m: float
    """Seen earlier in the run."""
    mae_unseen_m: float
    """Never seen."""
    edge_error_m: float
    """Of the position of jumps of more than 3 cm, where they were seen and are predicted."""
    edges_found: float
    """Share of them that is predicted."""
    coverage90: float
    """Share of all points, unseen ones included, that lie in their 90 % interval."""
    coverage90_seen: float
    """The same of the points that the camera ever saw."""
    nll: float
    """Mean negative log-likelihood of all points [nats, heights in metres], for a Laplace law with that interval."""
    points: int


def score(runs: Sequence[HeldOutRun], predictor: str) -> Score:
    """One predictor in some runs."""
    said = [run.predictions[predictor] for run in runs]
    height, half_width_90, true = (
        np.concatenate(parts)
        for parts in ([p.height for p in said], [p.half_width_90 for p in said], [run.true_height for run in runs])
    )
    view = np.concatenate([run.view for run in runs])
    error = np.abs(height - true)
    covered = error <= half_width_90
    by_view = {name: _mean(error[view == number]) for number, name in enumerate(VIEWS)}
    seen = view != UNSEEN
    edges = edge_errors(height, np.where(seen, true, np.nan))
    return Score(
        mae_m=_mean(error[seen]),
        mae_visible_m=by_view["visible"],
        mae_remembered_m=by_view["remembered"],
        mae_unseen_m=by_view["unseen"],
        edge_error_m=edges.mean_m,
        edges_found=edges.found,
        coverage90=_mean(covered),
        coverage90_seen=_mean(covered[seen]),
        nll=_mean(negative_log_likelihood(error, half_width_90)),
        points=error.size,
    )


def scores(runs: Sequence[HeldOutRun]) -> dict[str, Any]:
    """The network's score on all runs, by terrain and by level, and those of the baselines, as plain values."""
    names = [name for name in runs[0].predictions if name != NETWORK]
    return {
        "runs": len(runs),
        **_table(runs, NETWORK),
        "by_level": _grouped(runs, NETWORK, lambda run: run.level),
        "baselines": {name: _table(runs, name) for name in names},
    }


def _table(runs: Sequence[HeldOutRun], predictor: str) -> dict[str, Any]:
    by_terrain = _grouped(runs, predictor, lambda run: run.terrain)
    return {**asdict(score(runs, predictor)), "by_terrain": by_terrain}


def _grouped(runs: Sequence[HeldOutRun], predictor: str, group: Callable[[HeldOutRun], str]) -> dict[str, Any]:
    names = sorted({group(run) for run in runs})
    return {name: asdict(score([run for run in runs if group(run) == name], predictor)) for name in names}


def _mean(values: Floats | NDArray[np.bool_]) -> float:
    return float(np.mean(values)) if np.size(values) else float("nan")
