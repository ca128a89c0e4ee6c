"""Which image a robot uses at each tick, with latency, jitter and loss."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.depth_camera import DepthCamera
from saltus.heightmap.settings import DeliveryName
from saltus.wire.topics import CAMERA_LATENCY_S

TICK_S = 0.01
FRAME_TICKS = 2  # camera at 50 Hz


@dataclass(frozen=True, kw_only=True)
class DeliveryModel:
    """How images travel; the defaults are those of a run without faults."""

    latency_s: tuple[float, float] = (CAMERA_LATENCY_S, CAMERA_LATENCY_S)
    """Exposure to arrival, drawn once an episode."""
    jitter_s: float = 0.0
    """Each image takes up to this much longer."""
    loss: float = 0.0
    """Greatest share of images that are lost; the share is drawn once an episode."""
    burst: float = 0.0
    """Share of episodes in which the camera also pauses, once, for up to 0.1 s."""

    def around(self, camera: DepthCamera) -> "DeliveryModel":
        """The same about the latency of a camera, where it has one of its own."""
        if camera.latency_s is None or self.latency_s == (0.0, 0.0):
            return self
        low, high = (max(0.0, latency_s + camera.latency_s - CAMERA_LATENCY_S) for latency_s in self.latency_s)
        return replace(self, latency_s=(low, high))


# Original: 30 to 60 ms between exposure and use. The service forgets after a gap of more than 5 images.
TRAINING = DeliveryModel(latency_s=(0.030, 0.060), jitter_s=0.008, loss=0.08, burst=0.3)
DELIVERIES: dict[DeliveryName, DeliveryModel] = {
    "training": TRAINING,
    "nominal": DeliveryModel(),
    "at-once": DeliveryModel(latency_s=(0.0, 0.0)),
}
"""What a network can be trained with; all but the first are for comparison: no robot has such a camera."""


class Delivery(NamedTuple):
    """Per tick, each of shape (ticks,)."""

    frame: NDArray[np.int64]
    """Image in use; -1 before the first."""
    age_s: Floats
    """Of that image; infinite before the first."""
    new: NDArray[np.bool_]


def deliver(frame_tick: NDArray[np.int32], ticks: int, model: DeliveryModel, rng: np.random.Generator) -> Delivery:
    """Draws the delivery of one episode.

    Args:
        frame_tick: Tick at which each image was taken, ascending, shape (frames,).
        ticks: Length of the episode.
        model: How images travel.
        rng: Source of delays and losses.
    """
    taken_s = frame_tick * TICK_S
    travel_s = rng.uniform(*model.latency_s) + rng.uniform(0.0, model.jitter_s, len(taken_s))
    lost = rng.uniform(size=len(taken_s)) < rng.uniform(0.0, model.loss)
    if rng.uniform() < model.burst:
        begin = rng.uniform(0.0, ticks * TICK_S)
        lost |= (taken_s >= begin) & (taken_s < begin + rng.uniform(0.02, 0.1))
    arrival_tick = np.ceil((taken_s + travel_s) / TICK_S - 1e-6).astype(np.int64)
    newest = np.full(ticks, -1, np.int64)
    arrived = np.flatnonzero(~lost & (arrival_tick < ticks))
    np.maximum.at(newest, arrival_tick[arrived], arrived)  # one that was overtaken has no effect
    newest = np.maximum.accumulate(newest)
    age_s = np.where(newest >= 0, (np.arange(ticks) - frame_tick[np.maximum(newest, 0)]) * TICK_S, np.inf)
    return Delivery(newest, age_s, np.diff(newest, prepend=-1) != 0)
