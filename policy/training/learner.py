"""PPO of rsl-rl over a training environment:
one iteration at a time, saved to and restored from one file.
"""

from pathlib import Path
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from saltus.errors import SaltusError
from saltus.model_file import ModelFile
from saltus.policy.bounds import ACTIONS, ActionBounds
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.settings import LearningSettings
from saltus.policy.env.training_env import TrainingEnv, Transition
from saltus.policy.training.checkpoint import (
    exported_actor,
    read_policy_checkpoint,
    training_config,
    write_checkpoint,
)

FIRST_ACTION = (2.0, 1.0, 0.3, 0.0, 0.0, 0.0, 0.12, 0.0, 0.0, 0.12)
"""Action of an untrained policy: a slow bound that lifts its feet. From the middle of the ranges,
standing would have to be unlearnt first."""
_LIFTS = [ACTIONS.index("front_residual_z"), ACTIONS.index("rear_residual_z")]
FIRST_RATE = 1e-5
"""Learning rate with which an actor begins beside a critic that has learned; PPO adapts it from
there, its lowest. Adam's first steps move each weight by the whole rate, whatever the gradient."""
GROUPS = {"actor": ["policy"], "critic": ["privileged"]}
"""Which parts of an observation each network reads."""


class Learner:
    """Collects experience of training robots and learns from it; `distributed` is rank and number
    of processes that learn together.
    """

    def __init__(
        self,
        env: TrainingEnv,
        config: LearningSettings,
        actor: MLPModel,
        distributed: tuple[int, int] = (0, 1),
    ) -> None:
        self._env, self._config = env, config
        self._observation = observation_of(env.transition())
        device = str(env.device)
        self.world = distributed[1]
        self.robots = env.count * self.world
        """Robots of all processes."""
        self._together = self.world > 1
        group = (
            {"global_rank": distributed[0], "world_size": distributed[1]}
            if self._together
            else None
        )
        storage = RolloutStorage(
            "rl", env.count, config.horizon, self._observation, [actor.mlp[-1].out_features], device
        )
        self.ppo = PPO(
            actor,
            MLPModel(self._observation, GROUPS, "critic", 1, list(config.hidden), "elu", True),
            storage,
            num_learning_epochs=config.epochs,
            num_mini_batches=config.minibatches,
            clip_param=config.clip,
            gamma=config.gamma,
            lam=config.lam,
            entropy_coef=config.first_entropy,
            learning_rate=config.learning_rate,
            max_grad_norm=config.max_grad_norm,
            desired_kl=config.desired_kl,
            device=device,
            multi_gpu_cfg=group,
        )
        self.iteration = 0
        self.steps = 0
        """Environment steps so far, of all processes."""
        self._share_parameters()

    @torch.no_grad()
    def collect(self) -> None:
        """Steps the environment `horizon` times."""
        self._env.grow(float(self.steps))
        for _ in range(self._config.horizon):
            transition = self._env.step(self.act())
            self._observation = observation_of(transition)
            self.ppo.process_env_step(
                self._observation,
                transition.reward,
                transition.done,
                {"time_outs": transition.timed_out.float()},
            )
        self.ppo.compute_returns(self._observation)
        self.steps += self._config.horizon * self.robots

    def act(self) -> torch.Tensor:
        """Output of the network for the present observation,
        with exploration, shape (n, actions).
        """
        return self.ppo.act(self._observation)

    def learn(self) -> dict[str, float]:
        """Updates the networks; returns the mean losses."""
        config = self._config
        self.ppo.entropy_coef = self._settled(config.first_entropy, config.last_entropy)
        self.ppo.desired_kl = self._settled(config.desired_kl, config.last_kl)
        self.ppo.actor.requires_grad_(self.iteration >= config.critic_iterations)
        if 0 < self.iteration == config.critic_iterations:
            self.ppo.learning_rate = FIRST_RATE
        losses = self.ppo.update()
        self.iteration += 1
        # The statistics of the observations differ from process to process
        self._share_parameters()
        return losses

    @property
    def std(self) -> float:
        """Mean standard deviation of the action, in units of half its range."""
        return float(
            self.ppo.actor.distribution.std_param.detach().clamp(*self._config.std_range).mean()
        )

    def save(self, path: Path, extra: dict[str, object]) -> None:
        """Writes everything that is needed to go on, whole or not at all."""
        state = {
            **self.ppo.save(),
            **extra,
            "iteration": self.iteration,
            "steps": self.steps,
            "kind": self._env.memory.kind.to(torch.uint8).cpu(),
            "level": self._env.memory.level.to(torch.uint8).cpu(),
        }
        write_checkpoint(path, state)

    def begin_with(self, file: ModelFile, levels: int) -> None:
        """Takes the actor of an exported policy, and the steps that it has learned from.

        Critic and standard deviations stay new. Robots begin on any of so many levels: who can do
        the first ones need not climb them.

        Raises:
            ModelError: the file holds a network of another size.
        """
        self.ppo.actor.load_state_dict(exported_actor(self.ppo.actor, file))
        self.steps = int(file.field("steps"))
        self._env.grow(float(self.steps))
        level = torch.randint(levels, (self._env.count,), device=self._env.device)
        self._env.set_levels(level.float())
        self._observation = observation_of(self._env.transition())
        self._share_parameters()

    def load(self, path: Path) -> dict[str, Any]:
        """Continues from a file that `save` wrote, with any number of robots.

        Returns what it holds.

        Raises:
            SaltusError: the file is no checkpoint, or one of networks of another size.
        """
        state = read_policy_checkpoint(path, self._env.device)
        try:
            self.ppo.load(state, None, strict=True)
        except RuntimeError as error:
            raise SaltusError(
                f"{path} holds networks of another size than this training"
            ) from error
        self.iteration, self.steps = int(state["iteration"]), int(state["steps"])
        self._env.grow(float(self.steps))
        self._env.set_levels(_levels(state["kind"], state["level"], self._env.memory.kind))
        self._observation = observation_of(self._env.transition())
        self._share_parameters()
        return state

    def _settled(self, first: float, last: float) -> float:
        """A number that falls geometrically until iteration `entropy_iterations`."""
        share = min(1.0, self.iteration / self._config.entropy_iterations)
        return float(first ** (1.0 - share) * last**share)

    def _share_parameters(self) -> None:
        if self._together:
            self.ppo.broadcast_parameters()


class JumpLearner(Learner):
    """The learner of the jumping policy."""

    def __init__(
        self, env: JumpEnv, config: LearningSettings, distributed: tuple[int, int] = (0, 1)
    ) -> None:
        self._bounds = env.config.bounds
        actor = make_actor(observation_of(env.transition()), config, self._bounds)
        super().__init__(env, config, actor, distributed)

    def load(self, path: Path) -> dict[str, Any]:
        """Goes on from a checkpoint, as `Learner.load`; its actions may have had other bounds."""
        state = super().load(path)
        self._rebase(state)
        return state

    def begin_with(self, file: ModelFile, levels: int) -> None:
        """Begins with a policy's file, as `Learner.begin_with`; its actions may have had other
        bounds.
        """
        super().begin_with(file, levels)
        self._rebase({"config": file.field("config")})

    def _rebase(self, state: dict[str, Any]) -> None:
        old = training_config(state).env.bounds
        if old != self._bounds:
            rebase(self.ppo.actor, old, self._bounds)
            self._share_parameters()


def make_actor(observation: TensorDict, config: LearningSettings, bounds: ActionBounds) -> MLPModel:
    """An untrained actor; `observation` gives the size of its input."""
    gaussian = {
        "class_name": "rsl_rl.modules.distribution:GaussianDistribution",
        "init_std": config.first_std,
        "std_range": config.std_range,
    }
    actor = MLPModel(
        observation, GROUPS, "actor", len(ACTIONS), list(config.hidden), "elu", True, gaussian
    )
    last = actor.mlp[-1]
    with torch.no_grad():
        last.weight.mul_(0.01)
        last.bias.copy_(bounds.normalised(torch.tensor(FIRST_ACTION)))
        actor.distribution.std_param[_LIFTS] = config.first_lift_std
    return actor


def rebase(actor: MLPModel, old: ActionBounds, new: ActionBounds) -> None:
    """Makes an actor that was trained with other bounds ask for the same actions,
    as random as before.

    Its outputs are shares of ranges: new = a old + b for each action, which its last layer can do.
    """
    offset = new.normalised(old.denormalised(torch.zeros(len(ACTIONS))))
    scale = new.normalised(old.denormalised(torch.ones(len(ACTIONS)))) - offset
    last = actor.mlp[-1]
    scale, offset = scale.to(last.bias.device), offset.to(last.bias.device)
    with torch.no_grad():
        last.weight.mul_(scale[:, None])
        last.bias.mul_(scale).add_(offset)
        actor.distribution.std_param.mul_(scale)


def observation_of(transition: Transition) -> TensorDict:
    """Inputs of actor and critic as rsl-rl takes them."""
    return TensorDict(
        {"policy": transition.actor, "privileged": transition.critic},
        batch_size=[len(transition.actor)],
    )


def _levels(old_kind: torch.Tensor, old_level: torch.Tensor, kind: torch.Tensor) -> torch.Tensor:
    """Levels for robots of the given kinds, with the distribution
    that the old robots of each kind had.
    """
    level = torch.zeros(len(kind), device=kind.device)
    for k in kind.unique():
        known = old_level[old_kind == k].float().sort().values
        members = (kind == k).nonzero()[:, 0]
        if len(known) and len(members):
            place = torch.arange(len(members), device=kind.device) * len(known) // len(members)
            level[members] = known[place]
    return level
