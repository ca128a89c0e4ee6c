"""From a checkpoint of a walking policy to its ONNX file, whose metadata say how to run it."""

from pathlib import Path
from typing import Any

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import Tensor, nn

from saltus.onnx_export import write_onnx
from saltus.policy.env.settings import LearningSettings
from saltus.policy.joints.policy import FIELD
from saltus.policy.training.checkpoint import (
    NETWORK,
    deployed_network,
    read_policy_checkpoint,
    training_config,
)
from saltus.policy.training.learner import GROUPS
from saltus.policy.walking.description import SIZE, description_of
from saltus.policy.walking.settings import WalkTrainSettings
from saltus.robots.loading import load_robot
from saltus.robots.robot import JOINTS

MODEL = "walk.onnx"
"""Name of the file in a training's folder."""


def make_walk_actor(config: LearningSettings) -> MLPModel:
    """An untrained actor."""
    like = TensorDict({"policy": torch.zeros(1, SIZE)}, batch_size=[1])
    gaussian = {
        "class_name": "rsl_rl.modules.distribution:GaussianDistribution",
        "init_std": config.first_std,
        "std_range": config.std_range,
    }
    hidden = list(config.hidden)
    actor = MLPModel(like, GROUPS, "actor", len(JOINTS), hidden, "elu", True, gaussian)
    with torch.no_grad():
        actor.mlp[-1].weight.mul_(0.01)  # it begins by standing
        actor.mlp[-1].bias.zero_()
    return actor


class DeployedWalk(nn.Module):
    """The walking actor's mean action, observation scaled before the network, as it is exported."""

    def __init__(self, checkpoint: dict[str, Any]) -> None:
        super().__init__()
        self.config = training_config(checkpoint, WalkTrainSettings)
        actor = make_walk_actor(self.config.learning)
        self.network = deployed_network(actor, checkpoint)

    def forward(self, observation: Tensor) -> Tensor:
        """Actions, shape (n, 12), for vectors of `Observer`, shape (n, SIZE)."""
        most = self.config.env.drives.most
        return torch.clamp(self.network(observation), -most, most)


def export_walk(checkpoint: Path, path: Path) -> None:
    """Writes the policy of a checkpoint as ONNX, whole or not at all.

    Raises:
        SaltusError: the checkpoint cannot be read or does not fit, or the file cannot be written.
    """
    state = read_policy_checkpoint(checkpoint)
    policy = DeployedWalk(state)
    write_onnx(
        policy,
        (torch.zeros(2, SIZE),),
        path,
        inputs=("observation",),
        outputs=("action",),
        metadata=metadata(policy.config, state),
        half_prefixes=(NETWORK,),
    )


def metadata(config: WalkTrainSettings, state: dict[str, Any]) -> dict[str, Any]:
    """The card: everything that somebody needs to run the file, and how it came about."""
    description = description_of(config.env, load_robot(config.robot))
    return {
        FIELD: description.to_toml(),
        **{key: state[key] for key in ("steps", "iteration", "seconds", "commit", "config")},
    }
