"""A picture of a terrain from above: heights as colours,
lit from the side, with a scale in metres.
"""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.terrain.terrain import Terrain

PIXELS = 900  # of the longer side
FINEST_M = 0.005  # of a pixel: a terrain of 1 m is not drawn finer
LIGHT = np.array([0.5, 0.5, 0.7])  # from ahead and the left, above
LEAST_LIGHT = 0.35
MARGIN = 40  # [px]
INK, FONT, SCALE = (40, 40, 40), cv2.FONT_HERSHEY_SIMPLEX, 0.45


def draw_terrain(terrain: Terrain, path: Path) -> None:
    """Writes a PNG: x to the right, y up; a circle is the start, a line the finish.

    Raises:
        OSError: the file cannot be written.
    """
    arrays = terrain.arrays
    low = np.asarray(arrays.center - arrays.extent)[:, :2].min(axis=0)
    high = np.asarray(arrays.center + arrays.extent)[:, :2].max(axis=0)
    pixel = max(FINEST_M, float((high - low).max()) / PIXELS)
    x, y = (np.arange(low[i] + 0.5 * pixel, high[i], pixel) for i in (0, 1))
    # By row: memory of few points
    heights = np.array([terrain.height_at(x, np.full_like(x, row)) for row in y[::-1]])
    picture = np.pad(
        _lit(heights, pixel), ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0)), constant_values=255
    )

    def at(x_m: float, y_m: float) -> tuple[int, int]:
        return MARGIN + round((x_m - low[0]) / pixel), MARGIN + round((high[1] - y_m) / pixel)

    cv2.circle(picture, at(terrain.start_x, 0.0), 5, INK, 2, cv2.LINE_AA)
    cv2.line(picture, at(terrain.finish_x, low[1]), at(terrain.finish_x, high[1]), INK, 1)
    for metre in range(int(np.ceil(low[0])), int(high[0]) + 1):
        place = at(metre, low[1])
        cv2.putText(
            picture, str(metre), (place[0] - 4, place[1] + 16), FONT, SCALE, INK, 1, cv2.LINE_AA
        )
    for metre in range(int(np.ceil(low[1])), int(high[1]) + 1):
        cv2.putText(
            picture, str(metre), (8, at(low[0], metre)[1] + 4), FONT, SCALE, INK, 1, cv2.LINE_AA
        )
    title = f"{terrain.kind}: {heights.min():.2f} m (dark) to {heights.max():.2f} m (bright)"
    cv2.putText(picture, title, (MARGIN, 24), FONT, SCALE, INK, 1, cv2.LINE_AA)
    if not cv2.imwrite(str(path), picture):
        raise OSError(f"cannot write {path}")


def _lit(heights: Floats, pixel: float) -> NDArray[np.uint8]:
    """Colours of heights (BGR), brighter where they lean to the light."""
    low, high = float(heights.min()), float(heights.max())
    grey = (255.0 * (heights - low) / max(high - low, 1e-3)).astype(np.uint8)
    down, ahead = (
        np.gradient(heights, pixel) if min(heights.shape) > 1 else (0.0 * heights, 0.0 * heights)
    )
    normal = np.stack([-ahead, down, np.ones_like(heights)], axis=-1)  # rows run against y
    light = np.clip(
        normal @ LIGHT / np.linalg.norm(normal, axis=-1) / np.linalg.norm(LIGHT), LEAST_LIGHT, 1.0
    )
    return (cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS) * light[..., None]).astype(np.uint8)
