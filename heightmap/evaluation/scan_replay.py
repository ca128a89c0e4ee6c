"""How far heights on any grid are off the simulator's ground in a recorded run."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from saltus.grid import HeightGrid
from saltus.heightmap.evaluation.scan_picture import write_picture
from saltus.loop.heights import true_heights
from saltus.recordings.recording import Recording
from saltus.wire.messages import GroundTruth, Heightmap

SETTLED_NS = 1_000_000_000
"""Figures are of what comes so long after the first image, as those of models/scan.md."""
VISIBLE_S = 0.2
"""A point is visible where a ray of an image ended that was exposed within this time before its
newest image."""


def scan_errors(
    recording: Recording, grid: HeightGrid, answers: Iterable[Heightmap]
) -> dict[str, object]:
    """Errors [mm], share inside the 90 % interval,
    median half-width [mm] and share of all points, by visibility.

    Only `points` where the recording has no truth, or no image came a second before its end.
    """
    truths = {truth.step: truth for truth in recording.of(GroundTruth)}
    columns: list[list[np.ndarray]] = [[], [], [], []]
    begun_ns = None
    for answer in answers:
        begun_ns = answer.time_ns if begun_ns is None and answer.seen_share > 0.0 else begun_ns
        truth = truths.get(answer.step)
        if truth is None or begun_ns is None or answer.time_ns - begun_ns < SETTLED_NS:
            continue
        height = heights_below(recording, grid, truth)
        found = (
            np.abs(answer.height - height),
            answer.half_width_90,
            answer.age_s,
            answer.depth_age_s + 0.0 * height,
        )
        for column, values in zip(columns, found, strict=True):
            column.append(np.asarray(values))
    if not columns[0]:
        return {"points": grid.size}
    error, half_width, age_s, newest_s = (np.concatenate(column) for column in columns)
    seen, lately = np.isfinite(age_s), age_s - newest_s < VISIBLE_S
    kinds = {
        "all": seen | True,
        "seen": seen,
        "visible": lately,
        "remembered": seen & ~lately,
        "never": ~seen,
    }
    return {"points": grid.size} | {
        name: {
            "mean_mm": round(1e3 * float(error[kind].mean()), 2),
            "inside": round(float((error <= half_width)[kind].mean()), 3),
            "half_width_mm": round(1e3 * float(np.median(half_width[kind])), 1),
            "share": round(float(kind.mean()), 3),
        }
        for name, kind in kinds.items()
        if kind.any()
    }


def draw_scan(
    path: Path, recording: Recording, grid: HeightGrid, answers: Sequence[Heightmap]
) -> None:
    """Draws the answer whose seen points span the most, where the ground is the most uneven."""
    drawn = max(answers, key=_span_m)
    truth = next((t for t in recording.of(GroundTruth) if t.step == drawn.step), None)
    write_picture(path, drawn, None if truth is None else heights_below(recording, grid, truth))


def _span_m(answer: Heightmap) -> float:
    """Highest less lowest height that was seen [m]."""
    seen = np.asarray(answer.height)[np.isfinite(answer.age_s)]
    return float(np.ptp(seen)) if len(seen) else 0.0


def heights_below(recording: Recording, grid: HeightGrid, truth: GroundTruth) -> np.ndarray:
    """Heights of the ground at the points of a grid, relative to the base [m], shape (points,)."""
    pose = truth.position_base_in_world, truth.quaternion_base_in_world
    return np.asarray(true_heights(recording.terrain, *pose, grid))
