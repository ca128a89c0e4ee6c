"""Commands of `saltus robot` that speak to a robot over its own protocol."""

import contextlib
import math
import time
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Annotated

from saltus.cli.camera_checks import camera_checks
from saltus.cli.output import JsonOption
from saltus.config import Pace
from saltus.errors import ConfigError, StackError
from saltus.extras import check_package
from saltus.flags import Flag, flag_help

if TYPE_CHECKING:
    from collections.abc import Callable

    from saltus.clock import RunClock
    from saltus.controller.robot.unitree.link import UnitreeLink
    from saltus.controller.robot.unitree.robot import UnitreeRobot
    from saltus.policy.level_run import LevelRun
    from saltus.real2sim.experiments.on_backend import ExperimentRun
    from saltus.robots.robot import Robot

TRUTH_S, LOOK_S = 2.0, 0.02
"""A simulated robot tells its topics all at once; a busy computer finds the last of them within the
first, and looks so often."""
LAND_S = 2.5
"""A landing takes 1.1 s at most; the rest it stands."""


@dataclass(frozen=True, kw_only=True)
class DomainOptions:
    """Flags that say where a robot is."""

    domain: int = 1
    """DDS domain: 0 of a real robot; simulated ones take 1 by custom."""
    interface: str = "lo"
    """Network interface: lo for this computer, or that on which the robot hangs."""


@dataclass(frozen=True, kw_only=True)
class LinkOptions(DomainOptions):
    """Flags of a command that joins a robot's DDS domain."""

    robot: str = "go2"
    """Go2, or the path of an MJCF or of a folder with a robot.toml: your Go2."""

    def loaded(self) -> "Robot":
        """The robot's values.

        Raises:
            SaltusError: there is no such robot, or Cyclone DDS is not installed.
        """
        from saltus.robots.loading import load_robot

        need_dds()
        return load_robot(self.robot)


def need_dds() -> None:
    """Raises `ConfigError` where Cyclone DDS is not installed."""
    check_package("cyclonedds", "dds", "a robot's DDS needs")


@dataclass(frozen=True, kw_only=True)
class PaceOptions:
    """Flags that say whether a simulated robot runs in real time or in lockstep, and how fast."""

    pace: Pace = "realtime"
    """lockstep: the robot waits for each command, and the other side for each state."""
    speed: float = 1.0
    """With realtime: seconds of the robot for each second of this computer, on both sides alike."""


def check_speed(speed: float) -> None:
    """Raises `ConfigError` for a speed that is none."""
    if not 0.0 < speed <= 1.0:
        raise ConfigError(f"--speed {speed:g}: allowed is more than 0, and 1 at most")


@dataclass(frozen=True, kw_only=True)
class Preflight(JsonOption, LinkOptions):
    """Checks a robot before it is commanded, and refuses it with the reason: exit code 1.

    It is listened to for 2 s. If it hangs and all is well, its legs are then moved for 5 s, softly:
    keep your hands away. Nothing is sent where another program commands the robot.

    For example:
      saltus robot preflight --interface enp3s0 --domain 0
      saltus robot preflight --interface enp3s0 --domain 0 --standing --json
      saltus robot preflight --standing --recording runs/one/recording.mcap
    """

    standing: Flag = False
    """The robot stands on level ground by itself: it is told nothing, and its IMU is compared with
    its legs. Without, it hangs with its feet in the air."""
    recording: Annotated[Path | None, flag_help("PATH", "the camera is not judged")] = None
    """A recorded run (.mcap) in which the robot stood for a second and then pitched, or bounded, on
    level ground with nothing ahead: place and lateness of its camera are judged by it."""
    speed: float = 1.0
    """Speed of a simulated robot, as it was told there."""

    def run(self) -> int:
        """Prints a line for each check; 1 where one refuses the robot."""
        check_speed(self.speed)
        kind = self.loaded()
        from saltus.clock import RunClock
        from saltus.controller.robot.unitree.link import UnitreeLink
        from saltus.controller.robot.unitree.preflight import run_preflight

        clock = RunClock(speed=self.speed)
        link = UnitreeLink.to_robot(self.domain, self.interface)
        try:
            checks = run_preflight(
                link, kind, clock, tick_function(clock), stands=self.standing,
                agreed=release_agreed(kind.name),
            )  # fmt: skip
        finally:
            link.close()
        if self.recording is not None:
            checks += camera_checks(self.recording)
        for check in checks:
            told = "ok     " if check.passed else "REFUSED"
            print(f"{told} {check.name:13} {check.found}  (allowed: {check.allowed})")
            if not check.passed:
                print(f"{'':22}{check.cure}")
        refused = [check.name for check in checks if not check.passed]
        print(f"refused: {', '.join(refused)}" if refused else "the robot may be commanded")
        self.tell_json({"passed": not refused, "checks": [vars(check) for check in checks]})
        return 1 if refused else 0


def tick_function(clock: "RunClock") -> "Callable[[], float]":
    """A function that returns every 2 ms of a clock, with its time [s]."""
    from saltus.constants import PHYSICS_DT
    from saltus.runtime.ticker import Ticker

    ticker = Ticker(1.0 / PHYSICS_DT, clock=clock)

    def wait() -> float:
        ticker.wait()
        return clock.elapsed_s()

    return wait


def release_agreed(name: str, *, begin: bool = False) -> "Callable[[str], None]":
    """A function that says in which mode a robot moves itself, and waits for its release."""

    def agreed(mode: str) -> None:
        print(
            f"{name} is moved by its own motion service, in mode '{mode}': when that is released, a "
            "robot that stands sinks to the ground",
            flush=True,
        )
        if not begin:
            input("Enter releases it; lay the robot down first, or hang it. Ctrl-C ends it: ")

    return agreed


def refuse_unfit(link: "UnitreeLink", name: str, wait: "Callable[[], float]") -> None:
    """Listens for 2 s, and raises `StackError` for a robot that may not be commanded."""
    from saltus.controller.robot.unitree.listening import link_checks, listen_to_robot

    for check in link_checks(listen_to_robot(link, wait)):
        if not check.passed:
            raise StackError(
                f"{name} is not commanded: {check.name}: {check.found} (allowed: "
                f"{check.allowed}); {check.cure}. saltus robot preflight says more"
            )


def refuse_real_robot(link: "UnitreeLink", why: str) -> None:
    """Returns when a simulated robot is met; raises `StackError` with `why` where another robot is,
    and also where none is.
    """
    from saltus.controller.robot.unitree.link import STATES, TRUTHS
    from saltus.controller.robot.unitree.robot import CONNECT_S

    since_s = time.monotonic()
    while not link.others(TRUTHS):
        waited_s = time.monotonic() - since_s
        if waited_s > TRUTH_S and link.others(STATES):
            raise StackError(why)
        if waited_s > CONNECT_S:
            raise StackError(
                f"no simulated robot came within {CONNECT_S:g} s: start `saltus robot simulate` "
                "with the same --domain, --interface and --pace"
            )
        time.sleep(LOOK_S)


def await_person(name: str) -> None:
    """Returns when a person lets the robot rise."""
    input(f"Enter lets {name} rise; keep away from it. Ctrl-C ends it: ")


@dataclass(frozen=True, kw_only=True)
class LogRobot(LinkOptions):
    """Records what a robot says and is told, at full rate, until Ctrl-C; it sends nothing.

    For example:
      saltus robot log --interface enp3s0 --domain 0 --out logs/walk.mcap
      saltus real2sim import logs/walk.mcap --robot go2 --out logs/walk
    """

    out: Annotated[Path | None, flag_help("PATH", "a new one under runs/")] = None
    """The file, in MCAP, which ROS 2 and viewers open."""
    seconds: Annotated[float, flag_help("FLOAT", "until Ctrl-C")] = math.inf
    """How long is recorded [s]."""

    def run(self) -> int:
        """Records, and says what came; 0 where states did, 130 after Ctrl-C (the file is whole either way)."""
        self.loaded()
        from saltus.controller.robot.unitree.link import (
            COMMANDS,
            STATES,
            ArrivedMessage,
            UnitreeLink,
        )
        from saltus.controller.robot.unitree.log import TOPICS, new_log, record_link
        from saltus.controller.robot.unitree.states import StateWatch
        from saltus.folders import new_folder

        path = self.out or new_folder("robot-log") / "log.mcap"
        watch = StateWatch()
        arrivals: SimpleQueue[tuple[str, ArrivedMessage]] = SimpleQueue()
        link = UnitreeLink(
            self.domain, self.interface, takes=[*TOPICS],
            heard=lambda topic, arrived: arrivals.put((topic, arrived)),
        )  # fmt: skip
        with contextlib.closing(link), new_log(path) as log:
            print(f"recording into {path}; Ctrl-C ends it", flush=True)
            try:
                record_link(arrivals, log, watch, self.seconds)
            finally:
                states, commands = (log.counts[TOPICS[name]] for name in (STATES, COMMANDS))
                print(
                    f"{states} states ({watch.health.lost} more were lost, "
                    f"{sum(watch.health.bad.values())} not usable), {commands} commands"
                )
        return 0 if states else 1


@dataclass(frozen=True, kw_only=True)
class RunRobot(PaceOptions, LinkOptions):
    """Lets a robot stand, bound over level ground, or make an experiment's motion, over its own protocol.

    Its own motion service is released, and the robot listened to and refused as by the preflight.
    Then it rises in 2 s, stands, and with `--stage bound` bounds ahead for `--seconds`; at the end,
    and after Ctrl-C, it lands, stands, and is left damped: it sinks to the ground.

    For example:
      saltus robot run --stage stand --interface enp3s0 --domain 0
      saltus robot run --stage bound --seconds 3
      saltus robot run --stage joint_tour
    """

    stage: str = "stand"
    """stand, or bound: by rules, on ground that is taken to be level; nothing looks ahead. Or an
    experiment of a robot that hangs (saltus real2sim experiments), for a log."""
    seconds: float = 5.0
    """How long it stands or bounds, after it has risen and stood for a second [s]; experiments have
    a length of their own."""
    begin: Flag = False
    """Begin at once, and release the robot's own motion service; else press Enter."""

    def run(self) -> int:
        """Runs it and says how it ended; 1 where the robot was lost, had to land or tipped over."""
        check_speed(self.speed)
        kind = self.loaded()
        from saltus.clock import RunClock
        from saltus.controller.robot.unitree.limits import STAGES
        from saltus.controller.robot.unitree.link import UnitreeLink
        from saltus.controller.robot.unitree.motion_service import MotionService
        from saltus.controller.robot.unitree.robot import UnitreeRobot
        from saltus.real2sim.experiments.on_backend import held_experiment

        if self.stage not in STAGES:
            held_experiment(self.stage)  # a wrong name is told before anything moves
        lockstep, clock = self.pace == "lockstep", RunClock(speed=self.speed)
        link = UnitreeLink.to_robot(self.domain, self.interface, reliable=lockstep)
        limits = STAGES.get(self.stage)  # an experiment has its own
        robot = UnitreeRobot(link, kind, clock, limits=limits, lockstep=lockstep)
        wait = (lambda: 0.0) if lockstep else tick_function(clock)
        with contextlib.closing(robot):
            if lockstep:
                refuse_real_robot(
                    link,
                    "the robot is no `saltus robot simulate`: with --pace lockstep it is not "
                    "checked; leave that out",
                )
            MotionService(link).release(release_agreed(kind.name, begin=self.begin))
            if not lockstep:
                refuse_unfit(link, kind.name, wait)
            if not self.begin:
                await_person(kind.name)
            robot.reset()
            run, ends_s = self._begun(robot, kind)
            peak_a, least_v = 0.0, math.inf
            try:
                while run.time_s < ends_s and not (robot.fault or robot.concern):
                    wait()
                    run.step()
                    peak_a = max(peak_a, float(robot.message["power_a"]))
                    least_v = min(least_v, float(robot.message["power_v"]))
            finally:  # after Ctrl-C, too: it lands and stands, or is damped
                end_s = run.time_s + LAND_S
                while run.time_s < end_s:
                    wait()
                    run.step(halt=True)
        mode, health = run.mode.name, robot.health
        ended = f"damped, as {robot.fault}" if robot.fault else mode
        before = f", as {robot.concern}" if robot.concern and not robot.fault else ""
        print(
            f"{ended}{before} after {run.time_s:.1f} s; "
            f"{health.lost} of {health.states + health.lost} states lost; "
            f"at most {run.peak_power_w:.0f} W at the joints, {peak_a:.1f} A from the battery, "
            f"which fell to {least_v:.1f} V, by the robot's own word"
        )
        return 1 if robot.fault or robot.concern or (mode == "DAMP" and self.stage in STAGES) else 0

    def _begun(
        self, robot: "UnitreeRobot", kind: "Robot"
    ) -> "tuple[LevelRun | ExperimentRun, float]":
        """The run, and when it ends [s]."""
        from saltus.controller.control_loop import FIRST_STAND_S
        from saltus.controller.rising import RISE_S
        from saltus.controller.robot.unitree.limits import STAGES
        from saltus.grid import DEFAULT_GRID, load_grid
        from saltus.policy.level_run import LevelRun
        from saltus.policy.planner import make_planner
        from saltus.real2sim.experiments.on_backend import ExperimentRun, held_experiment

        if self.stage not in STAGES:
            motion = ExperimentRun(robot, kind, held_experiment(self.stage))
            return motion, motion.duration_s
        grid = load_grid(DEFAULT_GRID)
        planner = make_planner("scripted", kind, grid) if self.stage == "bound" else None
        return LevelRun(robot, kind, grid, planner), RISE_S + FIRST_STAND_S + self.seconds
