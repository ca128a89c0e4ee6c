"""A simulated robot and ours in one process: messages go by hand, and time as the test says."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from saltus.constants import PHYSICS_DT
from saltus.controller.control_loop import ControlLoop
from saltus.controller.robot.unitree.faults import PlantedFault, PlantedFaults
from saltus.controller.robot.unitree.limits import STAGES, StageLimits
from saltus.controller.robot.unitree.link import (
    ANSWERS,
    COMMANDS,
    REQUESTS,
    STATES,
    TRUTHS,
    ArrivedMessage,
)
from saltus.controller.robot.unitree.listening import PreflightCheck
from saltus.controller.robot.unitree.preflight import run_preflight
from saltus.controller.robot.unitree.robot import UnitreeRobot
from saltus.controller.robot.unitree.simulated import SimulatedUnitree
from saltus.controller.tick import CompiledTickLaw
from saltus.effects.profile import load_profile
from saltus.grid import DEFAULT_GRID, load_grid
from saltus.policy.level_run import LevelRun
from saltus.policy.planner import make_planner
from saltus.robots.loading import load_robot
from saltus.sim.plant import Plant
from saltus.terrain import flat
from saltus.trial import Trial

ROBOT = load_robot("go2")
GRID = load_grid(DEFAULT_GRID)


@cache
def tick() -> CompiledTickLaw:
    """The leg law, compiled once."""
    return CompiledTickLaw(ROBOT)


def simulated(*faults: str, seed: int = 0, held: bool = False) -> SimulatedUnitree:
    """One with the drives that a trial draws: 0.9 to 1.1 of their strength, and later or sooner."""
    profile = Trial.draw(seed).applied_to(load_profile("shipped", ROBOT))
    plant = Plant(ROBOT, flat.make(), chain=profile.actuator_chain, held=held)
    return SimulatedUnitree(
        plant, PlantedFaults([PlantedFault.parse(each) for each in faults], seed), seed
    )


class Wire:
    """The link of our side and its clock; the robot advances when it is told to."""

    has_met_all = True

    def __init__(self, robot: SimulatedUnitree, strangers: Sequence[str] = ()) -> None:
        self.robot, self.strangers = robot, tuple(strangers)
        self.sent: list[bytes] = []
        self._come: dict[str, list[ArrivedMessage]] = {STATES: [], TRUTHS: [], ANSWERS: []}

    def elapsed_s(self) -> float:
        """Time of the robot, as its clock [s]."""
        return self.robot.time_s

    def tick(self) -> None:
        """Advances the robot by 2 ms."""
        said = {STATES: self.robot.step(), TRUTHS: [self.robot.truth()]}
        for topic, payloads in said.items():
            self._come[topic] += [ArrivedMessage(payload, 0, 0) for payload in payloads]

    def send(self, topic: str, payload: bytes) -> None:
        """As of `UnitreeLink`, at once."""
        if topic == REQUESTS:
            self._come[ANSWERS] += [
                ArrivedMessage(each, 0, 0) for each in self.robot.answer(payload)
            ]
            return
        assert topic == COMMANDS
        self.sent.append(payload)
        self.robot.hear(payload)

    def take(self, topic: str) -> list[ArrivedMessage]:
        """As of `UnitreeLink`."""
        come, self._come[topic] = self._come[topic], []
        return come

    def wait(self, topic: str, seconds: float) -> None:
        """Returns at once."""

    def others(self, topic: str) -> tuple[str, ...]:
        """As of `UnitreeLink`: `strangers`, and the robot's own service while it moves it."""
        if topic == ANSWERS:
            return ("its service",)
        return (*self.strangers, *(["its service"] if self.robot.mode else []))

    def close(self) -> None:
        """Does nothing."""


class Run:
    """Our loop and the robot, each 2 ms after the other's last."""

    def __init__(self, *faults: str, seed: int = 0) -> None:
        self.wire = Wire(simulated(*faults, seed=seed))
        self.robot = UnitreeRobot(self.wire, ROBOT, self.wire)  # type: ignore[arg-type]
        self.loop = ControlLoop(ROBOT, tick())
        self.wire.tick()
        self.robot.reset()

    def step(self) -> None:
        """Our tick, and then the robot's."""
        self.loop.sense(self.robot.read())
        self.robot.write(self.loop.act(None, np.inf))
        self.wire.tick()

    def until(self, time_s: float) -> None:
        """Goes on to a time of the robot [s]."""
        while self.wire.robot.time_s < time_s - 0.5 * PHYSICS_DT:
            self.step()


class Bounding:
    """A robot that is told to bound by rules, and the wire to it; it rises and stands before."""

    def __init__(self, *faults: str, seed: int = 0, limits: StageLimits = STAGES["bound"]) -> None:
        self.wire = Wire(simulated(*faults, seed=seed))
        self.wire.tick()
        self.robot = UnitreeRobot(self.wire, ROBOT, self.wire, limits=limits)  # type: ignore[arg-type]
        self.robot.reset()
        self.run = LevelRun(self.robot, ROBOT, GRID, make_planner("scripted", ROBOT, GRID))

    def until(self, time_s: float, *, halt: bool = False) -> None:
        """Goes on to a time of the run [s]."""
        while self.run.time_s < time_s:
            self.run.step(halt=halt)
            self.wire.tick()


def checks(wire: Wire, *, stands: bool = False) -> list[PreflightCheck]:
    """A preflight over a wire."""

    def wait() -> float:
        wire.tick()
        return wire.elapsed_s()

    return run_preflight(wire, ROBOT, wire, wait, stands=stands)  # type: ignore[arg-type]
