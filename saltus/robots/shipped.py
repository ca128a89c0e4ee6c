"""Robots that Saltus ships: folders of data beside this module."""

from collections.abc import Mapping
from pathlib import Path

from saltus.config import UNNAMED
from saltus.errors import check_known

SUPPLEMENT_FILE = "robot.toml"
PROFILE_FILE = "profile.toml"
_HERE = Path(__file__).resolve().parent

DEFAULT_ROBOT = "go1"
"""The robot that a command takes where none is named; nothing below the command line reads it."""

REFERENCE = "go1"
"""The robot that the schema of run logs refers to, and whose controller is tuned
(`saltus.robots.similarity`)."""


def robot_name_in(table: Mapping[str, object]) -> str:
    """Name of the robot in a table of a file; where it names none, the first that Saltus shipped.

    Files that name none were written before there were others (`saltus.config.UNNAMED`).
    """
    return str(table.get("robot", UNNAMED["robot"]))


def shipped_robots() -> list[str]:
    """Names of robots."""
    return sorted(file.parent.name for file in _HERE.glob(f"*/{SUPPLEMENT_FILE}"))


def shipped_folder(name: str) -> Path:
    """The folder of one of `shipped_robots`.

    Raises:
        ConfigError: it is none of them.
    """
    check_known("no robot", name, shipped_robots())
    return _HERE / name


def shipped_profiles() -> dict[str, Path]:
    """Files of profiles that robots have as shipped, by the robots' names."""
    return {file.parent.name: file for file in sorted(_HERE.glob(f"*/{PROFILE_FILE}"))}
