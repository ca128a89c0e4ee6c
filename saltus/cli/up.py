"""`saltus up`: the processes, until Ctrl-C."""

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from saltus.cli.output import follow, run_directory
from saltus.cli.run_options import NetworkOptions, RunOptions
from saltus.config import LONGEST_RUN_S, Pace
from saltus.errors import ConfigError, RecordingError
from saltus.flags import Flag, shown


@dataclass(frozen=True, kw_only=True)
class Up(RunOptions, NetworkOptions):
    """Starts the processes and keeps them running until Ctrl-C or until the robot has finished.

    For example:
      saltus up --terrain flat --planner scripted
      saltus up --speed 0.5 --profile mine --out runs/one
      saltus up --standbys
      saltus up --grid scan
      saltus up --listen 192.168.123.10:7447 --keys keys
    """

    pace: Pace = "realtime"
    standbys: Flag = False
    """Camera, heightmap service and planner each have a second process that works along unheard, and goes on where the
    first was killed; without, the camera has one that waits. On two cores they take the others'
    time."""
    grid: Annotated[str | None, shown("STR", "none beside the planner's")] = None
    """Heights at more points beside those that the planner is given, by the network of any grid, under scan/heightmap:
    scan, or a TOML file. A fifth process tells them."""

    def run(self) -> int:
        """Runs until the end and says how it went; 0 then, 130 after Ctrl-C (the recording is closed either way)."""
        from saltus.grid import load_grid
        from saltus.runtime.programs import PROGRAMS, WITH_STANDBYS, scan
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
            programs = (scan(self.grid), *programs)
        config = self.config(LONGEST_RUN_S)
        network = self.network(config.prefix)
        directory = run_directory("up", self.out)
        stack = Stack(config, directory, programs, network=network)
        try:
            with stack:
                print(
                    f"running, keys under {config.prefix}; join it with {directory / CLIENT_FILE}; "
                    "Ctrl-C ends it"
                )
                for _ in follow(stack):
                    pass
        finally:
            if stack.recording.is_file():
                with contextlib.suppress(
                    RecordingError
                ):  # the disk was full at the start, as is being said
                    _tell(stack.recording, stack.restarts)
        return 0


def _tell(path: Path, restarts: dict[str, int]) -> None:
    from saltus.recordings.recording import read_recording
    from saltus.recordings.summary import sentence, summarise

    print(sentence(summarise(read_recording(path))))
    for process, times in restarts.items():
        if times:
            print(f"{process} was started again {times} times")
    print(f"recording {path}")
