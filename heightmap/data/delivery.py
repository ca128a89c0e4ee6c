"""Which image a robot uses at each tick, with latency, jitter and loss."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.constants import POLICY_DT
from saltus.depth_camera import DepthCamera
from saltus.effects.camera import CameraChain, drawn_around
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.profile import SHIPPED, load_profile
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.settings import DeliveryName
from saltus.robots.loading import load_robot
from saltus.wire.topics import CAMERA_LATENCY_S

TICK_S = POLICY_DT
FRAME_TICKS = 2  # camera at 50 Hz


@dataclass(frozen=True, kw_only=True)
class ImageDeliveryModel:
    """How images travel; the defaults are those of a run without faults.

    Latencies are those of a nominal camera: around another one's they move by the difference, as in
    a trial.
    """

    latency_s: tuple[float, float] = (CAMERA_LATENCY_S, CAMERA_LATENCY_S)
    """Exposure to arrival, drawn once an episode; at once for every camera where both are 0."""
    jitter_s: float = 0.0
    """Each image takes up to this much longer."""
    loss: float = 0.0
    """Greatest share of images that are lost; the share is drawn once an episode."""
    burst: float = 0.0
    """Share of episodes in which the camera also pauses, once, for up to 0.1 s."""

    def range_s(self, latency: CameraLatency) -> tuple[float, float]:
        """Least and greatest latency that is drawn around that of a camera, without jitter [s]."""
        if latency.is_null() or self.latency_s == (0.0, 0.0):
            return 0.0, 0.0
        low, high = (
            max(0.0, float(latency.latency) + limit_s - CAMERA_LATENCY_S)
            for limit_s in self.latency_s
        )
        return low, high

    def drawn(
        self, latency: CameraLatency, batch: tuple[int, ...], rng: np.random.Generator
    ) -> CameraChain:
        """Draws what happens in an episode, but for pauses,
        to the images of cameras whose latency is known.

        It may have a value for each camera of the batch.
        """
        spread_s = 0.5 * self.jitter_s
        latency_s, loss = (
            rng.uniform(*self.latency_s, batch) + spread_s,
            rng.uniform(0.0, self.loss, batch),
        )
        known = () if self.latency_s == (0.0, 0.0) else (latency,)
        return CameraChain(drawn_around(known, latency_s=latency_s, jitter_s=spread_s, loss=loss))


def hardware_table(profile: str, robot: str, camera: DepthCamera) -> dict[str, object]:
    """Table for the manifest of a dataset, of robots and cameras that are not as shipped."""
    if profile == SHIPPED:
        return {}
    known = camera.delivered(load_profile(profile, load_robot(robot)))
    return {"profile": profile, "latency": asdict(known.camera_chain.latency)}


# Original: 30 to 60 ms between exposure and use; measured of a D435 at 424x240 48 to 62 ms at 60
# Hz, 91 ms at 30 Hz (librealsense 4955), and a busy computer adds to that. The service forgets
# after a gap of more than 5 images.
TRAINING = ImageDeliveryModel(latency_s=(0.030, 0.110), jitter_s=0.008, loss=0.08, burst=0.3)
DELIVERIES: dict[DeliveryName, ImageDeliveryModel] = {
    "training": TRAINING,
    "nominal": ImageDeliveryModel(),
    "at-once": ImageDeliveryModel(latency_s=(0.0, 0.0)),
}
"""Deliveries that a network can be trained with; all but the first are for comparison: no robot has
such a camera."""


class DeliveredImages(NamedTuple):
    """Delivered images of each episode at each tick of the longest.

    Each of shape (episodes, ticks).
    """

    frame: NDArray[np.int64]
    """Image in use; -1 before the first."""
    age_s: Floats
    """Age of that image; infinite before the first."""
    new: NDArray[np.bool_]


def draw_delivery(
    episodes: Sequence[Episode], model: ImageDeliveryModel, rng: np.random.Generator
) -> DeliveredImages:
    """Draws how the images of each episode travel, around the latency of its camera."""
    count, ticks = len(episodes), np.array([[len(episode.height)] for episode in episodes])
    taken_tick = np.full((count, max(len(episode.frame_tick) for episode in episodes)), np.inf)
    for row, episode in zip(taken_tick, episodes, strict=True):
        row[: len(episode.frame_tick)] = episode.frame_tick
    taken_s = taken_tick * TICK_S
    known = np.array([(episode.latency.latency, episode.latency.jitter) for episode in episodes])
    chain = model.drawn(CameraLatency(latency=known[:, :1], jitter=known[:, 1:]), (count, 1), rng)
    arrival_s = chain.arrival_s(taken_s, chain.init((count, 1), rng))
    pauses, begins_s = rng.uniform(size=(count, 1)) < model.burst, rng.uniform(0.0, ticks * TICK_S)
    ends_s = begins_s + rng.uniform(0.02, 0.1, (count, 1))
    arrival_s[pauses & (taken_s >= begins_s) & (taken_s < ends_s)] = np.inf
    arrival_tick = np.ceil(arrival_s / TICK_S - 1e-6)
    now = np.arange(ticks.max())
    newest = np.full((count, len(now)), -1)
    row, frame = np.nonzero(arrival_tick < len(now))
    # One overtaken has no effect
    np.maximum.at(newest, (row, arrival_tick[row, frame].astype(np.int64)), frame)
    newest = np.maximum.accumulate(newest, 1)
    age_s = (now - np.take_along_axis(taken_tick, np.maximum(newest, 0), 1)) * TICK_S
    return DeliveredImages(
        newest, np.where(newest >= 0, age_s, np.inf), np.diff(newest, prepend=-1) != 0
    )
