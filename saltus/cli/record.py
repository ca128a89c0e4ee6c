"""`saltus record`: record a stack that somebody else has started, and repair recordings."""

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from saltus.cli.output import run_directory
from saltus.flags import CommandGroup, EndpointOption, Subcommands, flag_help

DRAIN_PERIOD_S = 0.02


@dataclass(frozen=True, kw_only=True)
class RecordRun(EndpointOption):
    """Records a running stack until Ctrl-C or until its router is gone.

    Example: saltus record run --run-dir runs/one
    """

    run_dir: Path
    """Folder of the run, with run.toml."""
    out: Annotated[Path | None, flag_help("PATH", "a new one, runs/DATE-record")] = None
    """Folder for the recording."""

    def run(self) -> int:
        """Writes recording.mcap; 0 where the stack ended,
        130 after Ctrl-C (the recording is closed either way).
        """
        record_stack(self.run_dir, self.endpoint, self._begin)
        return 0

    def _begin(self) -> Path:
        path = run_directory("record", self.out) / "recording.mcap"
        print(f"recording to {path}; Ctrl-C ends it")
        return path


def record_stack(
    run_dir: Path, endpoint: str | None, begin: Callable[[], Path], seconds: float = math.inf
) -> None:
    """Records a stack until its router is gone, or for so long [s];
    `begin`, called when there is one, says where to.

    Raises:
        StackError: no router answers at the endpoint, by default that of the folder of the run.
    """
    from saltus.interrupts import WHOLE
    from saltus.recordings.recorder import Recorder
    from saltus.runtime.run_folder import endpoint_of, read_run
    from saltus.wire.zenoh_bus import ZenohBus

    run = read_run(run_dir)
    with (
        ZenohBus(endpoint or endpoint_of(run_dir), run.config.prefix) as bus,
        contextlib.ExitStack() as resources,
    ):
        with WHOLE:  # who is interrupted has a recording that ends, or none
            recorder = resources.enter_context(Recorder(begin(), run.config, run.setup))
        stream, end_s = bus.stream(), time.monotonic() + seconds
        while bus.connected() and time.monotonic() < end_s:
            recorder.write_all(stream)
            recorder.flush()
            time.sleep(DRAIN_PERIOD_S)


@dataclass(frozen=True, kw_only=True)
class Repair:
    """Writes what is sound of a damaged recording as a file that every reader of MCAP opens.

    For example:
      saltus record repair runs/one/recording.mcap
      saltus record repair cut.mcap --out whole.mcap
    """

    recording: tyro.conf.Positional[Path]
    """The recording (.mcap), which stays as it is."""
    out: Annotated[Path | None, flag_help("PATH", "beside it, NAME.repaired.mcap")] = None
    """The new file."""

    def run(self) -> int:
        """Repairs it, and says what is lost; 0, also where there is nothing to repair."""
        from saltus.recordings.repair import repair_recording

        out = self.out or self.recording.with_suffix(".repaired.mcap")
        recording = repair_recording(self.recording, out)
        for line in recording.lost:
            print(f"lost: {line}")
        print(f"{self.recording} is whole" if recording.complete else f"repaired {out}")
        return 0


@dataclass(frozen=True, kw_only=True)
class RecordCommands(CommandGroup):
    """Recordings: run (of a stack that somebody else has started), repair."""

    command: Subcommands[Annotated[RecordRun, tyro.conf.subcommand("run")] | Repair]
