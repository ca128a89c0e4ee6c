"""`saltus controller`: run the leg controller and the robot behind it."""

from dataclasses import dataclass
from typing import Annotated

import tyro
from tyro.conf import subcommand

from saltus.cli.serve import ServeProcess


@dataclass(frozen=True, kw_only=True)
class Serve(ServeProcess):
    """Runs the controller process against a running stack."""

    module = "saltus.controller"


@dataclass(frozen=True, kw_only=True)
class Controller:
    """The leg controller and the robot behind it: serve."""

    command: tyro.conf.OmitSubcommandPrefixes[tyro.conf.OmitArgPrefixes[Annotated[Serve, subcommand("serve")]]]

    def run(self) -> int:
        """Runs the chosen command."""
        return self.command.run()
