"""The stereo camera on torch, for thousands of cameras at once on any device.

The effects are written once for numpy and torch; here are only the ways in and out.
"""

from typing import Any

import numpy as np
import torch

from render.stereo.camera import StereoCamera, StereoConfig, StereoState
from render.stereo.model_view import pooled
from render.stereo.optics import Optics
from saltus.effects.effect import map_arrays


class TorchStereo:
    """Stereo cameras whose images live on one device.

    Args:
        config: of the cameras.
        optics: of the images that come in.
        device: where to work.
    """

    def __init__(self, config: StereoConfig, optics: Optics, device: torch.device | str = "cpu") -> None:
        self.device = torch.device(device)
        self._camera = StereoCamera(config, optics)

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
