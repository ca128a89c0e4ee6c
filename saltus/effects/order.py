"""Chains: effects in their order."""

from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np

from saltus.effects.effect import Effect, Signal
from saltus.errors import ConfigError

Order: TypeAlias = tuple[type[Effect[Any]], ...]


def ordered(effects: tuple[Effect[Any], ...], order: Order, what: str) -> tuple[Effect[Any], ...]:
    """Sorts effects as their classes stand in `order` and leaves out those that are null.

    Raises:
        ConfigError: an effect that is given twice or not in `order`; `what` says of what, e.g. "a camera".
    """
    names, known = [effect.name for effect in effects], [kind.name for kind in order]
    for name in names:
        if name not in known:
            raise ConfigError(f"'{name}' is no effect of {what}: those are {', '.join(known)}")
        if names.count(name) > 1:
            raise ConfigError(f"'{name}' is given {names.count(name)} times: {what} has each effect once")
    return tuple(sorted((e for e in effects if not e.is_null()), key=lambda e: known.index(e.name)))


@dataclass(frozen=True)
class Chain:
    """Effects in one fixed order, whatever the order in which they are given; those that are null are left out.

    Raises:
        ConfigError: an effect that is given twice, or that does not belong here.
    """

    effects: tuple[Effect[Any], ...] = ()

    order: ClassVar[Order]
    owner: ClassVar[str]
    """For messages, e.g. "a camera"."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "effects", ordered(self.effects, self.order, self.owner))

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> tuple[Any, ...]:
        """State before the first signal, for `batch` robots."""
        return tuple(effect.init(batch, rng) for effect in self.effects)


@dataclass(frozen=True)
class SignalChain(Chain):
    """Effects on one signal."""

    def step(self, signal: Signal, time_s: float, state: tuple[Any, ...]) -> tuple[Signal, tuple[Any, ...]]:
        """The signal, newest or repeated, after all effects at `time_s` in the run's clock, and their next states."""
        states = []
        for effect, memory in zip(self.effects, state, strict=True):
            signal, memory = effect.apply(signal, time_s, memory)
            states.append(memory)
        return signal, tuple(states)

    def apply(self, signal: Signal) -> Signal:
        """The signal after all effects, of which none has a memory."""
        return self.step(signal, 0.0, (None,) * len(self.effects))[0]
