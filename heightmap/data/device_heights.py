"""The law of `saltus.heightmap.data.predicted` on tensors: thousands of robots, one network, late images."""

import torch
from torch import Tensor

from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.data.delivery import TICK_S, DeliveryModel
from saltus.heightmap.model import IMAGE_SHAPE, HeightmapModel, model_image
from saltus.heightmap.service.service import MAX_HEIGHT_M

_NEVER = 2**30  # a tick that does not come


class LateImages:
    """Which image each robot has in hand; the law of `delivery.deliver`, tick by tick, without pauses.

    Latency and share of losses are drawn once a robot. The generator names the device.
    """

    def __init__(self, count: int, delivery: DeliveryModel, generator: torch.Generator) -> None:
        self.count = count
        self._delivery, self._generator = delivery, generator
        device = generator.device
        low, high = delivery.latency_s
        self._latency_s = low + (high - low) * self._uniform()
        self._loss = delivery.loss * self._uniform()
        places = int((high + delivery.jitter_s) / TICK_S) + 2  # more than are ever under way
        self._due = torch.full((places, count), _NEVER, device=device)
        self._taken = torch.full((places, count), -_NEVER, device=device)
        self._under_way = torch.zeros(places, count, *IMAGE_SHAPE[1:], dtype=torch.int32, device=device)
        self._in_hand = torch.zeros(count, *IMAGE_SHAPE, device=device)
        self._captured = torch.zeros(count, dtype=torch.int64, device=device)
        self.forget(torch.ones(count, dtype=torch.bool, device=device))

    def forget(self, mask: Tensor) -> None:
        """Robots in `mask`, bool, shape (n,), have seen nothing, and nothing is under way to them."""
        self._due = torch.where(mask, _NEVER, self._due)
        self._captured = torch.where(mask, -_NEVER, self._captured)
        blank = torch.zeros_like(self._in_hand[:1])
        blank[:, 0] = 1.0
        self._in_hand = torch.where(mask[:, None, None, None], blank, self._in_hand)

    def send(self, millimetres: Tensor, tick: int) -> None:
        """Images that are taken now, shape (n, 48, 16)."""
        place = tick % len(self._due)
        travel_s = self._latency_s + self._delivery.jitter_s * self._uniform()
        arrival = tick + torch.ceil(travel_s / TICK_S - 1e-6).long()
        self._due[place] = torch.where(self._uniform() < self._loss, _NEVER, arrival)
        self._taken[place] = tick
        self._under_way[place] = millimetres

    def receive(self, tick: int) -> tuple[Tensor, Tensor, Tensor]:
        """What is in hand now: image, shape (n, 2, 48, 16), its age [s], and whether it has just come, (n,)."""
        arrived = (self._due <= tick) & (self._taken > self._captured)  # one that was overtaken has no effect
        taken, place = torch.where(arrived, self._taken, -_NEVER).max(0)
        new = arrived.any(0)
        chosen = self._under_way[place, torch.arange(self.count, device=place.device)]
        self._in_hand = torch.where(new[:, None, None, None], model_image(chosen), self._in_hand)
        self._captured = torch.where(new, taken, self._captured)
        return self._in_hand, (tick - self._captured) * TICK_S, new

    def _uniform(self) -> Tensor:
        return torch.rand(self.count, generator=self._generator, device=self._generator.device)


class DeviceHeights:
    """What the heightmap service of each robot answers."""

    def __init__(self, model: HeightmapModel, images: LateImages) -> None:
        self._images, self._model = images, model
        count, device = images.count, model.height_mean.device
        self._hidden = torch.zeros(count, model.config.hidden, device=device)
        self._heights = torch.zeros(count, len(HEIGHTMAP_X), device=device)

    @torch.no_grad()
    def step(self, exposed: Tensor | None, tick: int, proprioception: Tensor, fresh: Tensor) -> Tensor:
        """One tick.

        Args:
            exposed: Images that are taken now [mm], shape (n, 48, 16); None where it is not the time.
            tick: Since the first.
            proprioception: See `saltus.heightmap.service.features`, shape (n, some).
            fresh: Robots that start anew: what they saw before is void, bool, shape (n,).

        Returns:
            Heights [m], shape (n, 30); where the network's are not plausible, the last that were.
        """
        rows = fresh[:, None]
        self._hidden = torch.where(rows, 0.0, self._hidden)
        self._heights = torch.where(rows, 0.0, self._heights)
        self._images.forget(fresh)
        if exposed is not None:
            self._images.send(exposed, tick)
        image, age_s, new = self._images.receive(tick)
        estimate, hidden = self._model.step(image, age_s, new.float(), proprioception, self._hidden)
        good = ((estimate.height.abs() <= MAX_HEIGHT_M).all(-1) & torch.isfinite(hidden).all(-1))[:, None]
        self._hidden = torch.where(good, hidden, self._hidden)
        self._heights = torch.where(good, estimate.height, self._heights)
        return self._heights
