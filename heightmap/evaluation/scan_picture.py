"""A picture of the heights of a grid, seen from above: ahead is up, left is left."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Reals
from saltus.errors import SaltusError
from saltus.wire.messages import Heightmap

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
