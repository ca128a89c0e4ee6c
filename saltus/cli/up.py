"""`saltus up`: the processes, until Ctrl-C."""

import contextlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from saltus.cli.output import poll_until_done, run_directory
from saltus.cli.robot_link import (
    DomainOptions,
    await_person,
    need_dds,
    refuse_real_robot,
    refuse_unfit,
    release_agreed,
    tick_function,
)
from saltus.cli.run_options import NetworkOptions, RunOptions
from saltus.config import LONGEST_RUN_S, LinkName, Pace
from saltus.errors import ConfigError, RecordingError
from saltus.flags import Flag, flag_help


@dataclass(frozen=True, kw_only=True)
class Up(DomainOptions, RunOptions, NetworkOptions):
    """Starts the processes and keeps them running until Ctrl-C or until the robot has finished.

    For example:
      saltus up --terrain flat --planner scripted
      saltus up --speed 0.5 --profile mine --out runs/one
      saltus up --standbys
      saltus up --grid scan
      saltus up --listen 192.168.123.10:7447 --keys keys
      saltus up --robot go2 --link dds --terrain stairs
    """

    pace: Pace = "realtime"
    link: LinkName = "here"
    """Here: the controller simulates the robot. dds: a `saltus robot simulate` that runs already,
    on the same terrain and at the same pace and speed, is spoken to over its own protocol."""
    begin: Flag = False
    """With --link dds: the robot is released from its own motion service
    and rises at once. Without it you are asked to press Enter."""
    standbys: Flag = False
    """Camera, heightmap service and planner each have a second process that works along unheard,
    and goes on where the first was killed; without, the camera has one that waits. On two cores
    they take the others' time."""
    grid: Annotated[str | None, flag_help("STR", "none beside the planner's")] = None
    """Heights at more points beside those that the planner is given, by the network of any grid,
    under scan/heightmap: scan, or a TOML file. A fifth process tells them."""

    def run(self) -> int:
        """Runs until the end and says how it went; 0 then, 1 where a robot over DDS was lost.

        130 after Ctrl-C; the recording is closed in every case.
        """
        from saltus.grid import load_grid
        from saltus.runtime.programs import PROGRAMS, WITH_STANDBYS, scan_program
        from saltus.runtime.run_folder import CLIENT_FILE
        from saltus.runtime.stack import Stack

        if self.standbys and self.pace != "realtime":
            raise ConfigError(
                "--standbys are for --pace realtime: a lockstep run waits for whom it lacks"
            )
        if self.grid is not None and self.pace != "realtime":
            raise ConfigError(
                "--grid is for --pace realtime: of a lockstep run, saltus replay RECORDING --grid "
                f"{self.grid} tells these heights afterwards"
            )
        programs = WITH_STANDBYS if self.standbys else PROGRAMS
        if self.grid is not None:
            load_grid(self.grid)  # what is wrong with it is said at once
            programs = (scan_program(self.grid), *programs)
        where = {"link": self.link, "domain": self.domain, "interface": self.interface}
        config = replace(self.config(LONGEST_RUN_S), **where)  # type: ignore[arg-type]
        network = self.network(config.prefix)
        directory = run_directory("up", self.out)
        if self.link == "dds":
            self._meet()
        stack = Stack(config, directory, programs, network=network)
        lost = False
        try:
            with stack:
                print(
                    f"running, keys under {config.prefix}; join it with {directory / CLIENT_FILE}; "
                    "Ctrl-C ends it"
                )
                for _ in poll_until_done(stack):
                    pass
        finally:
            if stack.recording.is_file():
                with contextlib.suppress(
                    RecordingError
                ):  # the disk was full at the start, as is being said
                    lost = _tell(stack.recording, stack.restarts)
        return 1 if lost else 0

    def _meet(self) -> None:
        """Releases a robot over DDS from its own motion service,
        listens to it, and waits for a person.

        Raises:
            StackError: it may not be commanded.
        """
        need_dds()
        from saltus.clock import RunClock
        from saltus.controller.robot.unitree.link import ANSWERS, REQUESTS, STATES, UnitreeLink
        from saltus.controller.robot.unitree.motion_service import MotionService
        from saltus.controller.robot.unitree.on_course import NOT_SIMULATED

        link = UnitreeLink(self.domain, self.interface, sends=[REQUESTS], takes=[STATES, ANSWERS])
        with contextlib.closing(link):
            refuse_real_robot(link, NOT_SIMULATED)
            MotionService(link).release(release_agreed(self.robot, begin=self.begin))
            if self.pace == "realtime":  # in lockstep it says nothing unless it is told something
                refuse_unfit(link, self.robot, tick_function(RunClock(speed=self.speed)))
        if not self.begin:
            await_person(self.robot)


def _tell(path: Path, restarts: dict[str, int]) -> bool:
    """Prints how a run went; True where its robot was lost."""
    from saltus.recordings.recording import read_recording
    from saltus.recordings.summary import run_sentence, summarise_run
    from saltus.wire.messages import Event

    recording = read_recording(path)
    lost = [event.detail for event in recording.of(Event) if event.code == "robot_lost"]
    print(run_sentence(summarise_run(recording)))
    for why in lost:
        print(f"the robot was given up: {why}")
    for process, times in restarts.items():
        if times:
            print(f"{process} was started again {times} times")
    print(f"recording {path}")
    return bool(lost)
