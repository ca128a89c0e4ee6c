"""From a checkpoint to the ONNX file that the planner process runs."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor, nn

from saltus.errors import SaltusError
from saltus.grid import HEIGHTMAP_X
from saltus.onnx_export import write_onnx
from saltus.policy.actor import FORMAT, PolicyActor
from saltus.policy.bounds import ACTIONS, ActionBounds
from saltus.policy.features import LAYOUT, size_with
from saltus.policy.training.checkpoint import config_of, read_checkpoint
from saltus.policy.training.learner import make_actor
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot


class DeployedPolicy(nn.Module):
    """The actor's mean action as values of a plan: observation scaled before the network, actions bounded after it."""

    def __init__(self, checkpoint: dict[str, Any]) -> None:
        super().__init__()
        config = config_of(checkpoint)
        self.past_steps = config.env.past_steps
        self.size = size_with(self.past_steps)
        like = TensorDict({"policy": torch.zeros(1, self.size)}, batch_size=[1])
        actor = make_actor(like, config.learning, config.env.bounds)
        try:
            actor.load_state_dict(checkpoint["actor_state_dict"])
        except RuntimeError as error:
            raise SaltusError("the checkpoint's network does not fit this program: train the policy again") from error
        self.network = actor.as_onnx(verbose=False).eval()
        self.bounds: ActionBounds = config.env.bounds
        self.robot: Robot = load_robot(config.robot)
        """For which it was trained."""

    def forward(self, features: Tensor) -> Tensor:
        """Values in the order of `ACTIONS`, shape (n, 10), for vectors of `with_past`, shape (n, size)."""
        return self.bounds.clipped(self.bounds.denormalised(self.network(features)))


def export(checkpoint: Path, path: Path) -> float:
    """Writes the policy of a checkpoint as ONNX, whole or not at all.

    Returns:
        Greatest difference between torch and the file over random observations, as a share of each action's range.

    Raises:
        SaltusError: the checkpoint cannot be read or does not fit, or the file cannot be written.
    """
    state = read_checkpoint(checkpoint)
    policy = DeployedPolicy(state)
    write_onnx(
        policy,
        (torch.zeros(2, policy.size),),
        path,
        inputs=("features",),
        outputs=("plan",),
        metadata=metadata(policy, state),
    )
    return parity(policy, path)


def metadata(policy: DeployedPolicy, state: dict[str, Any]) -> dict[str, Any]:
    """What the file says about itself; `saltus.policy.actor` refuses what does not fit."""
    return {
        "format": FORMAT,
        "robot": policy.robot.name,
        "grid_m": HEIGHTMAP_X.tolist(),
        "features": LAYOUT,
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
    return float(np.max(np.abs(PolicyActor(policy.robot, path).values(given) - expected) / span))
