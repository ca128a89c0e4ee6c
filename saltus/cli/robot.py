"""`saltus robot`: what Saltus makes of a robot's model."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from saltus.cli.output import JsonOption, print_json
from saltus.cli.robot_link import LogRobot, Preflight, RunRobot
from saltus.cli.robot_simulate import Simulate
from saltus.cli.robot_states import TellStates
from saltus.flags import CommandGroup, Subcommands, flag_help

if TYPE_CHECKING:
    from saltus.robots.mjcf import RobotDerivation
    from saltus.robots.robot import Robot

WORDS = {
    "model": "read from the model",
    "toml": "given by the TOML",
    "derived": "derived",
    "guessed": "guessed: nobody says it",
    "missing": "missing",
}


@dataclass(frozen=True, kw_only=True)
class ShowRobot(JsonOption):
    """Says what was derived of a robot, from where, and what is missing.

    For example:
      saltus robot show go1
      saltus robot show my_robot.xml my_robot.toml
    """

    robot: Annotated[str, tyro.conf.Positional]
    """Name of a shipped robot, an MJCF, or a folder with a robot.toml."""
    toml: Annotated[
        Path | None, tyro.conf.Positional, flag_help("TOML", "that of the robot's folder, or none")
    ] = None
    """A file with what the MJCF cannot say: limits, stand pose, gains, camera mount, ... (that of a
    shipped robot has all)."""

    def run(self) -> int:
        """Prints the robot; 0."""
        from saltus.robots.loading import derive_robot

        derivation = derive_robot(self.robot, self.toml)
        if self.json:
            print_json(_table(derivation))
        else:
            print("\n".join(_lines(derivation)))
        return 0


@dataclass(frozen=True, kw_only=True)
class ListRobots:
    """Names the robots that Saltus ships.

    Example: saltus robot list
    """

    def run(self) -> int:
        """Prints a name a line; 0."""
        from saltus.robots.shipped import shipped_robots

        print("\n".join(shipped_robots()))
        return 0


@dataclass(frozen=True, kw_only=True)
class RobotCommands(CommandGroup):
    """Robots as Saltus knows them, and over their own protocol:
    show, list, simulate, preflight, run, log, states.
    """

    command: Subcommands[
        Annotated[ShowRobot, tyro.conf.subcommand("show")]
        | Annotated[ListRobots, tyro.conf.subcommand("list")]
        | Simulate
        | Preflight
        | Annotated[RunRobot, tyro.conf.subcommand("run")]
        | Annotated[LogRobot, tyro.conf.subcommand("log")]
        | Annotated[TellStates, tyro.conf.subcommand("states")]
    ]


def _lines(derivation: "RobotDerivation") -> list[str]:
    robot = derivation.robot
    lines = [
        f"{robot.name}: {robot.mass:.2f} kg, legs of {robot.thigh_length:.3f} + "
        f"{robot.calf_length:.3f} m, "
        f"fingerprint {robot.fingerprint}"
    ]
    for kind, words in WORDS.items():
        origins = [origin for origin in derivation.origins if origin.kind == kind]
        lines += ["", words] if origins else []
        for origin in origins:
            detail = f"  ({origin.detail})" if origin.detail else ""
            lines.append(f"  {origin.field:17} {_text(robot, origin.field)}{detail}")
    return lines


def _table(derivation: "RobotDerivation") -> dict[str, object]:
    robot = derivation.robot
    values = {f.name: getattr(robot, f.name) for f in fields(robot)}
    plain = {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in values.items()
    }
    return {
        "robot": {**plain, "gains": asdict(robot.gains)},
        "fingerprint": robot.fingerprint,
        "mass": robot.mass,
        "origins": [asdict(origin) for origin in derivation.origins],
    }


def _text(robot: "Robot", name: str) -> str:
    """A value in a few words; of joints those of one leg where all legs are alike."""
    value = getattr(robot, name)
    if name == "mjcf":
        return ""
    if name == "gains":
        return "  ".join(f"{key} {gain:.4g}" for key, gain in asdict(value).items())
    array = np.asarray(value)
    if array.shape == (12,) and (array.reshape(4, 3) == array[:3]).all():
        return f"{_numbers(array[:3])} each leg"
    return _numbers(array.ravel()) if array.dtype.kind == "f" else str(value)


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.4g}" for value in values)
