"""Parts that every kind of run has: effects of a certain size at a certain place,
and a scene that shows them.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_effects.robot import Floats

ShapeDraw = Callable[[np.random.Generator], dict[str, float]]


def _none(rng: np.random.Generator) -> dict[str, float]:
    del rng
    return {}


def draw_sign(rng: np.random.Generator) -> dict[str, float]:
    """Shape of an effect that goes either way."""
    return {"sign": float(rng.choice([-1, 1]))}


@dataclass(frozen=True, kw_only=True)
class Family:
    """Sizes that an effect can have."""

    usual: float
    """Where the search for one sigma starts."""
    largest: float
    shape: ShapeDraw = _none


@dataclass(frozen=True, kw_only=True)
class Setting:
    """One effect of one size at one place."""

    effect: str
    size: float
    """0 is absent; a coordinate in which a small residual grows in proportion."""
    where: tuple[str, ...]
    """Joints, or "camera", "trunk", "feet", "imu"."""
    shape: dict[str, float] = field(default_factory=dict)
    """Further choices of the effect: a sign, the place of a knee."""

    def sized(self, size: float) -> "Setting":
        """The same effect in another size."""
        return replace(self, size=size)


class Scene(ABC):
    """A rig and a motion: simulates what its sensors read when some effects are there.

    A scene's seed draws rig, motion and noise; with `tuning` motions and noise are those of the set
    that methods are tuned on.

    Attributes:
        families: Sizes of all effects by their names.
        library: Names of the effects of the schema that this kind of log can show.
        outside: Names of effects that no library has.
        group: Segment and signal to which each entry of a response belongs, as one number, shape
            (m,).
        places: Name of the joint, or of the sensor, to which each entry of a response belongs,
            shape (m,).
        nuisances: What a response can differ by without any effect, as nobody claims it: rows at
            the largest amount that it can have, in either direction; shape (k, m).
    """

    families: Mapping[str, Family]
    library: tuple[str, ...]
    outside: tuple[str, ...]
    group: NDArray[np.int64]
    places: NDArray[np.str_]
    nuisances: Floats
    sizing_rounds: int = 9
    """Rounds of the search for the one-sigma sizes of the library: few where a simulation takes
    long."""

    def draw(self, effect: str, where: tuple[str, ...], rng: np.random.Generator) -> Setting:
        """An effect with a shape of its own and a size that is of the right order."""
        family = self.families[effect]
        return Setting(effect=effect, size=family.usual, where=where, shape=family.shape(rng))

    def place(self, effect: str, where: tuple[str, ...]) -> tuple[str, ...]:
        """Where an effect sits that is compared with another one at `where`."""
        del effect
        return where

    def largest(self, setting: Setting) -> float:
        """Largest size that a real robot could have."""
        return self.families[setting.effect].largest

    @abstractmethod
    def respond(self, variants: list[tuple[Setting, ...]]) -> Floats:
        """Readings of the sensors, without noise or with the same, in units of its sigma.

        Shape (variants, m).
        """

    @abstractmethod
    def parameters(self, setting: Setting) -> dict[str, float | list[list[float]]]:
        """The setting in the schema's parameters and units."""

    def parameters_at(self, setting: Setting) -> dict[str, dict[str, float | list[list[float]]]]:
        """The same for each place, of an effect that is not the same everywhere.

        Empty for others.
        """
        del setting
        return {}
