"""Chains: effects in their order."""

from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np

from saltus.arrays import Array, namespace
from saltus.effects.effect import Effect, Signal, State, map_arrays
from saltus.errors import ConfigError

Order: TypeAlias = tuple[type[Effect], ...]


def ordered(effects: tuple[Effect, ...], order: Order, what: str) -> tuple[Effect, ...]:
    """Sorts effects as their classes stand in `order` and leaves out those that are null.

    Raises:
        ConfigError: an effect that is given twice or not in `order`; `what` says of what, e.g. "a
            camera".
    """
    names, known = [effect.name for effect in effects], [kind.name for kind in order]
    for name in names:
        if name not in known:
            raise ConfigError(f"'{name}' is no effect of {what}: those are {', '.join(known)}")
        if names.count(name) > 1:
            raise ConfigError(
                f"'{name}' is given {names.count(name)} times: {what} has each effect once"
            )
    return tuple(sorted((e for e in effects if not e.is_null()), key=lambda e: known.index(e.name)))


@dataclass(frozen=True)
class Chain:
    """Effects of one part of a robot in one fixed order, whatever the order in which they are
    given.

    Those that are null are left out.

    Raises:
        ConfigError: an effect that is given twice, or that does not belong here.
    """

    effects: tuple[Effect, ...] = ()

    order: ClassVar[Order]
    owner: ClassVar[str]
    """For messages, e.g. "a camera"."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "effects", ordered(self.effects, self.order, self.owner))

    @property
    def blank(self) -> tuple[None, ...]:
        """State before the first signal where no effect draws anything:
        for actuators, IMUs and bodies.
        """
        return (None,) * len(self.effects)

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> tuple[object, ...]:
        """State before the first signal, for `batch` robots."""
        return tuple(effect.init(batch, rng) for effect in self.effects)


def apply_effect(
    effect: Effect, signal: Signal, time_s: Array, memory: object, fresh: Array | None
) -> tuple[Signal, object]:
    """`effect.apply` with a blank memory for robots that are `fresh`,
    bool, shape (...); None where none is.
    """
    if fresh is not None and memory is not None:
        memory = chosen_of(fresh, effect.first(signal), memory)
    return effect.apply(signal, time_s, memory)


def chosen_of(robots: Array, new: State, old: State) -> State:
    """A state with the arrays of `new` for `robots`, bool, shape (...),
    and those of `old`, which is built alike, for the others.
    """

    def choose(one: Array, other: Array) -> Array:
        mask = robots.reshape(tuple(robots.shape) + (1,) * (one.ndim - robots.ndim))
        return namespace(one).where(mask, one, other)

    return map_arrays(choose, new, old)


@dataclass(frozen=True)
class SignalChain(Chain):
    """Effects on one signal, each applied to the result of the one before."""

    def step(
        self, signal: Signal, time_s: Array, state: tuple[object, ...], fresh: Array | None = None
    ) -> tuple[Signal, tuple[object, ...]]:
        """The signal, newest or repeated, after all effects at `time_s` in the run's clock,
        and their next states.

        Robots that are `fresh`, bool, shape (...), have had no signal before.
        """
        states = []
        for effect, memory in zip(self.effects, state, strict=True):
            signal, memory = apply_effect(effect, signal, time_s, memory, fresh)
            states.append(memory)
        return signal, tuple(states)

    def apply(self, signal: Signal) -> Signal:
        """The signal after all effects, of which none has a memory."""
        return self.step(signal, 0.0, self.blank)[0]
