"""From a trained network of the scan to the ONNX file that is deployed, and back."""

from pathlib import Path

import torch

from saltus.heightmap.scan.network_inputs import MEASURED, MEMORY, NUMBERS
from saltus.heightmap.scan.predictor import FORMAT, INPUTS, OUTPUTS
from saltus.heightmap.scan.training.scan_model import ScanModel, parameter_count
from saltus.heightmap.scan.training.settings import ScanTrainSettings
from saltus.onnx_export import round_to_half, write_onnx


def export_scan(model: ScanModel, settings: ScanTrainSettings, path: Path) -> None:
    """Writes the network with what feeds it:
    the settings of its map as TOML, names of planes and numbers.

    Weights of the coarsest blocks, most of all, are kept in half precision; the model's are rounded
    to it, in place, so that who judges it afterwards judges the file.
    """
    round_to_half(model.blocks)
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
            "numbers": NUMBERS, "seed": settings.seed, "parameters": parameter_count(model),
        }, half_prefixes=("blocks.",),
    )  # fmt: skip
