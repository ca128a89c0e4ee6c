"""`saltus controller`: run the leg controller and the robot behind it."""

from dataclasses import dataclass
from typing import Literal

import tyro

from saltus.cli.serve import ServeProcess


@dataclass(frozen=True, kw_only=True)
class Controller(ServeProcess):
    """The leg controller and the robot behind it: runs their process against a running stack.

    Example: saltus controller serve --run-dir runs/one
    """

    module = "saltus.controller"
    action: tyro.conf.Positional[Literal["serve"]]
    """The command to run."""
