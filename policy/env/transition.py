"""Between any training environment and what learns from it."""

from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class Transition:
    """Result of a step; nothing in it changes with the next step."""

    actor: Tensor
    """Inputs of the policy, after resets, shape (n, some)."""
    critic: Tensor
    """Inputs of the critic alone, shape (n, some)."""
    reward: Tensor
    """Shape (n,)."""
    done: Tensor
    """The episode is over and the next has begun, bool, shape (n,)."""
    timed_out: Tensor
    """It ended at the time limit or at the end of the course, which is no failure.

    Bool, shape (n,).
    """


class LearningEnv(Protocol):
    """A training environment, as far as a learner knows it."""

    count: int
    """Robots."""
    device: torch.device
    memory: Any
    """Its tensors, among them `kind` (int64) and `level` of each robot, shape (n,)."""

    def step(self, output: Tensor) -> Transition:
        """One step of the policy with the network's output, shape (n, actions)."""

    def transition(self) -> Transition:
        """The last one; before the first step, with the first observation."""

    def grow(self, steps: float) -> None:
        """Ranges are drawn from as after so many environment steps of all processes."""

    def set_levels(self, level: Tensor) -> None:
        """Starts every robot again on a course of the given level, shape (n,)."""
