"""Effects that change each image by itself, whatever came before."""

from abc import abstractmethod
from dataclasses import dataclass

from saltus.effects.effect import Effect, Signal, State


@dataclass(frozen=True, kw_only=True)
class SingleImageEffect(Effect[Signal], site="depth"):
    """An effect on images that has no memory."""

    def apply(self, signal: Signal, time_s: float, state: State) -> tuple[Signal, State]:
        """See `Effect.apply`."""
        del time_s
        return (signal if self.is_null() else self.changed(signal)), state

    @abstractmethod
    def changed(self, signal: Signal) -> Signal:
        """The image after the effect."""
