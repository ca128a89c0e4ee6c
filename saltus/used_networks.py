"""Networks that a run uses, and their names: the first half of their files' sha256."""

import hashlib
from pathlib import Path
from typing import Literal

from saltus.config import RunConfig
from saltus.errors import ModelError
from saltus.resources import resource

ModelKind = Literal["heightmap", "policy", "scan"]
MODEL_ID_DIGITS = 16


SCAN = "scan"
"""Name of the shipped network for any robot and grid, where the file of a model may be named."""


def model_path(kind: ModelKind, given: str | Path | None = None) -> Path:
    """A model's ONNX file: the one that is given, which may be `SCAN`, else the shipped one."""
    if given is None or str(given) == SCAN:
        return resource(f"models/{SCAN if given else kind}.onnx")
    return Path(given)


def model_id(data: bytes) -> str:
    """The name of a model with these bytes."""
    return hashlib.sha256(data).hexdigest()[:MODEL_ID_DIGITS]


def models_of(run: RunConfig) -> dict[str, str]:
    """Name of each network that a run begins with, by its kind.

    Raises:
        ModelError: a file cannot be read.
    """
    walks = run.planner == "walking"
    paths = {}
    if run.heights == "predicted":
        paths["heightmap"] = model_path("scan" if walks else "heightmap", run.heightmap_model)
    if run.planner == "learned":
        paths["policy"] = model_path("policy", run.policy_model)
    if walks and run.policy_model is not None:
        paths["walk"] = Path(run.policy_model)
    try:
        return {kind: model_id(path.read_bytes()) for kind, path in paths.items()}
    except OSError as error:
        raise ModelError(f"cannot read model {error.filename}: {error.strerror}") from error
