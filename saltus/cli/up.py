"""`saltus up`: the processes, until Ctrl-C."""

from dataclasses import dataclass

from saltus.cli.output import follow, run_directory
from saltus.cli.run_options import RunOptions
from saltus.config import LONGEST_RUN_S, Pace


@dataclass(frozen=True, kw_only=True)
class Up(RunOptions):
    """Starts the processes and keeps them running until Ctrl-C or until the robot has finished.

    For example:
      saltus up --terrain flat --planner scripted
      saltus up --speed 0.5 --profile mine --out runs/one
    """

    pace: Pace = "realtime"

    def run(self) -> int:
        """Runs until the end; 0 then, 130 after Ctrl-C (the recording is closed either way)."""
        from saltus.runtime.stack import Stack

        config = self.config(LONGEST_RUN_S)
        directory = run_directory("up", self.out)
        with Stack(config, directory) as stack:
            print(f"running at {stack.endpoint}, keys under {config.prefix}; Ctrl-C ends it; logs in {directory}/logs")
            for _ in follow(stack):
                pass
        return 0
