"""From a trained network to the ONNX file that the service runs."""

import json
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from heightmap.features import PROPRIOCEPTION
from heightmap.model import IMAGE_SHAPE, HeightmapModel, Normalisation
from heightmap.network import FORMAT, INPUTS, OUTPUTS, HeightmapNetwork, camera_metadata
from saltus.grid import HEIGHTMAP_X
from saltus.messages import Floats
from saltus.provenance import commit
from saltus.topics import CAMERA_LATENCY_S

OPSET = 17


@dataclass(frozen=True, kw_only=True)
class Origin:
    """What a model was made from."""

    warmup_frames: int
    """Measured, see `heightmap.validate.warmup_frames`."""
    dataset: str
    seed: int


class _Step(nn.Module):
    """One tick with plain tensors in and out."""

    def __init__(self, model: HeightmapModel) -> None:
        super().__init__()
        self.model = model

    def forward(
        self, image: Tensor, age: Tensor, new: Tensor, proprioception: Tensor, hidden: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        estimate, hidden = self.model.step(image, age, new, proprioception, hidden)
        return estimate.height, estimate.log_std.exp(), hidden


def export(model: HeightmapModel, path: Path, origin: Origin) -> None:
    """Writes the network as ONNX with everything that is needed to use it, whole or not at all."""
    temporary = path.with_name(f".{path.name}.partial")
    example = tuple(torch.from_numpy(value) for value in _example(model, np.random.default_rng(0), batch=2))
    with warnings.catch_warnings():
        # The exporter without onnxscript is announced to go away; the tests compare what it writes with torch.
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        torch.onnx.export(
            _Step(model.cpu().eval()),
            example,
            str(temporary),
            input_names=list(INPUTS),
            output_names=list(OUTPUTS),
            dynamic_axes={name: {0: "batch"} for name in (*INPUTS, *OUTPUTS)},
            opset_version=OPSET,
            dynamo=False,
        )
    file = onnx.load(temporary)
    onnx.helper.set_model_props(file, {name: json.dumps(value) for name, value in metadata(model, origin).items()})
    file.producer_name, file.doc_string = "saltus", ""
    onnx.checker.check_model(file)
    onnx.save(file, temporary)
    temporary.replace(path)


def metadata(model: HeightmapModel, origin: Origin) -> dict[str, Any]:
    """What the file says about itself; `heightmap.network` refuses what does not fit."""
    normalisation = {name: getattr(model, name).tolist() for name in Normalisation._fields}
    return {
        "format": FORMAT,
        "grid_m": HEIGHTMAP_X.tolist(),
        "camera": camera_metadata(),
        "proprioception": list(PROPRIOCEPTION),
        "nominal_delay_s": CAMERA_LATENCY_S,
        "warmup_frames": origin.warmup_frames,
        "normalisation": normalisation,
        "dataset": origin.dataset,
        "commit": commit(),
        "seed": origin.seed,
    }


def parity(model: HeightmapModel, path: Path, steps: int = 1000, reset_every: int = 170) -> float:
    """Greatest difference of any output between torch and the file, over recurrent steps with resets."""
    network = HeightmapNetwork(path)
    rng = np.random.default_rng(1)
    hidden = np.zeros(model.config.hidden, np.float32)
    torch_hidden = torch.zeros(1, model.config.hidden)
    worst = 0.0
    for step in range(steps):
        if step % reset_every == 0:
            hidden, torch_hidden = np.zeros_like(hidden), torch.zeros_like(torch_hidden)
        image, age, new, features, _ = _example(model, rng, batch=1)
        tick = network.tick(image[0], float(age[0]), bool(new[0]), features[0], hidden)
        arrays = [torch.from_numpy(value) for value in (image, age, new, features)]
        with torch.no_grad():
            estimate, torch_hidden = model.step(arrays[0], arrays[1], arrays[2], arrays[3], torch_hidden)
        expected = (estimate.height[0], estimate.log_std[0].exp(), torch_hidden[0])
        worst = max(worst, *(float(np.abs(a - b.numpy()).max()) for a, b in zip(tick, expected, strict=True)))
        hidden = tick.hidden
    return worst


def _example(model: HeightmapModel, rng: np.random.Generator, *, batch: int) -> tuple[Floats, ...]:
    """Random inputs as they occur: image, age, new, proprioception, hidden."""
    valid = rng.uniform(size=(batch, *IMAGE_SHAPE[1:])) < rng.uniform(0.2, 1.0)
    image = np.stack([np.where(valid, rng.uniform(size=valid.shape), 1.0), valid], 1)
    mean, std = model.proprioception_mean.numpy(), model.proprioception_std.numpy()
    return tuple(
        value.astype(np.float32)
        for value in (
            image,
            rng.uniform(0.03, 0.2, batch),
            rng.uniform(size=batch) < 0.5,
            mean + std * rng.normal(size=(batch, len(mean))),
            np.tanh(rng.normal(size=(batch, model.config.hidden))),
        )
    )
