"""From a trained network of the scan to the ONNX file that is deployed, and back."""

from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor

from saltus.heightmap.scan.planes import MEASURED, MEMORY, NUMBERS
from saltus.heightmap.scan.predictor import FORMAT, INPUTS, OUTPUTS
from saltus.heightmap.scan.training.model import ScanModel, parameters
from saltus.heightmap.scan.training.settings import ScanTrainSettings
from saltus.model_file import ModelFile
from saltus.onnx_export import write_onnx


def export(model: ScanModel, settings: ScanTrainSettings, path: Path) -> None:
    """Writes the network with what feeds it:
    the settings of its map as TOML, names of planes and numbers.

    Weights of the coarsest blocks, most of all, are kept in half precision; the model's are rounded
    to it, in place, so that who judges it afterwards judges the file.
    """
    with torch.no_grad():
        for weight in model.blocks.parameters():
            weight.copy_(weight.half())
    side = settings.map.side
    example = (
        torch.zeros(1, side, side), torch.zeros(1, len(MEASURED), side, side),
        torch.ones(1, len(MEMORY), side, side),
        torch.zeros(1, len(NUMBERS)),
    )  # fmt: skip
    write_onnx(
        model.eval(), example, path, inputs=INPUTS, outputs=OUTPUTS,
        metadata={
            "format": FORMAT, "map": settings.map.to_toml(), "measured": MEASURED, "memory": MEMORY,
            "numbers": NUMBERS, "seed": settings.seed, "parameters": parameters(model),
        }, half_prefix="blocks.",
    )  # fmt: skip


def read_weights(path: Path) -> dict[str, Tensor]:
    """Weights of an exported network by name, so that a training can go on from what is shipped.

    Raises:
        ModelError: the file is missing or damaged.
    """
    ModelFile(path)  # compares its checksum
    tensors = onnx.load_model(path).graph.initializer
    return {
        tensor.name: torch.from_numpy(numpy_helper.to_array(tensor).astype(np.float32))
        for tensor in tensors
    }
