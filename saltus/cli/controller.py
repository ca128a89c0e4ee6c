"""`saltus controller`: run the leg controller and the robot behind it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import subcommand

from saltus.cli.serve import serve


@dataclass(frozen=True, kw_only=True)
class Serve:
    """Runs the controller process against a running stack."""

    endpoint: str
    """Zenoh router, e.g. tcp/127.0.0.1:7447."""
    run_dir: Path
    """Folder with the run's run.toml."""

    def run(self) -> int:
        """Runs until the robot has finished or it is told to stop."""
        return serve("controller", self.run_dir, self.endpoint)


@dataclass(frozen=True, kw_only=True)
class Controller:
    """The leg controller and the robot behind it: serve."""

    command: tyro.conf.OmitSubcommandPrefixes[tyro.conf.OmitArgPrefixes[Annotated[Serve, subcommand("serve")]]]

    def run(self) -> int:
        """Runs the chosen command."""
        return self.command.run()
