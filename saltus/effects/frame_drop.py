"""Some images never arrive."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from saltus.arrays import namespace
from saltus.effects.draws import draw_keys, uniform
from saltus.effects.effect import Effect, PerRobot, parameter
from saltus.effects.signals import DepthImage, chosen, nothing_yet


@dataclass(frozen=True, kw_only=True)
class FrameDrop(Effect[DepthImage], name="frame_drop", site="depth"):
    """A share `fraction` of the images is lost, each by itself; the image before stays the newest."""

    # 0.5 to 20 % on USB cameras under load
    fraction: PerRobot = parameter(unit="", null=0.0, low=0.0, high=1.0, sought=(0.0, 0.87))

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> tuple[Any, DepthImage | None]:
        """A key for each robot and no image."""
        return draw_keys(batch, rng), None

    def apply(
        self, signal: DepthImage, time_s: float, state: tuple[Any, DepthImage | None]
    ) -> tuple[DepthImage, tuple[Any, DepthImage | None]]:
        """Returns the image, or the last one that was not lost."""
        del time_s
        keys, last = state
        kept = namespace(signal.time_s).isfinite(self.arrival_s(signal.time_s, keys))
        image = chosen(kept, signal, nothing_yet(signal) if last is None else last)
        return image, (keys, image)

    def arrival_s(self, captured_s: Any, keys: Any) -> Any:
        """When images that were captured at `captured_s` arrive [s], shape (...): at once, or never."""
        xp = namespace(captured_s)
        return xp.where(uniform(keys, captured_s) < self.value("fraction", captured_s), math.inf, captured_s)
