"""The exported network behind ONNX Runtime: checked when loaded, called once per tick."""

from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from heightmap.features import PROPRIOCEPTION
from saltus import depth, go1
from saltus.errors import ModelError
from saltus.grid import HEIGHTMAP_X
from saltus.messages import Floats
from saltus.model_file import ModelFile

FORMAT = "saltus-heightmap-1"
INPUTS = ("image", "age", "new", "proprioception", "hidden")
OUTPUTS = ("height", "std", "hidden_out")
_TOLERANCE = 1e-6  # of a number that went through text


def camera_metadata() -> dict[str, Any]:
    """The camera that a model is trained for; a model made for another one is refused."""
    return {
        **asdict(depth.MODEL_CAMERA),
        "range_m": depth.RANGE_M,
        "position_m": go1.CAMERA_POSITION.tolist(),
        "pitch_rad": go1.CAMERA_PITCH,
    }


class Inputs(NamedTuple):
    """What one tick of one robot is computed from, next to its memory."""

    image: Floats
    """Depth in [0, 1] and validity, shape (2, 48, 16)."""
    age_s: float
    new: bool
    features: Floats
    """See `heightmap.features`, shape (n,)."""


class Tick(NamedTuple):
    """What one call returns; not checked."""

    height: Floats
    """[m], shape (30,)."""
    std: Floats
    """[m], shape (30,)."""
    hidden: Floats
    """Shape (hidden size,)."""


class HeightmapNetwork:
    """A model file in ONNX Runtime, on one thread that sleeps between calls.

    Raises:
        ModelError: the file is unreadable, or one of its metadata or shapes does not fit this program; the message
            names the field.
    """

    def __init__(self, path: Path) -> None:
        file = ModelFile(path)
        self.model_id = file.model_id
        self._session = file.session
        _check_metadata(file)
        self.hidden_size = _checked_shapes(path, self._session)
        self.warmup_frames = int(file.field("warmup_frames"))

    def tick(self, image: Floats, age_s: float, new: bool, features: Floats, hidden: Floats) -> Tick:
        """Runs one tick of one robot: image (2, 48, 16), features (n,), hidden (hidden size,)."""
        age, fresh = np.array([age_s]), np.array([new])
        height, std, hidden_out = self.ticks(image[None], age, fresh, features[None], hidden[None])
        return Tick(height[0], std[0], hidden_out[0])

    def ticks(self, image: Floats, age_s: Floats, new: NDArray[np.bool_], features: Floats, hidden: Floats) -> Tick:
        """Runs one tick of many robots; all arrays, and those returned, have a leading dimension of robots."""
        one = np.float32
        feed = {
            "image": np.ascontiguousarray(image, one),
            "age": np.ascontiguousarray(age_s, one),
            "new": np.ascontiguousarray(new, one),
            "proprioception": np.ascontiguousarray(features, one),
            "hidden": np.ascontiguousarray(hidden, one),
        }
        return Tick(*self._session.run(OUTPUTS, feed))


def _check_metadata(file: ModelFile) -> None:
    """Refuses a model whose meaning differs from what this program would feed and read."""
    expected: dict[str, Any] = {
        "format": FORMAT,
        "grid_m": HEIGHTMAP_X.tolist(),
        "camera": camera_metadata(),
        "proprioception": list(PROPRIOCEPTION),
    }
    for name, wanted in expected.items():
        found = file.field(name)
        for where, left, right in _leaves(name, found, wanted):
            if not _same(left, right):
                raise ModelError(f"model {file.path} does not fit: '{where}' is {left!r}, this program needs {right!r}")
    for name, low, high in (("warmup_frames", 1, 500), ("nominal_delay_s", 0.0, 0.5)):
        found = file.field(name)
        if isinstance(found, bool) or not isinstance(found, int | float) or not low <= found <= high:
            raise ModelError(f"model {file.path} does not fit: '{name}' is {found!r}, expected {low} to {high}")
    if not isinstance(file.field("warmup_frames"), int):
        raise ModelError(f"model {file.path} does not fit: 'warmup_frames' must be a whole number")


def _leaves(where: str, found: Any, wanted: Any) -> list[tuple[str, Any, Any]]:
    """Pairs of values to compare; a structure that differs is one unequal pair."""
    if isinstance(wanted, dict) and isinstance(found, dict) and wanted.keys() == found.keys():
        return [leaf for key in wanted for leaf in _leaves(f"{where}.{key}", found[key], wanted[key])]
    if isinstance(wanted, list) and isinstance(found, list) and len(wanted) == len(found):
        pairs = enumerate(zip(found, wanted, strict=True))
        return [leaf for i, (left, right) in pairs for leaf in _leaves(f"{where}[{i}]", left, right)]
    return [(where, found, wanted)]


def _same(found: Any, wanted: Any) -> bool:
    if isinstance(wanted, float) and isinstance(found, int | float):
        return abs(found - wanted) <= _TOLERANCE
    return type(found) is type(wanted) and found == wanted


def _checked_shapes(path: Path, session: Any) -> int:
    """Size of the hidden state; every input and output must have the shape that the service feeds and reads."""
    shapes = {value.name: list(value.shape[1:]) for value in (*session.get_inputs(), *session.get_outputs())}
    hidden = shapes.get("hidden", [None])[0]
    points, features = len(HEIGHTMAP_X), len(PROPRIOCEPTION)
    wanted = {
        "image": [2, depth.MODEL_CAMERA.height, depth.MODEL_CAMERA.width],
        "age": [],
        "new": [],
        "proprioception": [features],
        "hidden": [hidden],
        "height": [points],
        "std": [points],
        "hidden_out": [hidden],
    }
    for name in (*INPUTS, *OUTPUTS):
        if shapes.get(name) != wanted[name]:
            raise ModelError(f"model {path} does not fit: '{name}' has shape {shapes.get(name)}, not {wanted[name]}")
    if not isinstance(hidden, int):
        raise ModelError(f"model {path} does not fit: the size of 'hidden' is not fixed")
    return hidden
