"""A heightmap is read at a place that is not quite the right one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats, namespace
from saltus.effects.effect import Effect, parameter
from saltus.effects.signals import HeightQuery
from saltus.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class HeightmapShift(Effect[HeightQuery], name="heightmap_shift", site="heightmap"):
    """Heights are read `x` too far ahead along the robot's yaw and come out `z` too high,
    for a whole episode.

    To both, every robot adds its own draw, uniform within +-`x_range` and +-`z_range`, made in
    `init`. Training uses +-8 cm and +-5 cm (paper).
    """

    x: float = parameter(unit="m", null=0.0, low=-0.5, high=0.5)
    z: float = parameter(unit="m", null=0.0, low=-0.5, high=0.5)
    x_range: float = parameter(unit="m", null=0.0, low=0.0, high=0.5)
    z_range: float = parameter(unit="m", null=0.0, low=0.0, high=0.5)

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> Floats:
        """The shifts (x, z) of each robot [m], shape (*batch, 2)."""
        draw = rng.uniform(-1.0, 1.0, size=(*batch, 2))
        return np.array([self.x, self.z]) + draw * np.array([self.x_range, self.z_range])

    def apply(
        self, signal: HeightQuery, time_s: float, state: Floats
    ) -> tuple[HeightQuery, Floats]:
        """Moves the places and the heights."""
        shift = namespace(signal.x).astype(state, signal.x.dtype)
        moved = HeightQuery(x=signal.x + shift[..., 0:1], offset=signal.offset + shift[..., 1:2])
        return moved, state


def shift_of(effects: Sequence[Effect]) -> HeightmapShift:
    """The shift in the part "heightmap" of a profile; none where it has none."""
    return next(
        (effect for effect in effects if isinstance(effect, HeightmapShift)), HeightmapShift()
    )


def refuse_shift(effects: Sequence[Effect], who: str) -> None:
    """Raises `ConfigError` where true heights are to be shifted and `who`, e.g. "a camera",
    has no such heights.
    """
    if not shift_of(effects).is_null():
        raise ConfigError(
            f"heightmap_shift: it shifts true heights, and {who} cannot hold it; leave it out of "
            "the profile"
        )
