"""Types of what a checkpoint of the heightmap network holds.

Reads the weights of an exported heightmap network back,
so that training can go on from what is shipped.
"""

from pathlib import Path
from typing import Any, NotRequired, TypedDict

import torch
from torch import Tensor

from saltus.errors import ModelError
from saltus.model_file import ModelFile
from saltus.onnx_export import weights_of


class StartOrigin(TypedDict):
    """The earlier network that a training began with."""

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
    """The contents of a checkpoint's file."""

    origin: TrainingOrigin
    update: int
    model: dict[str, Tensor]
    optimiser: NotRequired[dict[str, object]]
    """Absent of an exported model."""


_PREFIX = "model."  # of the network within what `saltus.heightmap.training.export` writes


def read_exported(path: Path) -> CheckpointTable:
    """Reads an ONNX file as a table like that of a checkpoint, without the state of the optimiser.

    Args:
        path: A file of `saltus heightmap export`, under any name.

    Returns:
        "origin" (dataset, seed and the sizes of the network), "update" (0: none since it was
        exported) and "model" (its tensors by name).

    Raises:
        ModelError: the file is missing, damaged, or no heightmap network.
    """
    told = ModelFile(path)
    weights = {
        name.removeprefix(_PREFIX): tensor
        for name, tensor in weights_of(told).items()
        if name.startswith(_PREFIX)
    }
    try:
        outputs = {name: len(weights[f"{name}.weight"]) for name in _layers(weights)}
        head = [outputs[name] for name in sorted(outputs) if name.startswith("head.")]
        channels = [outputs[name] for name in sorted(outputs) if name.startswith("encoder.")]
        hidden = weights["gru.weight_hh_l0"].shape[1]
    except KeyError as error:
        raise ModelError(f"{path} is no heightmap network: '{error.args[0]}' is missing") from error
    # The last layer is the output
    sizes = {
        "channels": channels,
        "hidden": hidden,
        "head": head[:-1],
    }
    config = {"seed": told.field("seed"), "model": sizes}
    return {
        "origin": {"config": config, "dataset": told.field("dataset"), "start": None},
        "update": 0,
        "model": weights,
    }


def _layers(weights: dict[str, torch.Tensor]) -> list[str]:
    """Names of the layers of encoder and head."""
    return [
        name.removesuffix(".weight")
        for name in weights
        if name.endswith(".weight") and name.startswith(("encoder.", "head."))
    ]
