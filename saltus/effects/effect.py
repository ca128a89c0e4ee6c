"""What an effect is: one frozen value that changes one signal, used by plant, camera, training and real2sim alike."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Generic, Literal, TypeVar

import numpy as np

Site = Literal["command", "torque", "joint_state", "imu", "depth", "heightmap", "model"]

Signal = TypeVar("Signal")


def parameter(*, unit: str, null: float, low: float, high: float, default: float | None = None) -> Any:
    """Declares a parameter of an effect: its unit, bounds, and the value at which it has no effect."""
    metadata = {"unit": unit, "null": null, "low": low, "high": high}
    return field(default=null if default is None else default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Effect(ABC, Generic[Signal]):
    """One way in which hardware differs from the ideal.

    A subclass is a frozen dataclass whose fields are made with `parameter`. At its null values it returns its
    input unchanged, to the bit. `apply` is written once for numpy and torch and for any leading batch dimensions.
    """

    name: ClassVar[str]
    """Name in the schema of run logs, snake_case."""
    site: ClassVar[Site]

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> Any:
        """State before the first signal, for a batch of robots; None where the effect has no memory."""
        del batch, rng
        return None

    @abstractmethod
    def apply(self, signal: Signal, time_s: float, state: Any) -> tuple[Signal, Any]:
        """Returns the changed signal and the next state; changes neither argument."""

    def is_null(self) -> bool:
        """Whether every parameter has the value at which nothing changes."""
        return all(getattr(self, f.name) == f.metadata["null"] for f in fields(self) if "null" in f.metadata)
