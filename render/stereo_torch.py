"""The stereo camera on torch, for thousands of cameras at once on any device.

The effects are written once for numpy and torch; here are the ways in and out, and the morphology, which is kornia's.
On a GPU no step waits for a value: shapes and the number of operations depend on the size of the images only.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from kornia.morphology import dilation, erosion

from saltus.effects.effect import map_arrays
from saltus.render.stereo.camera import StereoCamera, StereoConfig, StereoState
from saltus.render.stereo.model_view import pooled
from saltus.render.stereo.optics import Optics


@dataclass(frozen=True)
class KorniaWindows:
    """`saltus.render.stereo.windows.Morphology` for images of three dimensions.

    Only extremes come from kornia: its moving averages (`box_blur`), which are convolutions on a CPU, take 8 to 49
    times as long there as sums over windows of 1, 2, 4, ... samples.
    """

    def any_around(self, mask: torch.Tensor, rows: int, columns: int) -> torch.Tensor:
        """See there; along rows, then along columns."""
        image = mask[:, None].to(torch.float16)  # 0 and 1 are exact in it
        for shape in ((2 * rows + 1, 1), (1, 2 * columns + 1)):
            if max(shape) > 1:
                image = dilation(image, torch.ones(shape, dtype=image.dtype, device=image.device))
        return image[:, 0] > 0.0

    def range_around(self, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See there."""
        around = torch.ones((3, 3), dtype=values.dtype, device=values.device)
        return erosion(values[:, None], around)[:, 0], dilation(values[:, None], around)[:, 0]


class TorchStereo:
    """Stereo cameras whose images live on one device."""

    def __init__(self, config: StereoConfig, optics: Optics, device: torch.device | str = "cpu") -> None:
        self.device = torch.device(device)
        self._camera = StereoCamera(config, optics, KorniaWindows())

    def init(self, count: int, rng: np.random.Generator) -> StereoState:
        """State before the first images, for `count` cameras."""
        state: StereoState = map_arrays(self._tensor, self._camera.init((count,), rng))
        return state

    @torch.no_grad()
    def step(
        self, depth: torch.Tensor, hidden: torch.Tensor, time_s: torch.Tensor, state: StereoState
    ) -> tuple[torch.Tensor, StereoState]:
        """One exposure of every camera.

        Args:
            depth: true depth [m], infinite where nothing is hit, float32, shape (count, height, width).
            hidden: what the right imager does not see, bool, same shape.
            time_s: capture times [s], float64, shape (count,).
            state: what `init` or the last `step` returned.

        Returns:
            Depth as reported [m], 0 where invalid, same shape as `depth`, and the next state.
        """
        image, state = self._camera.step(depth, hidden, time_s, state)
        result: Any = image.depth
        return result, state

    @torch.no_grad()
    def step_pooled(
        self,
        depth: torch.Tensor,
        hidden: torch.Tensor,
        time_s: torch.Tensor,
        state: StereoState,
        rows: int,
        columns: int,
    ) -> tuple[torch.Tensor, StereoState]:
        """The same, then pooled to the model's pixels of `rows` times `columns` samples: shape (count, 48, 16)."""
        result, state = self.step(depth, hidden, time_s, state)
        return pooled(result, rows, columns), state

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self.device)
