"""Chains: effects in their order."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from saltus.effects.effect import Effect, Signal
from saltus.errors import ConfigError


def ordered(effects: tuple[Effect[Any], ...], order: tuple[str, ...], what: str) -> tuple[Effect[Any], ...]:
    """Sorts effects as `order` names them and leaves out those that are null.

    Raises:
        ConfigError: an effect that is given twice or not in `order`; `what` says of what, e.g. "a camera".
    """
    names = [effect.name for effect in effects]
    for name in names:
        if name not in order:
            raise ConfigError(f"'{name}' is no effect of {what}: those are {', '.join(order)}")
        if names.count(name) > 1:
            raise ConfigError(f"'{name}' is given {names.count(name)} times: {what} has each effect once")
    return tuple(sorted((e for e in effects if not e.is_null()), key=lambda e: order.index(e.name)))


@dataclass(frozen=True)
class Chain:
    """Effects in one fixed order, whatever the order in which they are given; those that are null are left out.

    Raises:
        ConfigError: an effect that is given twice, or that does not belong here.
    """

    effects: tuple[Effect[Any], ...] = ()

    order: ClassVar[tuple[str, ...]]
    owner: ClassVar[str]
    """For messages, e.g. "a camera"."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "effects", ordered(self.effects, self.order, self.owner))

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> tuple[Any, ...]:
        """State before the first signal, for `batch` robots."""
        return tuple(effect.init(batch, rng) for effect in self.effects)

    def _passed(self, signal: Signal, time_s: float, state: tuple[Any, ...]) -> tuple[Signal, tuple[Any, ...]]:
        """The signal after all effects, and their next states."""
        states = []
        for effect, memory in zip(self.effects, state, strict=True):
            signal, memory = effect.apply(signal, time_s, memory)
            states.append(memory)
        return signal, tuple(states)
