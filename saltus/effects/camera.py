"""From an image that is exposed now to the image that a robot has now: the effects of a camera in order."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from saltus.effects.camera_latency import CameraLatency
from saltus.effects.order import Chain
from saltus.effects.signals import CameraView, DepthImage

CAMERA_ORDER = (
    "sample_and_hold",
    "depth_scale",
    "depth_bias",
    "depth_noise",
    "edge_holes",
    "range_clip",
    "hole_fill",
    "frame_drop",
    "temporal_smear",
    "camera_latency",
)
"""What the sensor does, what gets lost on the way, what the driver makes of the rest, and when it arrives."""
TIMES_ONLY = ("sample_and_hold", "frame_drop", "camera_latency")
"""Those that decide which image there is when, and leave its pixels as they are."""
VIEW_ORDER = ("camera_pitch", "camera_height", "camera_fov")
"""What moves the camera that takes the images."""


@dataclass(frozen=True)
class ViewChain(Chain):
    """The effects on where a camera sits and how wide it looks."""

    order: ClassVar[tuple[str, ...]] = VIEW_ORDER
    owner: ClassVar[str] = "a camera's view"

    def moved(self, view: CameraView) -> CameraView:
        """The camera as it really is, for the camera that is claimed."""
        return self._passed(view, 0.0, (None,) * len(self.effects))[0]


@dataclass(frozen=True)
class CameraChain(Chain):
    """The effects on a camera's images."""

    order: ClassVar[tuple[str, ...]] = CAMERA_ORDER
    owner: ClassVar[str] = "a camera"

    @property
    def changes_pixels(self) -> bool:
        """Whether images come out other than they went in."""
        return any(effect.name not in TIMES_ONLY for effect in self.effects)

    def step(self, image: DepthImage, time_s: float, state: tuple[Any, ...]) -> tuple[DepthImage, tuple[Any, ...]]:
        """Returns the image that the robot has at `time_s`.

        Args:
            image: the newest that was exposed; the same one may come again.
            time_s: now, in the run's clock.
            state: what `init` or the last `step` returned.
        """
        return self._passed(image, time_s, state)

    def next_arrival_s(self, time_s: float, state: tuple[Any, ...]) -> float:
        """When the next image arrives [s], for those who wait for it; infinite where none is under way."""
        pairs = zip(self.effects, state, strict=True)
        arrivals = [
            effect.next_arrival_s(time_s, memory) for effect, memory in pairs if isinstance(effect, CameraLatency)
        ]
        return min(arrivals, default=math.inf)
