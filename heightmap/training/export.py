"""From a trained network to the ONNX file that the service runs."""

from collections.abc import Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from saltus.depth_camera import DepthCamera
from saltus.grid import HeightGrid, grid_metadata
from saltus.heightmap.model import IMAGE_SHAPE, HeightmapModel, Normalisation
from saltus.heightmap.service.network import (
    FORMAT,
    INPUTS,
    OUTPUTS,
    HeightmapNetwork,
    camera_metadata,
)
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.heightmap.service.quantiles import INTERVAL90
from saltus.heightmap.service.sight import NetworkInputs
from saltus.onnx_export import round_to_half, write_onnx
from saltus.provenance import current_commit
from saltus.robots.loading import load_robot
from saltus.wire.topics import CAMERA_LATENCY_S


@dataclass(frozen=True, kw_only=True)
class ModelOrigin:
    """Origin of a model file: for which robot, grid and camera it was trained, and on what data."""

    robot: str
    """Name of the robot that it was trained on, or path of its model."""
    grid: HeightGrid
    """Grid of its heights."""
    camera: DepthCamera
    """Camera whose images it was trained on."""
    latency_s: float = CAMERA_LATENCY_S
    """How late these are."""
    warmup_frames: int
    """Measured, see `saltus.heightmap.training.validate.warmup_frames`."""
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


def export_heightmap(model: HeightmapModel, path: Path, origin: ModelOrigin) -> None:
    """Writes the network as ONNX with everything that is needed to use it,
    whole or not at all, and its checksum.

    Weights of its layers are kept in half precision; the model's are rounded to it, in place.
    Normalisation and the correction of intervals stay in single.
    """
    round_to_half(model.encoder, model.gru, model.head)
    write_onnx(
        _Step(model.cpu().eval()),
        _example(model),
        path,
        inputs=INPUTS,
        outputs=OUTPUTS,
        metadata=metadata(model, origin),
        half_prefixes=("model.encoder.", "model.gru.", "model.head."),
    )


def metadata(model: HeightmapModel, origin: ModelOrigin) -> dict[str, object]:
    """Metadata of the file; `saltus.heightmap.service.network` refuses what does not fit."""
    robot = origin.camera.mounted_on(load_robot(origin.robot))
    normalisation = {name: getattr(model, name).tolist() for name in Normalisation._fields}
    return {
        "format": FORMAT,
        "robot": robot.name,
        **grid_metadata(origin.grid),
        "camera": camera_metadata(robot),
        "depth_camera": origin.camera.record,
        "proprioception": list(PROPRIOCEPTION),
        "nominal_delay_s": origin.latency_s,
        "warmup_frames": origin.warmup_frames,
        "normalisation": normalisation,
        "dataset": origin.dataset,
        "commit": current_commit(),
        "seed": origin.seed,
    }


def parity(
    model: HeightmapModel,
    network: HeightmapNetwork,
    inputs: Iterable[NetworkInputs],
    reset_every: int = 170,
) -> float:
    """Greatest difference in a tick between the file and torch in double precision.

    Of heights [m], of halves of their 90 % intervals [m], and of the hidden state (no unit, -1 to
    1). Inputs are those of recurrent steps. Both begin each tick with the hidden state that the
    file's own run has come to; it is emptied after every `reset_every`. Two runs side by side would
    differ by rounding that grows through the GRU: after 3 to 40 further updates single precision in
    torch came to be up to 57 um off double precision, in the file 15 um.
    """
    exact, worst = _Step(deepcopy(model).double()), 0.0
    for step, given in enumerate(inputs):
        if step % reset_every == 0:
            hidden = np.zeros((1, network.hidden_size), np.float32)
        given = given._replace(hidden=hidden)
        found = network.tick(*given)
        tensors = [torch.from_numpy(np.asarray(value, np.float32)).double() for value in given]
        with torch.no_grad():
            height, std, state = (output.numpy() for output in exact(*tensors))
        differences = [
            np.abs(a - b).max()
            for a, b in (
                (found.height, height),
                (found.half_width_90, INTERVAL90 * std),
                (found.hidden, state),
            )
        ]
        worst = float(np.max([worst, *differences]))  # which a number that is none comes through
        hidden = found.hidden
    return worst


def random_inputs(
    model: HeightmapModel, rng: np.random.Generator, steps: int
) -> Iterator[NetworkInputs]:
    """Random inputs in the range of what occurs, each of one robot whose hidden state is empty."""
    mean, spread = model.proprioception_mean.numpy(), model.proprioception_std.numpy()
    for _ in range(steps):
        valid = rng.uniform(size=IMAGE_SHAPE[1:]) < rng.uniform(0.2, 1.0)
        image = np.stack([np.where(valid, rng.uniform(size=valid.shape), 1.0), valid]).astype(
            np.float32
        )
        features = (mean + spread * rng.normal(size=len(mean))).astype(np.float32)
        age_s, new, hidden = (
            rng.uniform(0.03, 0.2),
            rng.uniform() < 0.5,
            np.zeros((1, model.config.hidden)),
        )
        yield NetworkInputs(image[None], np.array([age_s]), np.array([new]), features[None], hidden)


def _example(model: HeightmapModel) -> tuple[Tensor, ...]:
    """Arguments of `_Step` for two robots."""
    columns = zip(*random_inputs(model, np.random.default_rng(0), 2), strict=True)
    return tuple(torch.from_numpy(np.concatenate(column).astype(np.float32)) for column in columns)
