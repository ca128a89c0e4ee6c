"""A policy that commands joints: its network and its description, checked when loaded."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from saltus.arrays import Floats
from saltus.config import load_config
from saltus.errors import ConfigError, ModelError
from saltus.model_file import ModelFile
from saltus.policy.joints.description import PolicyDescription
from saltus.robots.robot import JOINTS, Robot

FIELD = "description"
"""Entry of an ONNX file's metadata that holds the description as TOML."""


class JointPolicy:
    """A policy of joint targets: network and description, from an ONNX file of ours, or from a TOML
    file that names one.

    Args:
        path: Of the file.

    Raises:
        ConfigError: the description is none.
        ModelError: the network cannot be run, or has other inputs and outputs.
    """

    def __init__(self, path: Path) -> None:
        if path.suffix == ".toml":
            self.description = load_config(PolicyDescription, path)
            if not self.description.model:
                raise ConfigError(f"{path}: 'model' is missing: name the ONNX file beside it")
            self.file = ModelFile(path.parent / self.description.model)
        else:
            self.file = ModelFile(path)
            self.description = _own_description(self.file)
        inputs, outputs = self.file.session.get_inputs(), self.file.session.get_outputs()
        if len(inputs) != 1:
            names = ", ".join(entry.name for entry in inputs)
            raise ModelError(f"{self.file.path}: it has the inputs {names}: a policy has one")
        self._input, self._output = inputs[0].name, outputs[0].name
        self._check()

    def refuse_other(self, robot: Robot) -> None:
        """Refuses to walk another robot; `ModelError`."""
        made_for = self.description.robot
        if made_for != robot.name:
            raise ModelError(
                f"{self.file.path}: it walks a '{made_for}', not a '{robot.name}': give --robot "
                f"{made_for}, or train one for this robot, saltus policy walk train"
            )

    def __call__(self, vectors: Floats) -> Floats:
        """Actions in the policy's order, shape (n, 12), for vectors of shape (n, size)."""
        given = np.ascontiguousarray(vectors, dtype=np.float32)
        said = np.asarray(self.file.session.run([self._output], {self._input: given})[0])
        most = self.description.action_clip
        return np.clip(said, -most, most)

    def _check(self) -> None:
        size = self.description.size
        try:
            said = self(np.zeros((1, size), np.float32))
        except Exception as error:  # the runtime has no common base class of its errors
            told = str(error).splitlines()[0]
            raise ModelError(
                f"{self.file.path}: it does not take the {size} numbers of its description: {told}"
            ) from error
        if said.shape != (1, len(JOINTS)) or not np.isfinite(said).all():
            raise ModelError(
                f"{self.file.path}: it says {said.shape[1:]} numbers, a robot has {len(JOINTS)} "
                "joints; or they are not finite"
            )


def _own_description(file: ModelFile) -> PolicyDescription:
    try:
        return replace(PolicyDescription.from_toml(file.field(FIELD)), model="")
    except ConfigError as error:
        raise ModelError(f"{file.path}: {error}") from error
