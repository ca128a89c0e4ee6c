"""From a checkpoint to the ONNX file that the planner process runs.

`python -m saltus.policy.training.export CHECKPOINT FILE`
"""

import argparse
import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from tensordict import TensorDict
from torch import Tensor, nn

from saltus.config import from_toml
from saltus.controller.swing import SwingConfig
from saltus.errors import SaltusError
from saltus.grid import HEIGHTMAP_X
from saltus.model_file import put_model
from saltus.policy.actor import FORMAT, PolicyActor
from saltus.policy.bounds import ACTIONS, ActionBounds
from saltus.policy.env.settings import TrainConfig
from saltus.policy.features import LAYOUT, SIZE
from saltus.policy.training.learner import make_actor, read_checkpoint

OPSET = 17


class DeployedPolicy(nn.Module):
    """The actor's mean action as values of a plan: scaling of the observation before, bounds behind the network.

    Args:
        checkpoint: What `saltus.policy.training.learner.Learner.save` wrote.
    """

    def __init__(self, checkpoint: dict[str, Any]) -> None:
        super().__init__()
        config = from_toml(TrainConfig, checkpoint["config"])
        like = TensorDict({"policy": torch.zeros(1, SIZE)}, batch_size=[1])
        actor = make_actor(like, config.learning, config.env.bounds)
        try:
            actor.load_state_dict(checkpoint["actor_state_dict"])
        except RuntimeError as error:
            raise SaltusError(f"the checkpoint's network does not fit this program: {error}") from error
        self.network = actor.as_onnx(verbose=False).eval()
        self.bounds: ActionBounds = config.env.bounds

    def forward(self, features: Tensor) -> Tensor:
        """Values in the order of `ACTIONS`, shape (n, 10), for features of shape (n, SIZE)."""
        return self.bounds.clipped(self.bounds.denormalised(self.network(features)))


def export(checkpoint: Path, path: Path) -> float:
    """Writes the policy of a checkpoint as ONNX, whole or not at all.

    Returns:
        Greatest difference between torch and the file over random observations, as a share of each action's range.

    Raises:
        SaltusError: the checkpoint cannot be read or does not fit.
    """
    state = read_checkpoint(checkpoint)
    policy = DeployedPolicy(state)
    temporary = path.with_name(f".{path.name}.partial")
    with warnings.catch_warnings():
        # The exporter without onnxscript is announced to go away; what it writes is compared with torch below.
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        torch.onnx.export(
            policy,
            (torch.zeros(2, SIZE),),
            str(temporary),
            input_names=["features"],
            output_names=["plan"],
            dynamic_axes={"features": {0: "batch"}, "plan": {0: "batch"}},
            opset_version=OPSET,
            dynamo=False,
        )
    file = onnx.load(temporary)
    onnx.helper.set_model_props(file, {name: json.dumps(value) for name, value in metadata(policy, state).items()})
    file.producer_name, file.doc_string = "saltus", ""
    onnx.checker.check_model(file)
    onnx.save(file, temporary)
    put_model(temporary, path)
    return parity(policy, path)


def metadata(policy: DeployedPolicy, state: dict[str, Any]) -> dict[str, Any]:
    """What the file says about itself; `saltus.policy.actor` refuses what does not fit."""
    return {
        "format": FORMAT,
        "grid_m": HEIGHTMAP_X.tolist(),
        "features": LAYOUT,
        "actions": list(ACTIONS),
        "low": list(policy.bounds.low),
        "high": list(policy.bounds.high),
        "swing_foot_z_range_m": list(SwingConfig().foot_z_range_m),
        "steps": state["steps"],
        "iteration": state["iteration"],
        "seconds": state["seconds"],
        "commit": state["commit"],
        "config": state["config"],
    }


def parity(policy: DeployedPolicy, path: Path, count: int = 1000) -> float:
    """Greatest difference between torch and the file, as a share of each action's range."""
    rng = np.random.default_rng(0)
    given = rng.normal(size=(count, SIZE)).astype(np.float32)
    with torch.no_grad():
        expected = policy(torch.from_numpy(given)).numpy()
    span = np.array(policy.bounds.high) - np.array(policy.bounds.low)
    return float(np.max(np.abs(PolicyActor(path).values(given) - expected) / span))


def main(arguments: Sequence[str] | None = None) -> None:
    """Parses the command line and exports."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("file", type=Path)
    given = parser.parse_args(arguments)
    difference = export(given.checkpoint, given.file)
    print(f"{given.file}: differs from torch by at most {difference:.1e} of a range")  # noqa: T201


if __name__ == "__main__":
    main()
