"""From an image that is exposed now to the image that a robot has now: the effects of a camera in order."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from saltus.effects.camera_latency import CameraLatency
from saltus.effects.depth_bias import DepthBias
from saltus.effects.depth_noise import DepthNoise
from saltus.effects.depth_scale import DepthScale
from saltus.effects.edge_holes import EdgeHoles
from saltus.effects.frame_drop import FrameDrop
from saltus.effects.hole_fill import HoleFill
from saltus.effects.offsets_and_factors import CameraFov, CameraHeight, CameraPitch
from saltus.effects.order import Order, SignalChain
from saltus.effects.range_clip import RangeClip
from saltus.effects.sample_and_hold import SampleAndHold
from saltus.effects.temporal_smear import TemporalSmear

TIMES_ONLY = (SampleAndHold, FrameDrop, CameraLatency)
"""Those that decide which image there is when, and leave its pixels as they are."""


@dataclass(frozen=True)
class ViewChain(SignalChain):
    """The effects on where a camera sits and how wide it looks."""

    order: ClassVar[Order] = (CameraPitch, CameraHeight, CameraFov)
    owner: ClassVar[str] = "a camera's view"


@dataclass(frozen=True)
class CameraChain(SignalChain):
    """What the sensor does, what gets lost on the way, what the driver makes of the rest, and when it arrives."""

    order: ClassVar[Order] = (
        SampleAndHold, DepthScale, DepthBias, DepthNoise, EdgeHoles, RangeClip, HoleFill, FrameDrop, TemporalSmear,
        CameraLatency,
    )  # fmt: skip
    owner: ClassVar[str] = "a camera"

    @property
    def changes_pixels(self) -> bool:
        """Whether images come out other than they went in."""
        return any(not isinstance(effect, TIMES_ONLY) for effect in self.effects)

    def next_arrival_s(self, time_s: float, state: tuple[Any, ...]) -> float:
        """When the next image arrives [s], for those who wait for it; infinite where none is under way."""
        pairs = zip(self.effects, state, strict=True)
        arrivals = [
            effect.next_arrival_s(time_s, memory) for effect, memory in pairs if isinstance(effect, CameraLatency)
        ]
        return min(arrivals, default=math.inf)
