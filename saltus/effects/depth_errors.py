"""Effects on the values of a depth image: bias, scale, noise, holes, the end of the range."""

import math
from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Array, namespace
from saltus.depth import BASELINE_M, D435I
from saltus.effects.effect import Effect, PerRobot, parameter, per_image, pixels_within, setting
from saltus.effects.random_fields import draw_keys, gaussian_field
from saltus.effects.signals import DepthImage


@dataclass(frozen=True, kw_only=True)
class DepthScale(Effect[DepthImage], name="depth_scale", site="depth"):
    """Every depth is `scale` times the true one: baseline or focal length of the sensor off."""

    # 0.5 to 1 % at 0.5 to 1.5 m on a D435 (a published study of its distances)
    scale: PerRobot = parameter(unit="", null=1.0, low=0.5, high=2.0, sought=(0.8, 1.25))

    def apply(self, signal: DepthImage, time_s: float, state: None) -> tuple[DepthImage, None]:
        """Scales what is valid; 0 stays 0."""
        return replace(
            signal,
            depth=signal.depth * per_image(self.scale, signal.depth, namespace(signal.depth)),
        ), None


@dataclass(frozen=True, kw_only=True)
class DepthBias(Effect[DepthImage], name="depth_bias", site="depth"):
    """Every valid depth is `bias` larger than the true one; images in metres."""

    # 5 to 20 mm on a D435 (a published study of its distances)
    bias: PerRobot = parameter(unit="m", null=0.0, low=-0.3, high=0.3, sought=(-0.1, 0.1))

    def apply(self, signal: DepthImage, time_s: float, state: None) -> tuple[DepthImage, None]:
        """Adds to what is valid; what would come out at the lens or behind it becomes invalid."""
        xp = namespace(signal.depth)
        moved = signal.depth + per_image(self.bias, signal.depth, xp)
        valid = (signal.depth > 0.0) & (moved > 0.0)
        return replace(signal, depth=xp.where(valid, moved, xp.zeros_like(signal.depth))), None


@dataclass(frozen=True, kw_only=True)
class DepthNoise(Effect[DepthImage], name="depth_noise", site="depth"):
    """White noise of standard deviation z^2 `subpixel_sigma` / (f B) at each pixel;
    images in metres.
    """

    # 0.08 px in practice, 0.03 px at best (Intel on the D4xx)
    subpixel_sigma: PerRobot = parameter(unit="px", null=0.0, low=0.0, high=5.0)
    # of the image whose pixels `subpixel_sigma` counts (original: D435i at 424x240)
    focal_px: float = setting(D435I.fx, unit="px", low=1.0, high=1e4)

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> Array:
        """A key for each robot."""
        return draw_keys(batch, rng)

    def apply(self, signal: DepthImage, time_s: float, state: Array) -> tuple[DepthImage, Array]:
        """Adds noise to what is valid and finite; an image that comes again has the same noise."""
        if self.is_null():
            return signal, state
        xp, depth = namespace(signal.depth), signal.depth
        hit = (depth > 0.0) & xp.isfinite(depth)
        near = xp.where(hit, depth, xp.zeros_like(depth))
        sigma = per_image(self.subpixel_sigma, depth, xp) * (1.0 / (self.focal_px * BASELINE_M))
        noise = gaussian_field(state, signal.time_s, depth.shape[-2:], (1, 1), depth.dtype)
        noisy = near + sigma * near * near * noise
        noisy = xp.where(noisy > 0.0, noisy, xp.zeros_like(depth))
        return replace(signal, depth=xp.where(hit, noisy, depth)), state


JUMP = 0.08  # of the depth behind; a smaller step hides less than a pixel from the other imager


@dataclass(frozen=True, kw_only=True)
class EdgeHoles(Effect[DepthImage], name="edge_holes", site="depth"):
    """The `width` pixels to the left of every near edge are invalid,
    to the nearest pixel of the image.

    One number for all edges, as a run log can tell it; `saltus.render.stereo` has the physics, in
    which it grows with the step of disparity.
    """

    width: PerRobot = parameter(unit="px", null=0.0, low=0.0, high=100.0, sought=(0.0, 30.0))

    def apply(self, signal: DepthImage, time_s: float, state: None) -> tuple[DepthImage, None]:
        """Loses pixels."""
        xp, depth = namespace(signal.depth), signal.depth
        lost = xp.zeros_like(depth, dtype=xp.bool)
        behind, before = depth[..., :-1], depth[..., 1:]
        edge = (before > 0.0) & (before < (1.0 - JUMP) * behind)
        for k, is_wide in pixels_within(self.width, depth):
            reached = edge[..., k - 1 :]
            lost[..., : reached.shape[-1]] |= reached & is_wide
        return replace(signal, depth=xp.where(lost, xp.zeros_like(depth), depth)), None


@dataclass(frozen=True, kw_only=True)
class RangeClip(Effect[DepthImage], name="range_clip", site="depth"):
    """Depths beyond `max` read as `max`, "nothing within range" included; images in metres."""

    # original: 3 m
    max: PerRobot = parameter(unit="m", null=math.inf, low=0.05, high=100.0)

    def apply(self, signal: DepthImage, time_s: float, state: None) -> tuple[DepthImage, None]:
        """Clips."""
        xp, depth = namespace(signal.depth), signal.depth
        limit = per_image(self.max, depth, xp) + xp.zeros_like(depth)
        return replace(signal, depth=xp.where(depth > limit, limit, depth)), None


@dataclass(frozen=True, kw_only=True)
class HoleFill(Effect[DepthImage], name="hole_fill", site="depth"):
    """An invalid pixel takes the nearest valid value to its left within `reach` pixels,
    to the nearest pixel.

    One number, as a run log can tell it; `saltus.render.postfilter` has librealsense's filters
    themselves.
    """

    # librealsense's spatial filter offers 2 to 16 px, or no limit
    reach: PerRobot = parameter(unit="px", null=0.0, low=0.0, high=1000.0, sought=(0.0, 30.0))

    def apply(self, signal: DepthImage, time_s: float, state: None) -> tuple[DepthImage, None]:
        """Fills holes."""
        xp, depth = namespace(signal.depth), signal.depth
        filled = xp.asarray(depth, copy=True)
        for k, is_near in pixels_within(self.reach, depth):
            hole = (filled[..., k:] == 0.0) & is_near
            filled[..., k:] = xp.where(hole, depth[..., :-k], filled[..., k:])
        return replace(signal, depth=filled), None
