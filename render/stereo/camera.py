"""A stereo depth camera: true depth and what the second imager cannot see in,
the camera's depth out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeAlias

import numpy as np

from saltus.arrays import Images, Masks, Scalars
from saltus.config import with_changes
from saltus.depth_camera import DepthCamera
from saltus.effects.effect import Effect
from saltus.effects.signals import DepthImage
from saltus.render.postfilter import DepthUnit, HoleFilling, SpatialFilter, TemporalFilter
from saltus.render.stereo.edges import FlyingPixels, StereoEdgeHoles
from saltus.render.stereo.image import ARRAY_WINDOWS, Morphology, depth_of, stereo_image
from saltus.render.stereo.matching import (
    Background,
    BaselineOcclusion,
    DisparityNoise,
    DisparityStep,
    SearchRange,
    WeakSignal,
)
from saltus.render.stereo.optics import StereoOptics

StereoState: TypeAlias = tuple[Any, ...]
"""States of the effects, in the order of the camera."""


@dataclass(frozen=True, kw_only=True)
class StereoConfig:
    """The effects of a stereo camera in the order in which it makes them.

    The defaults are the D435i at 424x240.
    """

    background: Background = field(default_factory=lambda: Background(distance=6.0))
    baseline_occlusion: BaselineOcclusion = field(
        default_factory=lambda: BaselineOcclusion(rejected=1.0)
    )
    disparity_noise: DisparityNoise = field(default_factory=lambda: DisparityNoise(sigma=0.08))
    disparity_step: DisparityStep = field(default_factory=lambda: DisparityStep(step=1.0 / 32.0))
    search_range: SearchRange = field(
        default_factory=lambda: SearchRange(maximum=126.0, margin=0.0)
    )
    edge_holes: StereoEdgeHoles = field(default_factory=lambda: StereoEdgeHoles(fraction=0.1))
    weak_signal: WeakSignal = field(default_factory=lambda: WeakSignal(reach=10.0))
    flying_pixels: FlyingPixels = field(default_factory=lambda: FlyingPixels(fraction=0.2))
    depth_unit: DepthUnit = field(default_factory=lambda: DepthUnit(unit=0.001))
    hole_filling: HoleFilling = field(default_factory=lambda: HoleFilling(mode=2.0))
    spatial_filter: SpatialFilter = field(
        default_factory=lambda: SpatialFilter(magnitude=5.0, alpha=0.75, delta=1.0, holes_fill=4.0)
    )
    temporal_filter: TemporalFilter = field(
        default_factory=lambda: TemporalFilter(alpha=0.75, delta=1.0)
    )

    @classmethod
    def of(cls, camera: DepthCamera) -> "StereoConfig":
        """The errors of a camera; none of an ideal one.

        Raises:
            ConfigError: it names an effect or a parameter that there is not, or a value out of
                bounds.
        """
        return IDEAL_STEREO if camera.ideal else with_changes(cls(), camera.stereo, "stereo.")

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All of them, in order."""
        return tuple(getattr(self, f.name) for f in fields(self))

    def only(self, names: Sequence[str]) -> "StereoConfig":
        """A copy of the camera in which all effects but the named ones do nothing."""
        nulls: dict[str, Any] = {e.name: type(e)() for e in self.effects if e.name not in names}
        return replace(self, **nulls)


IDEAL_STEREO = StereoConfig().only(())
"""A camera that returns true depth."""
POST_FILTERS = ("hole_filling", "spatial_filter", "temporal_filter")
UNFILTERED = StereoConfig().only(
    [e.name for e in StereoConfig().effects if e.name not in POST_FILTERS]
)
"""A D435i without post-filters."""


class StereoCamera:
    """Turns true depth into what a stereo camera reports,
    for any leading batch dimensions, numpy or torch.

    `optics` are those of the images that it is given; `windows` look around pixels.
    """

    def __init__(
        self, config: StereoConfig, optics: StereoOptics, windows: Morphology = ARRAY_WINDOWS
    ) -> None:
        self.config = config
        self.optics = optics
        self._windows = windows
        active = [effect for effect in config.effects if not effect.is_null()]
        depth_site = (DepthUnit, HoleFilling, SpatialFilter, TemporalFilter)
        self._matching = [effect for effect in active if not isinstance(effect, depth_site)]
        self._depth = [effect for effect in active if isinstance(effect, depth_site)]

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> StereoState:
        """State before the first image, for a batch of cameras."""
        return tuple(effect.init(batch, rng) for effect in (*self._matching, *self._depth))

    def step(
        self, depth: Images, hidden: Masks, time_s: Scalars, state: StereoState
    ) -> tuple[DepthImage, StereoState]:
        """One exposure.

        Args:
            depth: true depth from the left imager, along the optical axis [m], infinite where
                nothing is hit. Shape (..., height, width).
            hidden: which of these points the right imager does not see, bool, same shape.
            time_s: capture time [s], float64, shape (...).
            state: what `init` or the last `step` returned.

        Returns:
            Depth as reported [m], 0 where invalid, and the next state.
        """
        states = []
        # Effects of the exposure go by its own time, which may differ from camera to camera
        now = 0.0
        memories = iter(state)
        signal = stereo_image(depth, hidden, time_s, self.optics, self._windows)
        for effect in self._matching:
            signal, memory = effect.apply(signal, now, next(memories))
            states.append(memory)
        image = DepthImage(depth=depth_of(signal) if self._matching else depth, time_s=time_s)
        for effect in self._depth:
            image, memory = effect.apply(image, now, next(memories))
            states.append(memory)
        return image, tuple(states)
