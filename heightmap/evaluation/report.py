"""One HTML file, and the same as numbers, about the errors
of predicted heights in recorded runs.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from saltus.errors import RecordingError
from saltus.heightmap.evaluation import report_figures as figures
from saltus.heightmap.evaluation.comparison import (
    ComparedRun,
    HeightComparison,
    compare_heights,
    read_compared_run,
)
from saltus.heightmap.evaluation.errors_by import REMEMBERED, VISIBLE, GroupedErrors
from saltus.heightmap.evaluation.height_edges import EdgeErrors, edge_errors
from saltus.recordings.recording import Recording
from saltus.recordings.summary import number_cell
from saltus.reports.page import render_page, write_page

WORST = 10
WORST_M = 0.01  # of mean error: a moment that is off by less is not bad
APART_S = 0.3  # about one gait cycle: worst moments nearer than this to each other are the same one
_SECTIONS = (
    ("phase", "By gait phase", GroupedErrors.by_phase, "scheduled contact, and how far it is"),
    ("speed_mps", "By speed", GroupedErrors.by_speed, "speed as estimated [m/s]"),
    ("age_ms", "By age of the image", GroupedErrors.by_age, "age of the image in use [ms]"),
    ("terrain", "By terrain", GroupedErrors.by_terrain, "terrain"),
    ("view", "In view or remembered", GroupedErrors.by_view, "when the image in use was taken"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorReport:
    """Errors of heights that were measured on some recordings, for a report."""

    runs: tuple[ComparedRun, ...]
    comparisons: tuple[HeightComparison, ...]
    """All predictors on all runs of which something can be compared."""
    failed: tuple[str, ...]
    """Why nothing can be compared, for each run that is not among the comparisons."""

    @property
    def predictors(self) -> list[str]:
        """Names, in the order in which they were compared."""
        return list(dict.fromkeys(comparison.predictor for comparison in self.comparisons))

    def errors(self, run: str | None = None) -> dict[str, GroupedErrors]:
        """Errors of each predictor, on all runs or on one."""
        return {
            name: GroupedErrors(group) for name in self.predictors if (group := self._of(name, run))
        }

    def edges(self, run: str | None = None) -> dict[str, EdgeErrors]:
        """Edge localisation of each predictor, on all runs or on one."""
        result = {}
        for name in self.predictors:
            if group := self._of(name, run):
                height = np.concatenate([c.height for c in group])
                result[name] = edge_errors(
                    height, np.concatenate([c.true_height for c in group]), group[0].x
                )
        return result

    def worst(self) -> list[tuple[HeightComparison, int]]:
        """Run and step of the moments with a mean error of the first predictor above `WORST_M`,
        worst first.
        """
        ranked = sorted(
            (-mean, number, i)
            for number, comparison in enumerate(self.comparisons)
            if comparison.predictor == self.predictors[0]
            for i, error in enumerate(comparison.error)
            if np.isfinite(error).any() and (mean := float(np.nanmean(np.abs(error)))) > WORST_M
        )
        chosen: list[tuple[HeightComparison, int]] = []
        for _, number, i in ranked:
            comparison = self.comparisons[number]
            time_s = comparison.time_s[i]
            if all(
                other is not comparison or abs(other.time_s[j] - time_s) > APART_S
                for other, j in chosen
            ):
                chosen.append((comparison, i))
            if len(chosen) == WORST:
                break
        return chosen

    def numbers(self) -> dict[str, Any]:
        """Everything as plain values for JSON; lengths in metres."""
        return {
            "runs": [
                {
                    "name": run.name,
                    "terrain": run.terrain,
                    "steps": len(run.states),
                    "lost": list(run.lost),
                }
                for run in self.runs
            ],
            "failed": list(self.failed),
            "reference": sorted({comparison.reference for comparison in self.comparisons}),
            "predictors": {name: self._numbers_of(name) for name in self.predictors},
            "worst": [
                {
                    "run": c.run,
                    "predictor": c.predictor,
                    "time_s": float(c.time_s[i]),
                    "mae_m": _mean_error(c, i),
                }
                for c, i in self.worst()
            ],
        }

    def _of(self, predictor: str, run: str | None) -> list[HeightComparison]:
        return [c for c in self.comparisons if c.predictor == predictor and run in (None, c.run)]

    def _numbers_of(self, name: str) -> dict[str, Any]:
        errors, edges = self.errors()[name], self.edges()[name]
        table = _summary(errors, edges)
        for key, _, rows_of, _ in _SECTIONS:
            table[f"by_{key}"] = [asdict(row) for row in rows_of(errors)]
        table["by_distance_m"] = [asdict(row) for row in errors.by_distance()]
        calibration = errors.calibration()
        table["calibration"] = {
            "level": calibration.level.tolist(),
            "coverage": calibration.coverage.tolist(),
            "stated_m": calibration.stated_m.tolist(),
            "observed_m": calibration.observed_m.tolist(),
        }
        table["by_run"] = {
            c.run: _summary(self.errors(c.run)[name], self.edges(c.run)[name])
            | {"ok_share": c.ok_share}
            for c in self._of(name, None)
        }
        return table


def measure_errors(recordings: Sequence[Recording], models: Sequence[str] = ()) -> ErrorReport:
    """Measures recordings, and models on the depth of these.

    Args:
        recordings: whole or damaged, with ground truth or without.
        models: "geometric", "geometric-feet", or paths of ONNX files.

    Raises:
        RecordingError: nothing in any of the recordings can be compared.
        ModelError: a file is no model that fits.
    """
    runs = _named_apart([read_compared_run(recording) for recording in recordings])
    comparisons: list[HeightComparison] = []
    failed = []
    for run in runs:
        try:
            found = compare_heights(run, models)
            if not any(np.isfinite(comparison.error).any() for comparison in found):
                raise RecordingError(f"{run.name}: no place was seen again")
            comparisons += found
        except RecordingError as error:
            failed.append(str(error))
    if not comparisons:
        raise RecordingError("; ".join(failed))
    return ErrorReport(runs=tuple(runs), comparisons=tuple(comparisons), failed=tuple(failed))


def write_error_report(report: ErrorReport, path: Path) -> None:
    """Writes the HTML file, which opens without a network;
    `RecordingError` where it cannot be written.
    """
    errors = report.errors()
    text = render_page(
        __file__,
        report=report,
        headline=_headline(report),
        is_without_truth=any(comparison.reference != "truth" for comparison in report.comparisons),
        summaries=_summaries(report),
        distance=figures.distance_figure(errors),
        groups=[
            (title, figures.group_figure(errors, rows_of, axis))
            for _, title, rows_of, axis in _SECTIONS
        ],
        edges=figures.edge_figure(report.edges()),
        calibration=figures.calibration_figure(errors),
        least=centimetres_text(WORST_M),
        most=WORST,
        apart_s=APART_S,
        moments=_moments(report),
    )
    try:
        write_page(path, text)
    except OSError as error:
        raise RecordingError(
            f"cannot write the report '{path}' ({error.strerror}): name another folder"
        ) from error


def _named_apart(runs: list[ComparedRun]) -> list[ComparedRun]:
    """Numbers runs of the same name."""
    names = [run.name for run in runs]
    return [
        replace(run, name=f"{run.name} ({names[: i + 1].count(run.name)})")
        if names.count(run.name) > 1
        else run
        for i, run in enumerate(runs)
    ]


def _mean_error(comparison: HeightComparison, index: int) -> float:
    return float(np.nanmean(np.abs(comparison.error[index])))


def _summary(errors: GroupedErrors, edges: EdgeErrors) -> dict[str, Any]:
    by_view = {row.group: row.mae_m for row in errors.by_view()}
    overall = errors.overall()
    calibration = errors.calibration()
    return {
        "points": len(errors.error),
        "mae_m": overall.mae_m if overall else None,
        "mae_visible_m": by_view.get(VISIBLE),
        "mae_remembered_m": by_view.get(REMEMBERED),
        "edge_error_m": edges.mean_m,
        "edge_bias_m": edges.bias_m,
        "edges": len(edges.true_x),
        "edges_found": edges.found,
        "edges_false": edges.false,
        "coverage90": calibration.coverage90,
        "nll": calibration.nll,
    }


def _headline(report: ErrorReport) -> str:
    row = report.errors()[report.predictors[0]].overall()
    mean = f"{100 * row.mae_m:.2f} cm mean error" if row else "no error known"
    count = len({comparison.run for comparison in report.comparisons})
    return f"Heights, {report.predictors[0]}: {mean} in {count} run{'s' if count > 1 else ''}"


def _summaries(report: ErrorReport) -> list[tuple[str, ...]]:
    """The rows of the table at the head: all runs, then each one, by each predictor."""
    rows = []
    runs = list(dict.fromkeys(comparison.run for comparison in report.comparisons))
    for run in [None, *runs] if len(runs) > 1 else runs:
        errors, edges = report.errors(run), report.edges(run)
        for name in errors:
            numbers = _summary(errors[name], edges[name])
            shares = [
                c.ok_share
                for c in report.comparisons
                if c.predictor == name and run in (None, c.run)
            ]
            cells = (
                *(
                    centimetres_text(numbers[f"{key}_m"])
                    for key in ("mae", "mae_visible", "mae_remembered", "edge_error")
                ),
                f"{number_cell(100 * numbers['edges_found'], 0)} % of {numbers['edges']}",
                str(numbers["edges_false"]),
                f"{number_cell(100 * numbers['coverage90'], 1)} %",
                number_cell(numbers["nll"], 2),
                f"{100 * np.mean(shares):.0f} %",
            )
            rows.append((run or "all runs", name, *cells))
    return rows


def centimetres_text(value: float | None) -> str:
    """A length [m] in centimetres; "-" where there is none."""
    return "-" if value is None else number_cell(100 * value, 2)


def _moments(report: ErrorReport) -> list[tuple[str, go.Figure]]:
    """The worst moments in words and as figures."""
    frames = {(run.name, frame.frame_id): frame for run in report.runs for frame in run.frames}
    moments = []
    for comparison, i in report.worst():
        others = [c for c in report.comparisons if c.run == comparison.run and c is not comparison]
        frame = frames.get((comparison.run, int(comparison.frame_id[i])))
        text = (
            f"{comparison.run}, {comparison.time_s[i]:.2f} s: "
            f"{100 * _mean_error(comparison, i):.1f} cm; "
            f"{comparison.phase[i]}, {comparison.speed_mps[i]:.1f} m/s, image "
            f"{1e3 * comparison.age_s[i]:.0f} ms old"
            f"{'' if frame is not None else ', not in the recording'}"
        )
        moments.append(
            (text, figures.moment_figure(i, comparison, others, frame, report.predictors))
        )
    return moments
