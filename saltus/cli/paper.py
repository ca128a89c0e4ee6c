"""`saltus paper`: the paper's tables, figures and claims, made again."""

from dataclasses import dataclass
from importlib import import_module
from typing import Annotated

import tyro

from saltus.cli.checkout import checkout_root
from saltus.cli.parsing import parse
from saltus.flags import Runnable, flag_help


@dataclass(frozen=True, kw_only=True)
class PaperCommand:
    """Makes the paper's tables and figures again from the shipped models:
    lists them, makes one, or a page of all.

    They are part of a checkout, not of a wheel. There `saltus paper --help` says more.
    """

    arguments: Annotated[
        tyro.conf.Positional[tuple[str, ...]], flag_help("...", "none, list them")
    ] = ()
    """Name of the command of the paper, and its flags."""

    def run(self) -> int:
        """Runs the command that `read` reads."""
        return self.read().run()

    def read(self) -> Runnable:
        """Reads the arguments as the command in paper/ takes them.

        Raises:
            SaltusError: this is no checkout, or it takes other arguments.
        """
        checkout_root("paper/command.py", "paper")
        command: Runnable = parse(
            import_module("paper.command").Paper,
            self.arguments,
            prog="saltus paper",
            description=None,
        )
        return command
