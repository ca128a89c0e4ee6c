"""From a checkpoint to the ONNX file that the planner process runs,
and from that to what drives on a device.
"""

from pathlib import Path

import numpy as np
import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import Tensor, nn

from saltus.errors import ModelError
from saltus.grid import HeightGrid, grid_metadata, load_grid
from saltus.model_file import ModelFile
from saltus.onnx_export import round_to_half, write_onnx
from saltus.policy.actor import FORMAT, PolicyActor
from saltus.policy.bounds import ACTIONS, ActionBounds
from saltus.policy.env.settings import JumpTrainSettings
from saltus.policy.policy_features import feature_layout, size_with
from saltus.policy.training.checkpoint import (
    NETWORK,
    deployed_network,
    exported_actor,
    read_policy_checkpoint,
    training_config,
)
from saltus.policy.training.learner import make_actor
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot


class DeployedPolicy(nn.Module):
    """The actor's mean action as values of a plan:
    observation scaled before the network, actions bounded after it.
    """

    def __init__(self, checkpoint: dict[str, object]) -> None:
        super().__init__()
        config = training_config(checkpoint)
        self.past_steps = config.env.past_steps
        self.grid: HeightGrid = load_grid(config.grid)
        """Grid of its heights."""
        self.size = size_with(self.grid, self.past_steps)
        actor = _actor(config)
        self.network = deployed_network(actor, checkpoint)
        self.bounds: ActionBounds = config.env.bounds
        self.robot: Robot = load_robot(config.robot)
        """For which it was trained."""

    def forward(self, features: Tensor) -> Tensor:
        """Values in the order of `ACTIONS`, shape (n, 10),
        for vectors of `with_past`, shape (n, size).
        """
        return self.bounds.clipped(self.bounds.denormalised(self.network(features)))


def export_policy(checkpoint: Path, path: Path) -> float:
    """Writes the policy of a checkpoint as ONNX, whole or not at all.

    Weights of its layers are kept in half precision and computed with in single, those that
    normalise observations stay in single.

    Returns:
        Greatest difference between torch and the file over random observations, as a share of each
        action's range.

    Raises:
        SaltusError: the checkpoint cannot be read or does not fit, or the file cannot be written.
    """
    state = read_policy_checkpoint(checkpoint)
    policy = DeployedPolicy(state)
    round_to_half(policy.network.get_submodule("mlp"))
    write_onnx(
        policy,
        (torch.zeros(2, policy.size),),
        path,
        inputs=("features",),
        outputs=("plan",),
        metadata=metadata(policy, state),
        half_prefixes=(f"{NETWORK}mlp.",),
    )
    return parity(policy, path)


def read_policy(path: Path) -> dict[str, object]:
    """Reads what `DeployedPolicy` is made of: a checkpoint, or,
    by its suffix, an ONNX file that `export_policy` wrote.

    Raises:
        SaltusError: the file is neither.
    """
    if path.suffix != ".onnx":
        return read_policy_checkpoint(path)
    file = ModelFile(path)
    if file.field("format") != FORMAT:
        raise ModelError(f"{path} is no motion policy")
    state = {"config": str(file.field("config"))}
    return state | {"actor_state_dict": exported_actor(_actor(training_config(state)), file)}


def _actor(config: JumpTrainSettings) -> MLPModel:
    like = TensorDict(
        {"policy": torch.zeros(1, size_with(load_grid(config.grid), config.env.past_steps))},
        batch_size=[1],
    )
    return make_actor(like, config.learning, config.env.bounds)


def metadata(policy: DeployedPolicy, state: dict[str, object]) -> dict[str, object]:
    """Metadata of the file; `saltus.policy.actor` refuses what does not fit."""
    return {
        "format": FORMAT,
        "robot": policy.robot.name,
        **grid_metadata(policy.grid),
        "features": feature_layout(policy.grid),
        "past_steps": list(policy.past_steps),
        "actions": list(ACTIONS),
        "low": list(policy.bounds.low),
        "high": list(policy.bounds.high),
        "swing_foot_z_range_m": policy.robot.swing_foot_z.tolist(),
        "steps": state["steps"],
        "iteration": state["iteration"],
        "seconds": state["seconds"],
        "commit": state["commit"],
        "config": state["config"],
    }


def parity(policy: DeployedPolicy, path: Path, count: int = 1000) -> float:
    """Greatest difference between torch and the file, as a share of each action's range."""
    rng = np.random.default_rng(0)
    given = rng.normal(size=(count, policy.size)).astype(np.float32)
    with torch.no_grad():
        expected = policy(torch.from_numpy(given)).numpy()
    span = np.array(policy.bounds.high) - np.array(policy.bounds.low)
    return float(
        np.max(np.abs(PolicyActor(policy.robot, policy.grid, path).values(given) - expected) / span)
    )
