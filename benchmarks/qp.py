"""Ground reaction forces and the leg controller:
exactness against another solver, and time on one core.

Forces are compared with quadprog on the full problem of twelve forces, where that package is
installed. Times are given on the wall clock and as processor time of the thread, which other
programs on the machine do not change.

    OMP_NUM_THREADS=1 saltus bench qp
"""

import gc
import sys
import time
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks._command import Command
from benchmarks._measuring import Stopwatch
from saltus.controller.braking import BrakingState
from saltus.controller.leg_controller import LegController
from saltus.controller.stance import FRICTION, ExactSolver, StanceLegs, StanceQP
from saltus.controller.tick import CompiledTickLaw, TickLaw
from saltus.controller.yaw_frame import CentroidalReference, observe_body, reference_of
from saltus.plan import Plan
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.states import ProprioceptionArrays
from saltus.wire.messages import ControllerMode

try:
    import quadprog
except ImportError:
    quadprog = None

ROBOT = load_robot(DEFAULT_ROBOT)


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    problems: int = 1000
    """Random stances whose forces are computed."""
    ticks: int = 5000
    """Ticks of the control loop of one robot."""
    robots: int = 1024
    """Number of robots whose controllers make one step together."""

    def measure(self) -> dict[str, Any]:
        rng = np.random.default_rng(0)
        gc.collect()
        gc.freeze()
        figures = {"problems": self.problems, **self._forces(rng), **self._law(rng)}
        gc.unfreeze()
        return figures

    def _forces(self, rng: np.random.Generator) -> dict[str, Any]:
        """Random problems of 0 to 4 standing feet: build, solve, compare."""
        stance, solver = StanceLegs(ROBOT), ExactSolver(ROBOT)
        plans, robots = random_robots(rng, (self.problems,))
        contacts = rng.random((self.problems, 4)) < 0.6
        build, solve, differences = Stopwatch(), Stopwatch(), []
        for k in range(self.problems):
            plan, body = row(plans, k), observe_body(row(robots, k), LegKinematics(ROBOT))
            acceleration = stance.acceleration_reference(body, plan.velocity, plan.angular_velocity)
            qp = build(stance.build_qp, body, acceleration, contacts[k])
            force = solve(solver.solve, qp)
            if quadprog is not None:
                differences.append(float(np.abs(force - independent(qp)).max()))
        if not differences:
            print(
                "quadprog is not installed: forces are not compared (pip install quadprog)",
                file=sys.stderr,
            )
        worst = max(differences, default=None)
        return {
            "worst_difference_n": worst,
            "build": build.percentiles(),
            "solve": solve.percentiles(),
        }

    def _law(self, rng: np.random.Generator) -> dict[str, Any]:
        """A tick of one robot, on numpy and compiled in turns, and of a batch."""
        ticks = {"numpy": TickLaw(ROBOT), "compiled": CompiledTickLaw(ROBOT)}
        plans, robots = random_robots(rng, (self.ticks,))
        law, estimate = (
            ticks["numpy"].law.init((), ROBOT.stand_pose),
            ticks["numpy"].estimator.init((), ROBOT.stand_pose),
        )
        law, ground = replace(law, mode=ControllerMode.RUN), BrakingState(foothold=law.liftoff)
        sensing, acting = (
            {name: Stopwatch() for name in ticks},
            {name: Stopwatch() for name in ticks},
        )
        for k in range(self.ticks):
            plan, sensed = row(plans, k), row(robots, k)
            for name, tick in ticks.items():
                sensed_now = sensing[name](tick.sense, sensed, sensed.leg_trusted, estimate)
                acted = acting[name](tick.act, plan, sensed, law, ground, ControllerMode.RUN)
            law, ground, estimate = acted.law, acted.ground, sensed_now.estimate
        return {
            "sense": {name: watch.percentiles() for name, watch in sensing.items()},
            "act": {name: watch.percentiles() for name, watch in acting.items()},
            "batch": {"robots": self.robots, "cpu_us_per_robot": round(self._batch_us(rng), 1)},
        }

    def _batch_us(self, rng: np.random.Generator) -> float:
        controller = LegController(ROBOT)
        plan, sensed = random_robots(rng, (self.robots,))
        state = controller.init((self.robots,), sensed.joint_position)
        start = time.thread_time_ns()
        for _ in range(10):
            _, state, _ = controller.step(plan, sensed, state)
        return (time.thread_time_ns() - start) / 1e3 / 10 / self.robots


def random_robots(
    rng: np.random.Generator, batch: tuple[int, ...]
) -> tuple[CentroidalReference, ProprioceptionArrays]:
    """Random robots and plans over the whole range of motion policies."""

    def uniform(low: float, high: float, *shape: int) -> NDArray[np.float64]:
        return np.asarray(rng.uniform(low, high, (*batch, *shape)))

    robots = ProprioceptionArrays(
        quaternion_base_in_world=quaternion_from_roll_pitch_yaw(
            uniform(-0.5, 0.5), uniform(-0.8, 0.8), uniform(-3.1, 3.1)
        ),
        angular_velocity_base=uniform(-4.0, 4.0, 3),
        acceleration_base=np.zeros((*batch, 3)) + np.array([0.0, 0.0, 9.81]),
        joint_position=ROBOT.stand_pose + uniform(-0.4, 0.4, 12),
        joint_velocity=uniform(-10.0, 10.0, 12),
        velocity_base_in_world=uniform(-2.0, 2.0, 3),
        base_height=uniform(0.15, 0.45),
        leg_contact=np.ones((*batch, 4), dtype=np.bool_),
        leg_progress=np.zeros((*batch, 4)),
        leg_trusted=np.ones((*batch, 4), dtype=np.bool_),
        cycle=np.zeros(batch, dtype=np.int64),
    )
    plan = Plan(
        stepping_frequency_hz=uniform(0.5, 4.0),
        velocity_x=uniform(-3.0, 3.0),
        velocity_z=uniform(-3.0, 3.0),
        pitch_rate=uniform(-6.0, 6.0),
        foot_residual_front=uniform(-0.2, 0.2, 3),
        foot_residual_rear=uniform(-0.2, 0.2, 3),
    )
    return reference_of(plan, uniform(-3.1, 3.1)), robots


def row(value: Any, k: int) -> Any:
    """Robot `k` of a batch."""
    arrays = [f.name for f in fields(value) if np.ndim(getattr(value, f.name))]
    return replace(value, **{name: np.asarray(getattr(value, name)[k]) for name in arrays})


def independent(qp: StanceQP) -> NDArray[np.float64]:
    """The forces by quadprog; feet in the air are held at zero by equations."""
    low, high = ROBOT.foot_force
    equations, rows, bounds = [], [], []
    for leg in range(4):
        x, y, z = np.eye(12)[3 * leg : 3 * leg + 3]
        if qp.contact[leg]:
            rows += [z, -z] + [FRICTION * z + sign * t for t in (x, y) for sign in (1.0, -1.0)]
            bounds += [low, -high, 0.0, 0.0, 0.0, 0.0]
        else:
            equations += [x, y, z]
    constraints = np.array(equations + rows).T
    right = np.array([0.0] * len(equations) + bounds)
    return np.asarray(
        quadprog.solve_qp(qp.hessian, -qp.gradient, constraints, right, len(equations))[0]
    )
