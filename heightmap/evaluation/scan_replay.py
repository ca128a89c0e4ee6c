"""How far heights on any grid are off the simulator's ground in a recorded run."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Reals
from saltus.errors import SaltusError
from saltus.grid import HeightGrid
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


CELL_PX, GAP_PX, HEAD_PX = 22, 40, 64
WIDEST_M = 0.15
"""Half-widths from here on have one colour: ground that was never seen has about 0.1 m
(models/scan.md)."""
OLDEST_S = 2.0
"""Ages from here on have one colour."""
PAPER, INK, UNSEEN = (255, 255, 255), (52, 44, 40), (90, 90, 90)


def write_picture(path: Path, answer: Heightmap, truth: Reals | None) -> None:
    """Draws heights, true heights where they are known, half-widths and ages.

    A dot marks what no image has shown.

    Raises:
        SaltusError: the file cannot be written.
    """
    height, shape = np.asarray(answer.height), (len(answer.x), len(answer.y))
    low, high = (
        float(end(height if truth is None else np.concatenate([height, truth])))
        for end in (np.min, np.max)
    )
    unseen = ~np.isfinite(answer.age_s).reshape(shape)
    panels = [_panel("height", height.reshape(shape), low, high, "m", unseen)]
    if truth is not None:
        panels.append(
            _panel("true height", np.asarray(truth).reshape(shape), low, high, "m", unseen)
        )
    half = np.asarray(answer.half_width_90).reshape(shape)
    panels.append(_panel("half-width", half, 0.0, WIDEST_M, "m", unseen))
    age = np.where(unseen, OLDEST_S, np.asarray(answer.age_s).reshape(shape))
    panels.append(_panel("age", age, 0.0, OLDEST_S, "s", unseen))
    if not cv2.imwrite(str(path), np.concatenate(panels, axis=1)):
        raise SaltusError(f"cannot write {path}: name a .png in a folder that is there")


def _panel(
    title: str, table: Reals, low: float, high: float, unit: str, unseen: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """One table of values (rows ahead, columns to the left) in colours from `low` to `high`."""
    share = np.clip((table - low) / max(high - low, 1e-6), 0.0, 1.0)
    colours = cv2.applyColorMap(
        np.rint(255.0 * share[::-1, ::-1]).astype(np.uint8), cv2.COLORMAP_VIRIDIS
    )
    size = (CELL_PX * table.shape[1], CELL_PX * table.shape[0])
    cells = cv2.resize(colours, size, interpolation=cv2.INTER_NEAREST)
    for row, column in np.argwhere(unseen[::-1, ::-1]).tolist():
        centre = (round(CELL_PX * (column + 0.5)), round(CELL_PX * (row + 0.5)))
        cv2.circle(cells, centre, 3, UNSEEN, -1, cv2.LINE_AA)
    page = np.full((size[1] + HEAD_PX + GAP_PX, size[0] + GAP_PX, 3), PAPER, np.uint8)
    page[HEAD_PX : HEAD_PX + size[1], GAP_PX // 2 : GAP_PX // 2 + size[0]] = cells
    for text, y in ((title, 24), (f"{low:.2f} to {high:.2f} {unit}", 48)):
        cv2.putText(
            page, text, (GAP_PX // 2, y), cv2.FONT_HERSHEY_SIMPLEX, 0.55, INK, 1, cv2.LINE_AA
        )
    return page
