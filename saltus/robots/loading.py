"""Robots by name or by path."""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from saltus.errors import ConfigError
from saltus.robots.robot import Robot
from saltus.robots.shipped import REFERENCE, SUPPLEMENT_FILE, shipped_folder, shipped_robots
from saltus.robots.supplement import load_supplement

if TYPE_CHECKING:
    from saltus.robots.mjcf import RobotDerivation

MODEL_SUFFIXES = (".xml", ".mjcf")  # MuJoCo knows no format by another one


def load_robot(name_or_path: str) -> Robot:
    """A robot by name, or from a folder with a robot.toml, from such a file, or from an MJCF alone.

    Raises:
        ConfigError: there is no such robot, or its TOML cannot be read.
        ModelError: its model cannot be read, or its legs are not of our kind.
    """
    return (
        _shipped(name_or_path)
        if name_or_path in shipped_robots()
        else derive_robot(name_or_path).robot
    )


def reference_robot() -> Robot:
    """The robot to whose torque limits the schema of run logs refers
    where a log's own model states none.
    """
    return load_robot(REFERENCE)


def derive_robot(name_or_path: str, supplement: Path | None = None) -> "RobotDerivation":
    """Makes a robot of an MJCF, a folder or a shipped name, and says where each field comes from.

    A folder's robot.toml is its supplement where none is given.
    """
    from saltus.robots.mjcf import (
        derive_robot,  # with MuJoCo, which flags that name a robot do not need
    )

    path = shipped_folder(name_or_path) if name_or_path in shipped_robots() else Path(name_or_path)
    if path.is_dir():
        path = _supplement_of(path)
    if path.suffix == ".toml":
        supplement, path = supplement or path, _model_of(path)
    if path.suffix not in MODEL_SUFFIXES or not path.is_file():
        raise ConfigError(_no_robot(name_or_path, path))
    return derive_robot(path, supplement)


def _no_robot(name_or_path: str, path: Path) -> str:
    """Why there is none, and what to give."""
    if path.suffix in MODEL_SUFFIXES:
        named = "" if str(path) == name_or_path else f", which '{name_or_path}' names"
        return f"no robot '{name_or_path}': there is no file '{path}'{named}"
    ships = ", ".join(shipped_robots())
    return (
        f"no robot '{name_or_path}': Saltus ships {ships}; of another give the path of its MJCF "
        "(.xml), or of a folder "
        "with a robot.toml (docs/robots.md)"
    )


def _supplement_of(folder: Path) -> Path:
    """Its robot.toml."""
    path = folder / SUPPLEMENT_FILE
    if not path.is_file():
        models = sorted(each.name for each in folder.iterdir() if each.suffix in MODEL_SUFFIXES)
        instead = (
            f"name its model, {folder / models[0]}" if models else "put the robot's MJCF there"
        )
        raise ConfigError(
            f"there is no {path}: {instead}, or write {SUPPLEMENT_FILE} with the line mjcf = "
            f'"{models[0] if models else "robot.xml"}" (docs/robots.md)'
        )
    return path


@cache
def _shipped(name: str) -> Robot:
    return derive_robot(name).robot


def _model_of(supplement: Path) -> Path:
    """The MJCF that a TOML names, or the only one beside it."""
    named = load_supplement(supplement).mjcf
    if named is not None:
        return supplement.parent / named
    beside = sorted(supplement.parent.glob("*.xml"))
    if len(beside) != 1:
        raise ConfigError(
            f"{supplement}: it names no mjcf, and {len(beside)} .xml files lie beside it: add mjcf "
            f'= "..."'
        )
    return beside[0]
