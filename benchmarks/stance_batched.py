"""Difference of the batched stance solver of training from the exact one,
on what bounding robots ask for.

Robots bound over all terrains with random exploration around a slow bound. Force error (largest
component) [N] and excess of the tracking cost over the exact solution's, for the batched solver,
and for the closed form that is clipped afterwards (original).

    saltus bench stance_batched
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from benchmarks._command import Command
from benchmarks._measuring import percentiles
from saltus.arrays import Floats
from saltus.controller.stance import (
    ACCELERATION_WEIGHT,
    FORCE_WEIGHT,
    FRICTION,
    ExactSolver,
    StanceLegs,
    StanceQP,
)
from saltus.controller.stance_batched import BatchedSolver
from saltus.grid import LINE
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.settings import JumpEnvSettings
from saltus.policy.training.learner import FIRST_ACTION
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.sim.cpu_engine import CpuEngine
from saltus.terrain.course_batch import BOXES

SHOWN = (50, 90, 99)


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    robots: int = 100
    """Number of robots that bound side by side."""
    steps: int = 60
    """Steps of the policy, 10 ms each."""

    def measure(self) -> dict[str, Any]:
        qp = problems(self.robots, self.steps)
        robot = load_robot(DEFAULT_ROBOT)
        legs, exact = StanceLegs(robot), ExactSolver(robot).solve(qp)
        figures: dict[str, Any] = {"problems": len(exact)}
        for name, force in (
            ("batched", BatchedSolver(robot).solve(qp)),
            ("clipped", clipped(qp, robot)),
        ):
            excess = legs.tracking_cost(qp, force) - legs.tracking_cost(qp, exact)
            figures[f"{name}_force_error_n"] = percentiles(
                np.abs(force - exact).max(axis=-1), SHOWN
            )
            figures[f"{name}_excess_cost"] = percentiles(excess, SHOWN)
        return {**figures, "exact_cost": percentiles(legs.tracking_cost(qp, exact), SHOWN)}


def problems(robots: int, steps: int) -> StanceQP:
    """Returns what the controllers of exploring robots ask for."""
    torch.manual_seed(0)
    robot = load_robot(DEFAULT_ROBOT)
    solver = ProblemRecorder(robot)
    env = JumpEnv(CpuEngine(robot, robots, BOXES), JumpEnvSettings(), LINE, seed=0, solver=solver)
    output = env.config.bounds.normalised(torch.tensor([FIRST_ACTION]))
    for _ in range(steps):
        env.step(output + 0.4 * torch.randn(robots, output.shape[1]))
    return solver.every()


class ProblemRecorder:
    """A batched solver that keeps every hundredth problem."""

    def __init__(self, robot: Robot) -> None:
        self._solver = BatchedSolver(robot)
        self._kept: list[StanceQP] = []
        self._calls = 0

    def solve(self, qp: StanceQP) -> torch.Tensor:
        """Solves."""
        if self._calls % 10 == 0:
            self._kept.append(qp)
        self._calls += 1
        forces: torch.Tensor = self._solver.solve(qp)
        return forces

    def every(self) -> StanceQP:
        """The problems that were kept, in numpy."""
        names = ("hessian", "gradient", "contact", "model", "target")
        joined = {name: torch.cat([getattr(qp, name) for qp in self._kept]) for name in names}
        arrays = {
            name: a.numpy() if name == "contact" else a.double().numpy()
            for name, a in joined.items()
        }
        standing = arrays["contact"].any(axis=-1)
        return StanceQP(**{name: array[standing] for name, array in arrays.items()})


def clipped(qp: StanceQP, robot: Robot) -> Floats:
    """The closed form without constraints, then fz clipped and fx, fy scaled into the cone."""
    root = np.sqrt(np.array(ACCELERATION_WEIGHT))
    A = (qp.model * root).swapaxes(-1, -2) * np.repeat(qp.contact, 3, -1)[:, None]
    right = A.swapaxes(-1, -2) @ (qp.target * root)[..., None]
    force = np.linalg.solve(A.swapaxes(-1, -2) @ A + FORCE_WEIGHT * np.eye(12), right).reshape(
        -1, 4, 3
    )
    fz = np.clip(force[..., 2], *robot.foot_force) * qp.contact
    scale = np.minimum(1.0, FRICTION * fz / (np.linalg.norm(force[..., :2], axis=-1) + 1e-3))
    return np.concatenate([force[..., :2] * scale[..., None], fz[..., None]], -1).reshape(-1, 12)
