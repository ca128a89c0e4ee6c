"""A profile: the effects of one robot's hardware, as a value and as a TOML file.

In TOML an effect is a table under its site's part, with its parameters as keys, e.g.

    [actuator.feedforward_delay]
    delay = 0.01

    [camera.camera_latency]
    latency = 0.05
"""

import math
import os
import re
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import tomli_w

from saltus.config import TomlValue, read_file, read_toml
from saltus.effects.camera import CameraChain, ViewChain
from saltus.effects.chain import ActuatorChain, BodyChain, ImuChain
from saltus.effects.effect import Effect
from saltus.effects.heightmap_shift import HeightmapShift
from saltus.errors import ConfigError, check_known, nearest_hint
from saltus.robots.robot import Robot
from saltus.robots.shipped import shipped_profiles
from saltus.wire.topics import Topic, depth_topic

_ORDERS = (
    ActuatorChain.order,
    CameraChain.order,
    ViewChain.order,
    (HeightmapShift,),
    BodyChain.order,
    ImuChain.order,
)
EFFECTS: dict[str, type[Effect]] = {kind.name: kind for order in _ORDERS for kind in order}
"""Every effect that Saltus knows, by the name under which logs, profiles and reports speak of
it."""


PARTS = {
    "command": "actuator",
    "torque": "actuator",
    "joint": "actuator",
    "joint_state": "actuator",
    "depth": "camera",
    "view": "camera",
    "heightmap": "heightmap",
    "imu": "imu",
    "model": "body",
    "stand": "body",
}
"""Part of a profile in which the effects of each site stand."""


@dataclass(frozen=True, kw_only=True)
class Profile(TomlValue):
    """A profile: all effects of one robot's hardware that a simulation has.

    Raises:
        ConfigError: an effect that is given twice, or in a part where it does not belong.
    """

    actuator: tuple[Effect, ...] = ()
    camera: tuple[Effect, ...] = ()
    heightmap: tuple[Effect, ...] = ()
    imu: tuple[Effect, ...] = ()
    body: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        for part in (f.name for f in fields(self)):
            names = [effect.name for effect in getattr(self, part)]
            for effect in getattr(self, part):
                if PARTS.get(effect.site) != part:
                    raise ConfigError(
                        f"'{effect.name}' is no effect of the part '{part}' of a profile"
                    )
                if names.count(effect.name) > 1:
                    raise ConfigError(
                        f"'{effect.name}' is given twice in the part '{part}' of a profile"
                    )

    @classmethod
    def from_toml(cls, text: str) -> Self:
        """Reads a profile; the errors of `load_profile`."""
        known = [f.name for f in fields(cls)]
        parts: dict[str, tuple[Effect, ...]] = {}
        for part, effects in read_toml(text).items():
            if part not in known:
                raise ConfigError(
                    f"unknown part '{part}' of a profile: {nearest_hint(part, known)}"
                )
            parts[part] = tuple(
                _effect(part, name, values) for name, values in _table(part, effects).items()
            )
        return cls(**parts)

    def to_toml(self) -> str:
        """Writes it; parameters at their null values are left out.

        All robots must share its parameters.

        Raises:
            ConfigError: a parameter that differs from robot to robot.
        """
        table = {
            f.name: {effect.name: _parameters(effect) for effect in getattr(self, f.name)}
            for f in fields(self)
            if getattr(self, f.name)
        }
        return tomli_w.dumps(table)

    def having(self, *effects: Effect) -> "Profile":
        """A copy of the profile with further effects, each the last of its part;
        one of the same name is replaced.
        """
        profile = self
        for effect in effects:
            part = PARTS[effect.site]
            others = (known for known in getattr(profile, part) if known.name != effect.name)
            profile = replace(profile, **{part: (*others, effect)})
        return profile

    def without(self, *names: str) -> "Profile":
        """Without the effects of these names."""
        parts = (part.name for part in fields(self))
        return replace(
            self,
            **{
                part: tuple(e for e in getattr(self, part) if e.name not in names) for part in parts
            },
        )

    @property
    def effects(self) -> dict[str, Effect]:
        """All effects by their names."""
        return {effect.name: effect for part in fields(self) for effect in getattr(self, part.name)}

    @property
    def actuator_chain(self) -> ActuatorChain:
        """The actuator's effects in their order."""
        return ActuatorChain(self.actuator)

    @property
    def camera_chain(self) -> CameraChain:
        """The effects on the camera's images in their order."""
        return CameraChain(tuple(effect for effect in self.camera if effect.site == "depth"))

    @property
    def depth_topic(self) -> Topic:
        """The topic of this robot's images."""
        return depth_topic(float(self.camera_chain.latency.latency))

    @property
    def view_chain(self) -> ViewChain:
        """The effects on where the camera sits and how wide it looks."""
        return ViewChain(tuple(effect for effect in self.camera if effect.site == "view"))

    @property
    def body_chain(self) -> BodyChain:
        """The effects on the robot's model."""
        return BodyChain(self.body)

    @property
    def imu_chain(self) -> ImuChain:
        """The IMU's effects in their order."""
        return ImuChain(self.imu)


IDEAL = Profile()
"""No effects at all."""

SHIPPED = "shipped"
"""Names the profile that a robot has as shipped."""
_IDEAL = "ideal"


def profiles_folder() -> Path:
    """Where profiles of one's own lie: what SALTUS_PROFILES names,
    else `profiles` in the working directory.
    """
    return Path(os.environ.get("SALTUS_PROFILES", "profiles"))


def save_profile(name: str, profile: Profile) -> Path:
    """Writes a profile where `load_profile` finds it by name; returns the file.

    Raises:
        ConfigError: a name that is none or taken by a profile that Saltus ships, or a folder that
            cannot be written.
    """
    taken = [SHIPPED, _IDEAL, *shipped_profiles()]
    if name in taken or not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise ConfigError(
            f"'{name}' cannot name a profile: use letters, digits, _ and -; taken are "
            f"{', '.join(taken)}"
        )
    path = profiles_folder() / f"{name}.toml"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(profile.to_toml(), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write the profile {path}: {error.strerror}") from error
    return path


def load_profile(name_or_path: str, robot: Robot) -> Profile:
    """A profile by name, or from a TOML file.

    A name is "shipped" (the one that the robot has as shipped), "ideal", a robot that Saltus ships
    with a profile, or a file of `profiles_folder`. Names that Saltus ships come first, then a path
    that exists or ends in .toml, then that folder. `robot` says only what "shipped" is.

    Raises:
        ConfigError: neither a name nor a file; not TOML; an unknown effect or parameter (the
            nearest is named); a value out of bounds.
    """
    name = robot.profile if name_or_path == SHIPPED else name_or_path
    if name == _IDEAL:
        return IDEAL
    path, own, shipped = Path(name), profiles_folder(), shipped_profiles()
    if name in shipped:
        path = shipped[name]
    elif path.suffix != ".toml" and not path.is_file():
        path = own / f"{name}.toml"
        if not path.is_file():
            known = [SHIPPED, _IDEAL, *shipped, *(file.stem for file in own.glob("*.toml"))]
            raise ConfigError(
                f"no profile '{name}', and no file {path.absolute()}: {nearest_hint(name, known)}; "
                "or give a TOML file"
            )
    return read_file(path, Profile.from_toml)


def _effect(part: str, name: str, values: Any) -> Effect:
    choices = [kind.name for kind in EFFECTS.values() if PARTS[kind.site] == part]
    check_known("unknown effect", name, choices, within=f"{part}.")
    kind = EFFECTS[name]
    known = [f.name for f in fields(kind)]
    for key in _table(f"{part}.{name}", values):
        check_known("unknown parameter", key, known, within=f"{part}.{name}.")
    return kind(**{key: _value(f"{part}.{name}.{key}", value) for key, value in values.items()})


def _table(where: str, value: object) -> dict[str, object]:
    if not isinstance(value, dict):
        raise ConfigError(f"'{where}' must be a table, not {value!r}")
    return value


def _value(where: str, value: object) -> object:
    """Numbers as floats, lists as tuples."""
    if isinstance(value, list):
        return tuple(_value(where, item) for item in value)
    if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
        raise ConfigError(f"'{where}' = {value!r} must be a number or a list of numbers")
    return float(value)


def _parameters(effect: Effect) -> dict[str, object]:
    values = {f.name: getattr(effect, f.name) for f in fields(effect)}
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            raise ConfigError(
                f"{effect.name}.{name} differs from robot to robot: a profile describes one robot"
            )
    nulls = {f.name: f.metadata.get("null", f.default) for f in fields(effect)}
    return {name: value for name, value in values.items() if value != nulls[name]}
