"""Networks that a run uses, and their names: the first half of their files' sha256."""

import hashlib
from pathlib import Path
from typing import Final, Literal

from saltus.config import UNNAMED, RunConfig
from saltus.errors import ConfigError, ModelError
from saltus.resources import shipped_file

ModelKind = Literal["heightmap", "policy", "scan"]
MODEL_ID_DIGITS = 16
WALKS = ("go1", "go2")
"""Robots for which a walking policy is shipped."""


SCAN: Final = "scan"
"""Name of the shipped network for any robot and grid, where the file of a model may be named."""


POLICIES = {"go1": "policy", "go2": "policy_go2"}
"""File, without its ending, of the policy that is shipped for a robot to jump by."""


def model_path(
    kind: ModelKind, given: str | Path | None = None, robot: str = UNNAMED["robot"]
) -> Path:
    """A model's ONNX file: the one that is given, which may be `SCAN`, else the shipped one.

    Args:
        kind: What the network does.
        given: A file, or `SCAN`; None for the shipped one.
        robot: Its name. Another robot than the Go1 sees by the scan's network; one that no policy
            is shipped for gets the Go1's, which refuses it.
    """
    if given is not None and str(given) != SCAN:
        return Path(given)
    if given is not None or (kind == "heightmap" and robot != UNNAMED["robot"]):
        kind = SCAN
    name = POLICIES.get(robot, kind) if kind == "policy" else kind
    return shipped_file(f"models/{name}.onnx")


def walking_path(robot: str, given: str | Path | None = None) -> Path:
    """ONNX or TOML file of a walking policy: the one that is given, else the shipped one.

    Args:
        robot: Name of the robot.
        given: A file.

    Raises:
        ConfigError: none is shipped for this robot.
    """
    if given is not None:
        return Path(given)
    if robot not in WALKS:
        raise ConfigError(
            f"--planner walking needs --policy-model FILE: walking policies "
            f"are shipped for {' and '.join(WALKS)}, none for '{robot}'; "
            "saltus policy walk train makes one"
        )
    return shipped_file(f"models/walk_{robot}.onnx")


def model_id(data: bytes) -> str:
    """The name of a model with these bytes."""
    return hashlib.sha256(data).hexdigest()[:MODEL_ID_DIGITS]


def network_names(run: RunConfig) -> dict[str, str]:
    """Name of each network that a run begins with, by its kind.

    Raises:
        ModelError: a file cannot be read.
        ConfigError: see `walking_path`.
    """
    walks = run.planner == "walking"
    paths = {}
    if run.heights == "predicted":
        kind: ModelKind = "scan" if walks else "heightmap"
        paths["heightmap"] = model_path(kind, run.heightmap_model, run.robot)
    if run.planner == "learned":
        paths["policy"] = model_path("policy", run.policy_model, run.robot)
    if walks:
        paths["walk"] = walking_path(run.robot, run.policy_model)
    try:
        return {kind: model_id(path.read_bytes()) for kind, path in paths.items()}
    except OSError as error:
        raise ModelError(f"cannot read model {error.filename}: {error.strerror}") from error
