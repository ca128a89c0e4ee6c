"""From an image that is exposed now to the image that a robot has now:
where the camera looks, and its effects in order.
"""

import math
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np

from saltus.arrays import Array
from saltus.effects.depth_errors import (
    DepthBias,
    DepthNoise,
    DepthScale,
    EdgeHoles,
    HoleFill,
    RangeClip,
)
from saltus.effects.effect import Effect, PerRobot, Signal, parameter
from saltus.effects.image_delivery import CameraLatency, FrameDrop, SampleAndHold, TemporalSmear
from saltus.effects.signal_chain import Order, SignalChain
from saltus.effects.signals import CameraView, DepthImage, choose_images, nothing_yet
from saltus.wire.topics import CAMERA_LATENCY_S


@dataclass(frozen=True, kw_only=True)
class CameraPitch(Effect[CameraView], name="camera_pitch", site="view"):
    """The camera is turned by `offset` about the trunk's left axis, nose down positive."""

    # 0.5 to 3 degrees on real robots
    offset: PerRobot = parameter(
        unit="rad", null=0.0, low=-0.5, high=0.5, sought=(-0.2, 0.2), adds_to="pitch"
    )


@dataclass(frozen=True, kw_only=True)
class CameraHeight(Effect[CameraView], name="camera_height", site="view"):
    """The optical centre is `offset` higher in the trunk's frame."""

    # 5 to 20 mm on real robots
    offset: PerRobot = parameter(
        unit="m", null=0.0, low=-0.3, high=0.3, sought=(-0.1, 0.1), adds_to=("position", 2)
    )


@dataclass(frozen=True, kw_only=True)
class CameraFov(Effect[CameraView], name="camera_fov", site="view"):
    """The tangent of each pixel's true angle
    to the optical axis is `scale` times the claimed one.
    """

    # 1 to 3 % on real robots; mistakes in cropping and resizing are the usual cause
    scale: PerRobot = parameter(
        unit="", null=1.0, low=0.5, high=2.0, sought=(0.8, 1.25), scales="tangent_scale"
    )


NOMINAL_LATENCY = CameraLatency(latency=CAMERA_LATENCY_S)
"""The latency of a D435i (paper)."""
CameraState: TypeAlias = tuple[Any, ...]
"""States of the effects, in the order of the chain."""


@dataclass(frozen=True)
class ViewChain(SignalChain):
    """The effects on where a camera sits and how wide it looks."""

    order: ClassVar[Order] = (CameraPitch, CameraHeight, CameraFov)
    owner: ClassVar[str] = "a camera's view"


@dataclass(frozen=True)
class CameraChain(SignalChain):
    """Effects of the sensor, of losses on the way, of the driver, and of the time of arrival."""

    order: ClassVar[Order] = (
        SampleAndHold, DepthScale, DepthBias, DepthNoise, EdgeHoles, RangeClip, HoleFill, FrameDrop,
        TemporalSmear,
        CameraLatency,
    )  # fmt: skip
    owner: ClassVar[str] = "a camera"

    def step(
        self, signal: Signal, time_s: float, state: CameraState, fresh: Array | None = None
    ) -> tuple[Signal, CameraState]:
        """The newest images that have arrived at `time_s`,
        when the newest that were exposed are `signal`.

        Robots that are `fresh`, bool, shape (...), have had no image before this one.
        """
        return super().step(signal, time_s, state if fresh is None else _forgotten(state, fresh))

    @property
    def taken(self) -> "CameraChain":
        """All that happens to an image until the camera gives it out; then it travels."""
        return CameraChain(
            tuple(effect for effect in self.effects if not isinstance(effect, CameraLatency))
        )

    @property
    def carried(self) -> "CameraChain":
        """The effects on an image that a camera has given out, on its way."""
        return CameraChain(
            tuple(effect for effect in self.effects if isinstance(effect, CameraLatency))
        )

    @property
    def latency(self) -> CameraLatency:
        """How long it travels then."""
        late = [effect for effect in self.effects if isinstance(effect, CameraLatency)]
        return late[0] if late else CameraLatency()

    def film(
        self, depth: Array, captured_s: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Passes all images of one camera through the chain.

        Args:
            depth: As exposed, shape (n, height, width).
            captured_s: When [s], ascending, shape (n,).
            rng: Of what effects draw.

        Returns:
            The images as given out, and when they arrive [s], shape (n,): infinite for those that
            never do.
        """
        state, taken = self.init((), rng), self.taken
        given, arrival_s, memory = depth.copy(), captured_s.copy(), state[: len(taken.effects)]
        for i, time_s in enumerate(captured_s):
            exposed = DepthImage(depth=depth[i], time_s=np.asarray(time_s))
            image, memory = taken.step(exposed, time_s, memory)
            given[i] = image.depth
            if image.time_s != time_s:
                arrival_s[i] = math.inf
        return given, self.arrival_s(arrival_s, state)

    def arrival_s(self, captured_s: Array, state: CameraState) -> Array:
        """When images that were captured at `captured_s` arrive [s],
        shape (n,): infinite for those that are lost.
        """
        for effect, memory in zip(self.effects, state, strict=True):
            if isinstance(effect, FrameDrop | CameraLatency):
                captured_s = effect.arrival_s(captured_s, memory[0])
        return captured_s

    def next_arrival_s(self, time_s: float, state: CameraState) -> float:
        """When the next image arrives [s], for those who wait for it.

        Infinite where none is under way.
        """
        return (
            math.inf if self.latency.is_null() else self.latency.next_arrival_s(time_s, state[-1])
        )


def _forgotten(memory: Any, robots: Array) -> Any:
    """A state in which `robots`, bool, shape (...), have had no image."""
    if isinstance(memory, tuple):
        return tuple(_forgotten(part, robots) for part in memory)
    return (
        choose_images(~robots, memory, nothing_yet(memory))
        if isinstance(memory, DepthImage)
        else memory
    )


def drawn_around(
    effects: tuple[Effect, ...],
    *,
    latency_s: PerRobot = CAMERA_LATENCY_S,
    jitter_s: PerRobot = 0.0,
    loss: PerRobot = 0.0,
) -> tuple[Effect, ...]:
    """The effects of cameras of which something is drawn,
    each one number or one a robot, shape (n,).

    Args:
        effects: What is known of the cameras. Without a `CameraLatency` images still come at once.
        latency_s: As drawn for a camera whose images are `CAMERA_LATENCY_S` late; another's moves
            by the difference.
        jitter_s: In addition.
        loss: Share of images that are lost in addition.
    """
    if np.any(loss) and not any(isinstance(effect, FrameDrop) for effect in effects):
        effects = (*effects, FrameDrop())
    return tuple(_moved(effect, latency_s - CAMERA_LATENCY_S, jitter_s, loss) for effect in effects)


def _moved(effect: Effect, latency_s: PerRobot, jitter_s: PerRobot, loss: PerRobot) -> Effect:
    if isinstance(effect, FrameDrop):
        return effect.moved(fraction=loss)
    if isinstance(effect, CameraLatency):
        comes_late = np.not_equal(effect.latency, 0.0) | np.not_equal(effect.jitter, 0.0)
        return effect.moved(latency=comes_late * latency_s, jitter=comes_late * jitter_s)
    return effect
