"""Ground reaction forces and the leg controller: exactness against another solver, and time on one core.

    OMP_NUM_THREADS=1 python benchmarks/qp.py

Times are given on the wall clock and as processor time of the thread, which other programs on the machine do not
change. Forces are compared with quadprog on the full problem of twelve forces (development extra).
"""

import gc
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import quadprog
from numpy.typing import NDArray

from saltus import go1
from saltus.action import Action
from saltus.controller.estimator import Estimator
from saltus.controller.law import LegController
from saltus.controller.signals import Plan, observe, plan_from_action
from saltus.controller.stance import ExactSolver, StanceConfig, StanceLegs, StanceQP
from saltus.rotations import quaternion_from_roll_pitch_yaw

PROBLEMS = 1000
TICKS = 5000
BATCH = 1024
CONFIG = StanceConfig()


@dataclass(frozen=True, kw_only=True, eq=False)
class Robots:
    """What of `saltus.states.Proprioception` estimator and law read."""

    quaternion_base_in_world: NDArray[np.float64]
    angular_velocity_base: NDArray[np.float64]
    acceleration_base: NDArray[np.float64]
    joint_position: NDArray[np.float64]
    joint_velocity: NDArray[np.float64]
    velocity_base_in_world: NDArray[np.float64]
    base_height: NDArray[np.float64]


def draw(rng: np.random.Generator, batch: tuple[int, ...]) -> tuple[Plan, Robots]:
    """Random robots and plans over the whole range of motion policies."""

    def uniform(low: float, high: float, *shape: int) -> NDArray[np.float64]:
        return np.asarray(rng.uniform(low, high, (*batch, *shape)))

    robots = Robots(
        quaternion_base_in_world=quaternion_from_roll_pitch_yaw(
            uniform(-0.5, 0.5), uniform(-0.8, 0.8), uniform(-3.1, 3.1)
        ),
        angular_velocity_base=uniform(-4.0, 4.0, 3),
        acceleration_base=np.zeros((*batch, 3)) + np.array([0.0, 0.0, 9.81]),
        joint_position=go1.STAND_POSE + uniform(-0.4, 0.4, 12),
        joint_velocity=uniform(-10.0, 10.0, 12),
        velocity_base_in_world=uniform(-2.0, 2.0, 3),
        base_height=uniform(0.15, 0.45),
    )
    action = Action(
        stepping_frequency_hz=uniform(0.5, 4.0),
        velocity_x=uniform(-3.0, 3.0),
        velocity_z=uniform(-3.0, 3.0),
        pitch_rate=uniform(-6.0, 6.0),
        foot_residual_front=uniform(-0.2, 0.2, 3),
        foot_residual_rear=uniform(-0.2, 0.2, 3),
    )
    return plan_from_action(action, uniform(-3.1, 3.1)), robots


def row(value: Any, k: int) -> Any:
    """Robot `k` of a batch."""
    return type(value)(**{f.name: np.asarray(getattr(value, f.name)[k]) for f in fields(value)})


class Timer:
    """Wall and processor time of many calls."""

    def __init__(self) -> None:
        self._wall: list[int] = []
        self._cpu: list[int] = []

    def __call__(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Calls and takes the time."""
        wall, cpu = time.perf_counter_ns(), time.thread_time_ns()
        result = function(*arguments)
        self._cpu.append(time.thread_time_ns() - cpu)
        self._wall.append(time.perf_counter_ns() - wall)
        return result

    def summary(self) -> dict[str, float]:
        """Percentiles [us]."""
        wall, cpu = np.percentile(self._wall, [50, 99]) / 1e3, np.percentile(self._cpu, [50, 99]) / 1e3
        names = ("p50_us", "p99_us", "cpu_p50_us", "cpu_p99_us")
        return {name: round(float(value), 1) for name, value in zip(names, (*wall, *cpu), strict=True)}


def independent(qp: StanceQP) -> NDArray[np.float64]:
    """The forces by quadprog; feet in the air are held at zero by equations."""
    low, high = CONFIG.force_z_range_n
    equations, rows, bounds = [], [], []
    for leg in range(4):
        x, y, z = np.eye(12)[3 * leg : 3 * leg + 3]
        if qp.contact[leg]:
            rows += [z, -z] + [CONFIG.friction * z + sign * t for t in (x, y) for sign in (1.0, -1.0)]
            bounds += [low, -high, 0.0, 0.0, 0.0, 0.0]
        else:
            equations += [x, y, z]
    constraints = np.array(equations + rows).T
    right = np.array([0.0] * len(equations) + bounds)
    return np.asarray(quadprog.solve_qp(qp.hessian, -qp.gradient, constraints, right, len(equations))[0])


def forces(rng: np.random.Generator) -> dict[str, Any]:
    """Random problems of 0 to 4 standing feet: build, solve, compare."""
    stance, solver = StanceLegs(CONFIG), ExactSolver(CONFIG)
    plans, robots = draw(rng, (PROBLEMS,))
    contacts = rng.random((PROBLEMS, 4)) < 0.6
    build, solve, worst = Timer(), Timer(), 0.0
    for k in range(PROBLEMS):
        plan, body = row(plans, k), observe(row(robots, k))
        acceleration = stance.acceleration_reference(body, plan.velocity, plan.angular_velocity)
        qp = build(stance.build_qp, body, acceleration, contacts[k])
        force = solve(solver.solve, qp)
        worst = max(worst, float(np.abs(force - independent(qp)).max()))
    return {"problems": PROBLEMS, "worst_difference_n": worst, "build": build.summary(), "solve": solve.summary()}


def law(rng: np.random.Generator) -> dict[str, Any]:
    """The whole step of one robot, of a batch, and the estimator beside it."""
    controller, estimator = LegController(), Estimator()
    plans, robots = draw(rng, (TICKS,))
    state, estimate = controller.init((), go1.STAND_POSE), estimator.init((), go1.STAND_POSE)
    one, filtering = Timer(), Timer()
    for k in range(TICKS):
        sensed = row(robots, k)
        _, state, diagnostics = one(controller.step, row(plans, k), sensed, state)
        estimate = filtering(estimator.step, sensed, diagnostics.gait.trusted, estimate)
    plan, sensed = draw(rng, (BATCH,))
    many_state = controller.init((BATCH,), sensed.joint_position)
    start = time.thread_time_ns()
    for _ in range(10):
        _, many_state, _ = controller.step(plan, sensed, many_state)
    batch_us = (time.thread_time_ns() - start) / 1e3 / 10 / BATCH
    return {
        "law_step": one.summary(),
        "estimator_step": filtering.summary(),
        "batch": {"robots": BATCH, "cpu_us_per_robot": round(batch_us, 1)},
    }


def main() -> None:
    """Measures and prints."""
    rng = np.random.default_rng(0)
    gc.collect()
    gc.freeze()
    result = {**forces(rng), **law(rng)}
    for name, value in result.items():
        print(f"{name:20} {value}")
    print(json.dumps({"benchmark": "qp", **result}))


if __name__ == "__main__":
    main()
