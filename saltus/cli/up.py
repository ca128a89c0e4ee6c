"""`saltus up`: the processes, until Ctrl-C."""

from dataclasses import dataclass
from pathlib import Path

from saltus.cli.output import follow, run_directory
from saltus.cli.run_options import RunOptions
from saltus.config import Pace

FOREVER_S = 1e6


@dataclass(frozen=True, kw_only=True)
class Up(RunOptions):
    """Starts the processes and keeps them running until Ctrl-C or until the robot has finished."""

    pace: Pace = "realtime"
    """realtime: by the clock, times speed. lockstep: bit-repeatable, as fast as it goes."""
    out: Path | None = None
    """Folder for logs and recording; a new one under runs/ where it is not given."""

    def run(self) -> int:
        """Runs until the end; 0 then, 130 after Ctrl-C (the recording is closed either way)."""
        from saltus.runtime.stack import Stack

        config = self.config(self.pace, FOREVER_S)
        directory = run_directory("up", self.out)
        with Stack(config, directory) as stack:
            print(f"running at {stack.endpoint}, keys under {config.prefix}; Ctrl-C ends it; logs in {directory}/logs")
            for _ in follow(stack):
                pass
        return 0
