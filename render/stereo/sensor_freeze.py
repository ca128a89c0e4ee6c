"""A sensor hangs: the same image comes again and again, each time as if it were new."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from saltus.arrays import namespace
from saltus.effects.draws import draw_keys, uniform
from saltus.effects.effect import Effect, PerRobot, Site, like, parameter
from saltus.effects.signals import DepthImage

ROUNDING_S = 1e-9  # times that are meant to be equal may differ by rounding
Memory = tuple[Any, DepthImage | None, Any]
"""Keys, the last image given out, and until when the sensor hangs [s]."""


@dataclass(frozen=True, kw_only=True)
class SensorFreeze(Effect[DepthImage]):
    """At random moments, `rate` times a second on average, the depth stays for `duration`; capture times run on.

    This is worse than a lost frame: no consumer can tell from the age of the image.
    """

    name: ClassVar[str] = "sensor_freeze"
    site: ClassVar[Site] = "depth"

    rate: PerRobot = parameter(unit="1/s", null=0.0, low=0.0, high=50.0)
    duration: PerRobot = parameter(unit="s", null=0.0, low=0.0, high=60.0)

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> Memory:
        """A key for each camera and no image."""
        return draw_keys(batch, rng), None, None

    def apply(self, signal: DepthImage, time_s: float, state: Memory) -> tuple[DepthImage, Memory]:
        """Returns the image, or the one at which the sensor hangs, with the time of the new one."""
        del time_s
        if self.is_null():
            return signal, state
        keys, last, until_s = state
        xp, now_s = namespace(signal.depth), signal.time_s
        if last is None:
            return signal, (keys, signal, xp.full_like(now_s, -float("inf")))
        elapsed_s = now_s - last.time_s
        hangs = now_s <= until_s + ROUNDING_S
        begins = ~hangs & (uniform(keys, now_s) < like(self.rate, now_s, xp) * elapsed_s)
        until_s = xp.where(begins, now_s + like(self.duration, now_s, xp), until_s)
        depth = xp.where(hangs[..., None, None], last.depth, signal.depth)
        image = replace(signal, depth=depth)
        return image, (keys, image, until_s)
