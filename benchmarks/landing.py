"""Robots at full speed lose their planner, at every phase of the gait: how many come to a stand.

Without processes and clocks: the control loop, the plant and a planner on true heights with each
trial's shift. "stop": heightmaps end, and the planner says STOP. "silence": plans end.

    saltus bench landing -- --terrain stairs --planner scripted
    saltus bench landing -- --terrain stairs --rise-m 0.2 --run-s 0.6 --until-s 2.4 --trials 24 --seed 5000
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from benchmarks._command import Command, progress
from saltus.arrays import Floats
from saltus.config import TerrainConfig
from saltus.constants import PHYSICS_DT, POLICY_STEPS
from saltus.controller.control_loop import FIRST_STAND_S, ControlLoop
from saltus.controller.robot.mujoco import MujocoRobot
from saltus.depth_camera import load_camera
from saltus.effects.profile import SHIPPED, load_profile
from saltus.grid import HEIGHTMAP_X, LINE
from saltus.loop.planner import Planner
from saltus.policy.mover import Jumper
from saltus.policy.planner import make_planner
from saltus.policy.process import PlannerProcess
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.rotations import rotation_matrix
from saltus.setup import Setup
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain
from saltus.trial import Trial
from saltus.wire.messages import AnyPlan, ControllerMode, Heightmap, HeightmapStatus

TICK_NS = round(1e9 * PHYSICS_DT)
CYCLE_S = 0.3  # of the gait, about: 3 to 3.5 bounds a second
AFTER_S = 3.0  # told after 0.1 s, landed after 1.1 s, stood up after 1 s more


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    terrain: Literal["flat", "stairs", "stepping_stones"] = "flat"
    """Terrain that the robots cross."""
    planner: Literal["learned", "scripted"] = "learned"
    """Planner that leads them until the fault."""
    rise_m: float = 0.06
    """Rise of the stairs."""
    run_s: float = 1.8
    """Time from the first jump to the first fault."""
    until_s: float | None = None
    """If given, the fault comes once in each trial, at random between the first time and this
    one."""
    phases: int = 20
    """Phases of the gait at which the fault comes otherwise."""
    trials: int = 2
    """At each phase, or in all."""
    seed: int = 0
    """Seed of the first trial."""

    def measure(self) -> dict[str, Any]:
        robot = load_robot(DEFAULT_ROBOT)
        planner = make_planner(self.planner, robot, LINE)
        cases = [
            (self._course(seed), Trial.draw(seed), FIRST_STAND_S + fault_s)
            for seed in range(self.seed, self.seed + self.trials)
            for fault_s in self._faults_s(seed)
        ]
        table = {
            fault: summary(
                [land(robot, *case, planner, fault == "silence") for case in progress(cases, fault)]
            )
            for fault in ("stop", "silence")
        }
        return {"landing": {"terrain": self.terrain, "planner": self.planner, **table}}

    def _faults_s(self, seed: int) -> list[float]:
        """When faults come, counted from the first jump [s]."""
        if self.until_s is not None:
            return [float(np.random.default_rng(seed).uniform(self.run_s, self.until_s))]
        return [self.run_s + phase * CYCLE_S for phase in np.arange(self.phases) / self.phases]

    def _course(self, seed: int) -> Terrain:
        if self.terrain == "stepping_stones":
            return make_terrain(
                TerrainConfig(terrain=self.terrain, gap_m=0.1, gap_max_m=0.5, layout_seed=seed)
            )
        return make_terrain(
            TerrainConfig(
                terrain=self.terrain, rise_m=self.rise_m if self.terrain == "stairs" else None
            )
        )


@dataclass(frozen=True, kw_only=True)
class Rest:
    """How one robot came to rest."""

    stands: bool
    """In mode STOPPED, upright, on its feet and at rest."""
    touched: bool
    """The trunk met the ground on the way."""
    stopped_s: float
    """From the fault to the end of the landing; infinite where there was none."""
    distance_m: float
    """From the fault to the end."""


def land(
    kind: Robot, terrain: Terrain, trial: Trial, fault_s: float, planner: Planner, silent: bool
) -> Rest:
    """Runs one robot; at `fault_s` its heightmaps end, or its plans if `silent`."""
    robot = MujocoRobot(
        Setup(
            robot=kind,
            grid=LINE,
            terrain=terrain,
            profile=load_profile(SHIPPED, kind),
            camera=load_camera("ideal"),
            trial=trial,
        )
    )
    robot.reset()
    loop, process = ControlLoop(kind), PlannerProcess(LINE, Jumper(kind, planner))
    plan: AnyPlan | None = None
    stopped_s, start_x = float("inf"), 0.0
    fault_tick = round(fault_s / PHYSICS_DT)
    for tick in range(fault_tick + round(AFTER_S / PHYSICS_DT)):
        now_ns, step = tick * TICK_NS, tick // POLICY_STEPS
        loop.sense(robot.read())
        if tick == fault_tick:
            start_x = float(robot.state.position_base_in_world[0])
            robot.take_trunk_contact()
        if tick % POLICY_STEPS == 0 and not (silent and tick >= fault_tick):
            seen = true_heightmap(robot, trial, now_ns, step) if tick < fault_tick else None
            plan = process.step(loop.state(now_ns, step), seen, now_ns)
        robot.write(loop.act(plan, 1e-9 * (now_ns - plan.time_ns) if plan else float("inf")))
        if loop.mode == ControllerMode.STOPPED and stopped_s == float("inf"):
            stopped_s = (tick - fault_tick) * PHYSICS_DT
    state = robot.state
    x = float(state.position_base_in_world[0])
    return Rest(
        stands=loop.mode == ControllerMode.STOPPED
        and bool(rotation_matrix(state.quaternion_base_in_world)[2, 2] > np.cos(np.deg2rad(30.0)))
        and float(
            state.position_base_in_world[2]
            - terrain.height_at(x, float(state.position_base_in_world[1]))
        )
        > 0.18
        and float(np.linalg.norm(state.velocity_base_in_world)) < 0.1,
        touched=robot.take_trunk_contact(),
        stopped_s=stopped_s,
        distance_m=x - start_x,
    )


def true_heightmap(robot: MujocoRobot, trial: Trial, time_ns: int, step: int) -> Heightmap:
    """The heights around a robot, as its trial shifts them."""
    position: Floats = robot.state.position_base_in_world
    x = position[0] + trial.height_shift_x + HEIGHTMAP_X
    return Heightmap(
        time_ns=time_ns,
        step=step,
        x=HEIGHTMAP_X,
        height=robot.terrain.height_at(x, float(position[1])) - position[2] + trial.height_shift_z,
        half_width_90=np.zeros(len(HEIGHTMAP_X)),
        status=HeightmapStatus.OK,
        depth_age_s=0.05,
        frame_id=step,
        model_id="",
    )


def summary(landings: Sequence[Rest]) -> dict[str, Any]:
    """How many came to a stand, after what time and way."""
    standing = [landing for landing in landings if landing.stands]
    return {
        "trials": len(landings),
        "stand": len(standing),
        "touched": sum(landing.touched for landing in landings),
        "stopped_s_max": max((landing.stopped_s for landing in standing), default=None),
        "distance_m_median": float(np.median([landing.distance_m for landing in landings])),
    }
