"""Types of what a checkpoint of the heightmap network holds."""

from typing import Any, NotRequired, TypedDict

from torch import Tensor


class StartOrigin(TypedDict):
    """The network that a training began with."""

    sha256: str
    dataset: str
    update: int


class TrainingOrigin(TypedDict):
    """The making of a network: settings, data, and the network that it began with."""

    config: dict[str, Any]
    """The settings, as nested tables; of an exported model the seed and the network's sizes
    alone."""
    dataset: str
    start: StartOrigin | None
    update: NotRequired[int]
    """Updates by now, where an origin is told by itself."""


class CheckpointTable(TypedDict):
    """A checkpoint as it lies on disk."""

    origin: TrainingOrigin
    update: int
    model: dict[str, Tensor]
    optimiser: NotRequired[dict[str, object]]
    """Absent of an exported model."""
