"""The law of `saltus.heightmap.data.predicted` on tensors: thousands of robots, one network, late images."""

import numpy as np
import torch
from torch import Tensor

from saltus.depth import model_image
from saltus.effects.camera_latency import CameraLatency
from saltus.effects.effect import map_arrays
from saltus.effects.signals import DepthImage
from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.data.delivery import TICK_S, DeliveryModel
from saltus.heightmap.data.late_images import LateImages, UsedImages
from saltus.heightmap.model import IMAGE_SHAPE, HeightmapModel
from saltus.heightmap.service.service import MAX_HEIGHT_M

_LONGEST_S = 1e7
"""Age of an image that there is not."""


def late_images(
    count: int, delivery: DeliveryModel, latency: CameraLatency, rng: np.random.Generator, device: torch.device | str
) -> LateImages:
    """The images [mm] of `count` cameras that have a latency, delivered without pauses."""
    chain = delivery.drawn(latency, (count,), rng)
    state = map_arrays(lambda keys: torch.as_tensor(keys, device=device), chain.init((count,), rng))
    time_s = torch.zeros(count, dtype=torch.float64, device=device)
    depth = torch.zeros(count, *IMAGE_SHAPE[1:], dtype=torch.int32, device=device)
    return LateImages(chain, state, DepthImage(depth=depth, time_s=time_s))


class DeviceHeights:
    """What the heightmap service of each robot answers."""

    def __init__(self, model: HeightmapModel, images: LateImages) -> None:
        self._images, self._model = images, model
        self._used = UsedImages(model_image(images.in_hand.depth), images.in_hand.time_s)
        count, device = len(images.in_hand.time_s), model.height_mean.device
        self._hidden = torch.zeros(count, model.config.hidden, device=device)
        self._heights = torch.zeros(count, len(HEIGHTMAP_X), device=device)

    @torch.no_grad()
    def step(self, exposed: DepthImage | None, tick: int, proprioception: Tensor, fresh: Tensor) -> Tensor:
        """One tick.

        Args:
            exposed: The newest images that cameras gave out [mm], shape (n, 48, 16); None where there are no others.
            tick: Since the first.
            proprioception: See `saltus.heightmap.service.features`, shape (n, some).
            fresh: Robots that start anew: what they saw before is void, bool, shape (n,).

        Returns:
            Heights [m], shape (n, 30); where the network's are not plausible, the last that were.
        """
        arrived = self._images.step(exposed, tick * TICK_S, fresh)
        image = self._images.in_hand
        new, forgets = self._used.step(arrived, model_image(image.depth), image.time_s, fresh)
        self._hidden = torch.where((fresh | forgets)[:, None], 0.0, self._hidden)
        self._heights = torch.where(fresh[:, None], 0.0, self._heights)
        age = (tick * TICK_S - self._used.captured_s).clamp(max=_LONGEST_S).float()
        estimate, hidden = self._model.step(self._used.image, age, new.float(), proprioception, self._hidden)
        good = ((estimate.height.abs() <= MAX_HEIGHT_M).all(-1) & torch.isfinite(hidden).all(-1))[:, None]
        self._hidden = torch.where(good, hidden, self._hidden)
        self._heights = torch.where(good, estimate.height, self._heights)
        return self._heights
