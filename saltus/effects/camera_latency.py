"""A depth image arrives some time after its exposure."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from saltus.arrays import namespace
from saltus.effects.draws import draw_keys, uniform
from saltus.effects.effect import Effect, PerRobot, parameter, period
from saltus.effects.signals import DepthImage, chosen, nothing_yet

ROUNDING_S = 1e-9  # times that are meant to be equal may differ by rounding
Memory = tuple[Any, tuple[tuple[DepthImage, Any], ...]]
"""Keys of the robots, and the images of the last samples with their arrivals [s], newest first."""


@dataclass(frozen=True, kw_only=True)
class CameraLatency(Effect[DepthImage], name="camera_latency", site="depth"):
    """An image can be seen from `latency` after its capture on, give or take `jitter` (uniform, per image).

    The output is the image with the newest capture among those that have arrived; before the first there is none.
    50 ms with a D435i (paper: a sine of body height against the image).
    """

    latency: PerRobot = parameter(unit="s", null=0.0, low=0.0, high=0.5, sought=(0.0, 0.3))
    jitter: PerRobot = parameter(unit="s", null=0.0, low=0.0, high=0.1)
    dt_s: float = period(0.01)
    """Period at which images are asked for: that of the policy."""

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> Memory:
        """A key for each robot and no image."""
        return draw_keys(batch, rng), ()

    def arrival_s(self, captured_s: Any, keys: Any) -> Any:
        """When images that were captured at `captured_s` arrive [s], shape (...)."""
        xp = namespace(captured_s)
        latency = self.value("latency", captured_s)
        if np.all(np.equal(self.jitter, 0.0)):
            return captured_s + latency
        delay = latency + self.value("jitter", captured_s) * (2.0 * uniform(keys, captured_s) - 1.0)
        return captured_s + xp.where(delay > 0.0, delay, 0.0)

    def apply(self, signal: DepthImage, time_s: float, state: Memory) -> tuple[DepthImage, Memory]:
        """Returns the newest image that has arrived at `time_s`."""
        keys, past = state
        images = past
        # the same image may be shown again while the next one is awaited: it takes no place in memory
        if not past or bool(namespace(signal.time_s).any(signal.time_s != past[0][0].time_s)):
            length = math.ceil(float(np.max(np.add(self.latency, self.jitter))) / self.dt_s) + 1
            images = ((signal, self.arrival_s(signal.time_s, keys)), *past)[:length]
        newest = nothing_yet(signal)
        for image, arrival_s in images[::-1]:
            arrived = arrival_s <= time_s + ROUNDING_S
            newest = chosen(arrived & (image.time_s >= newest.time_s), image, newest)
        return newest, (keys, images)

    def next_arrival_s(self, time_s: float, state: Memory) -> float:
        """When the next image arrives, of any robot's [s]; infinite where none is under way."""
        _, images = state
        arrivals = [np.asarray(arrival_s) for _, arrival_s in images]
        coming = [float(np.min(a[a > time_s + ROUNDING_S])) for a in arrivals if np.any(a > time_s + ROUNDING_S)]
        return min(coming, default=math.inf)
