"""Effects on when images come and which: the camera's rate, losses, smear over time, latency."""

import math
from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Array, namespace
from saltus.effects.effect import Effect, PerRobot, parameter, per_image, period
from saltus.effects.random_fields import draw_keys, uniform_numbers
from saltus.effects.signals import DepthImage, choose_images, nothing_yet

ROUNDING_S = 1e-9  # times that are meant to be equal may differ by rounding


@dataclass(frozen=True, kw_only=True)
class SampleAndHold(Effect[DepthImage], name="sample_and_hold", site="depth"):
    """The next image is the first that was exposed `period` or more after the last one.

    20 ms in the original's training.
    """

    period: float = parameter(unit="s", null=0.0, low=0.0, high=1.0)

    def apply(
        self, signal: DepthImage, time_s: float, state: DepthImage | None
    ) -> tuple[DepthImage, DepthImage]:
        """Returns the new image, or the one that is held; so is the state."""
        held = nothing_yet(signal) if state is None else state
        image = choose_images(signal.time_s >= held.time_s + self.period - ROUNDING_S, signal, held)
        return image, image


@dataclass(frozen=True, kw_only=True)
class FrameDrop(Effect[DepthImage], name="frame_drop", site="depth"):
    """A share `fraction` of the images is lost, each by itself.

    The image before stays the newest.
    """

    # 0.5 to 20 % on USB cameras under load
    fraction: PerRobot = parameter(unit="", null=0.0, low=0.0, high=1.0, sought=(0.0, 0.87))

    def init(
        self, batch: tuple[int, ...], rng: np.random.Generator
    ) -> tuple[Array, DepthImage | None]:
        """A key for each robot and no image."""
        return draw_keys(batch, rng), None

    def apply(
        self, signal: DepthImage, time_s: float, state: tuple[Array, DepthImage | None]
    ) -> tuple[DepthImage, tuple[Array, DepthImage | None]]:
        """Returns the image, or the last one that was not lost."""
        keys, last = state
        kept = namespace(signal.time_s).isfinite(self.arrival_s(signal.time_s, keys))
        image = choose_images(kept, signal, nothing_yet(signal) if last is None else last)
        return image, (keys, image)

    def arrival_s(self, captured_s: Array, keys: Array) -> Array:
        """When images that were captured at `captured_s` arrive [s],
        shape (...): at once, or never.
        """
        xp = namespace(captured_s)
        return xp.where(
            uniform_numbers(keys, captured_s) < self.value("fraction", captured_s),
            math.inf,
            captured_s,
        )


@dataclass(frozen=True, kw_only=True)
class TemporalSmear(Effect[DepthImage], name="temporal_smear", site="depth"):
    """Exponential smoothing: each pixel is `alpha` times the new depth
    and the rest the last one given out.

    Pixels that are invalid, or see nothing, in either image take the new value. An image that comes
    again changes nothing. librealsense's default is 0.4; `saltus.render.postfilter.TemporalFilter`
    is its filter with all its conditions.
    """

    # weight of the new frame
    alpha: PerRobot = parameter(unit="", null=1.0, low=0.01, high=1.0, sought=(0.04, 1.0))

    def apply(
        self, signal: DepthImage, time_s: float, state: DepthImage | None
    ) -> tuple[DepthImage, DepthImage | None]:
        """Smooths in time; the state is the last image given out."""
        if self.is_null():
            return signal, state
        if state is None:
            return signal, signal
        xp, depth, last = namespace(signal.depth), signal.depth, state.depth
        alpha = per_image(self.alpha, depth, xp)
        zero = xp.zeros_like(depth)
        both = (depth > 0.0) & (last > 0.0) & xp.isfinite(depth) & xp.isfinite(last)
        mixed = alpha * xp.where(both, depth, zero) + (1.0 - alpha) * xp.where(both, last, zero)
        mixed = xp.where(both, mixed, depth)
        again = (signal.time_s == state.time_s)[..., None, None]
        given = replace(signal, depth=xp.where(again, last, mixed))
        return given, given


CameraLatencyState = tuple[Array, tuple[tuple[DepthImage, Array], ...]]
"""Keys of the robots, and the images of the last samples with their arrivals [s], newest first."""


@dataclass(frozen=True, kw_only=True)
class CameraLatency(Effect[DepthImage], name="camera_latency", site="depth"):
    """An image can be seen from `latency` after its capture on,
    give or take `jitter` (uniform, per image).

    The output is the image with the newest capture among those that have arrived; before the first
    there is none. 50 ms with a D435i (paper: a sine of body height against the image).
    """

    latency: PerRobot = parameter(unit="s", null=0.0, low=0.0, high=0.5, sought=(0.0, 0.3))
    jitter: PerRobot = parameter(unit="s", null=0.0, low=0.0, high=0.1)
    dt_s: float = period(0.01)
    """Period at which images are asked for: that of the policy."""

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> CameraLatencyState:
        """A key for each robot and no image."""
        return draw_keys(batch, rng), ()

    def arrival_s(self, captured_s: Array, keys: Array) -> Array:
        """When images that were captured at `captured_s` arrive [s], shape (...)."""
        xp = namespace(captured_s)
        latency = self.value("latency", captured_s)
        if np.all(np.equal(self.jitter, 0.0)):
            return captured_s + latency
        delay = latency + self.value("jitter", captured_s) * (
            2.0 * uniform_numbers(keys, captured_s) - 1.0
        )
        return captured_s + xp.where(delay > 0.0, delay, 0.0)

    def apply(
        self, signal: DepthImage, time_s: float, state: CameraLatencyState
    ) -> tuple[DepthImage, CameraLatencyState]:
        """Returns the newest image that has arrived at `time_s`."""
        keys, past = state
        images = past
        # the same image may be shown again while the next one is awaited: it takes no place in
        # memory
        if not past or bool(namespace(signal.time_s).any(signal.time_s != past[0][0].time_s)):
            length = math.ceil(float(np.max(np.add(self.latency, self.jitter))) / self.dt_s) + 1
            images = ((signal, self.arrival_s(signal.time_s, keys)), *past)[:length]
        newest = nothing_yet(signal)
        for image, arrival_s in images[::-1]:
            arrived = arrival_s <= time_s + ROUNDING_S
            newest = choose_images(arrived & (image.time_s >= newest.time_s), image, newest)
        return newest, (keys, images)

    def next_arrival_s(self, time_s: float, state: CameraLatencyState) -> float:
        """When the next image arrives, of any robot's [s]; infinite where none is under way."""
        _, images = state
        arrivals = (arrival for _, arrival_s in images for arrival in np.ravel(arrival_s).tolist())
        return min((a for a in arrivals if a > time_s + ROUNDING_S), default=math.inf)
