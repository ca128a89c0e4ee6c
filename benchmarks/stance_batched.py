"""How far the batched stance solver of training is from the exact one, on what bounding robots ask for.

    python benchmarks/stance_batched.py

Robots bound over all terrains with random exploration around a slow bound. Prints one JSON object: force error (largest
component) [N] and excess of the tracking cost over the exact solution's, each at p50, p90 and p99, for the batched
solver, and for the closed form that is clipped afterwards (original).
"""

import json
from typing import Any

import numpy as np
import torch

from saltus.controller.stance import ExactSolver, StanceConfig, StanceLegs, StanceQP
from saltus.controller.stance_batched import BatchedSolver
from saltus.policy.env.env import JumpEnv
from saltus.policy.env.settings import EnvConfig
from saltus.policy.training.learner import FIRST_ACTION
from saltus.sim.batch_engine import BatchEngine
from saltus.terrain.batch import BOXES
from saltus.wire.messages import Floats

ROBOTS, STEPS = 100, 60


def main() -> None:
    """Measures."""
    torch.manual_seed(0)
    solver = Recorder()
    env = JumpEnv(BatchEngine(ROBOTS, BOXES), EnvConfig(), seed=0, solver=solver)
    output = env.config.bounds.normalised(torch.tensor([FIRST_ACTION]))
    for _ in range(STEPS):
        env.step(output + 0.4 * torch.randn(ROBOTS, output.shape[1]))
    qp = solver.every()
    config = StanceConfig()
    legs, exact = StanceLegs(config), ExactSolver(config).solve(qp)
    report: dict[str, Any] = {"problems": len(exact)}
    for name, force in (("batched", BatchedSolver(config).solve(qp)), ("clipped", clipped(qp, config))):
        error = np.abs(force - exact).max(axis=-1)
        excess = legs.tracking_cost(qp, force) - legs.tracking_cost(qp, exact)
        report[name] = {
            "force_error_n": _percentiles(error),
            "excess_cost": _percentiles(excess),
        }
    report["exact_cost"] = _percentiles(legs.tracking_cost(qp, exact))
    print(json.dumps(report))


class Recorder:
    """A batched solver that keeps every hundredth problem."""

    def __init__(self) -> None:
        self._solver = BatchedSolver()
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
        arrays = {name: a.numpy() if name == "contact" else a.double().numpy() for name, a in joined.items()}
        standing = arrays["contact"].any(axis=-1)
        return StanceQP(**{name: array[standing] for name, array in arrays.items()})


def clipped(qp: StanceQP, config: StanceConfig) -> Floats:
    """The closed form without constraints, then fz clipped and fx, fy scaled into the cone."""
    root = np.sqrt(np.array(config.acceleration_weight))
    A = (qp.model * root).swapaxes(-1, -2) * np.repeat(qp.contact, 3, -1)[:, None]
    right = A.swapaxes(-1, -2) @ (qp.target * root)[..., None]
    force = np.linalg.solve(A.swapaxes(-1, -2) @ A + config.force_weight * np.eye(12), right).reshape(-1, 4, 3)
    fz = np.clip(force[..., 2], *config.force_z_range_n) * qp.contact
    scale = np.minimum(1.0, config.friction * fz / (np.linalg.norm(force[..., :2], axis=-1) + 1e-3))
    return np.concatenate([force[..., :2] * scale[..., None], fz[..., None]], -1).reshape(-1, 12)


def _percentiles(values: Floats) -> list[float]:
    return [round(float(v), 3) for v in np.percentile(values, [50, 90, 99])]


if __name__ == "__main__":
    main()
