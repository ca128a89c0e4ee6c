"""Configuration of a run: frozen keyword-only dataclasses, read from and written to TOML."""

import dataclasses
import hashlib
import math
import re
import tomllib
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

import numpy as np
import tomli_w

from saltus.errors import ConfigError, check_known, nearest_hint

Pace = Literal["lockstep", "realtime"]
RendererName = Literal["auto", "embree", "pyrender", "warp"]
PlannerName = Literal["scripted", "learned"]
PLAN_TOPICS = ("policy/plan", "policy/joints")
"""Topics of plans for jumps, and of joint targets."""
RunPlanner = Literal["scripted", "learned", "walking"]
RunHeights = Literal["predicted", "true"]
LinkName = Literal["here", "dds"]

JUMPING_CAMERA, WALKING_CAMERA = "d435i", "d435i_whole"
"""Cameras of runs and trials that name none. The network of a robot that jumps uses the centre of
an image only; one that walks has its feet beside the middle line, and sees there by the scan's."""

Config = TypeVar("Config")

LONGEST_RUN_S = 1e6
"""Eleven days: as good as without end."""
LOCKSTEP_LINK_SPEED = 0.05
"""Makes Zenoh's own 10 s of the 0.5 s after which a silent link is given up (zenoh_cfg)."""

TOML_MAX = 4 * 2**20
"""Characters of a file: a terrain of 10,000 boxes has a third of it."""
# Its parser takes minutes for thousands
_LONG_NAME = re.compile(r"""(?<![\w"'-])(?:[\w"'-]++[ \t]*\.[ \t]*){30}""")

UNNAMED = {"robot": "go1", "grid": "line"}
"""Robot and grid of files that name none: they were written before there were others."""


@dataclass(frozen=True, kw_only=True)
class TerrainConfig:
    """Settings of a run's terrain: its name and size. A size wins over the difficulty."""

    terrain: str = "stairs"
    """flat, stairs, stepping_stones, step, gap, stairs_down, step_down, pyramid, irregular
    (stairs), hurdles, ditch, ramp_up, ramp_down, house, quarry, yard, plain, rubble, stones,
    flight, edges, a family of your own, or a TOML file with boxes or segments."""
    difficulty: float | None = None
    """0 (easiest) to 1: sets the sizes that are not given."""
    steps: int | None = None
    """Number of stairs, of stepping stones, of hurdles."""
    rise_m: float | None = None
    """Height of a stair; of irregular ones the greatest, negative leads down."""
    run_m: float | None = None
    """Depth of a stair; from one hurdle to the next; length of a ramp along the ground."""
    stone_m: float | None = None
    """Length of a stepping stone."""
    gap_m: float | None = None
    """Length of a gap, between stones or of the one trench."""
    gap_max_m: float | None = None
    """Every gap between stones is drawn from gap_m to this."""
    layout_seed: int = 0
    """Seed of what is drawn; trials of an evaluation have their own."""
    height_m: float | None = None
    """Height of a single step up or down, or of a hurdle."""
    depth_m: float | None = None
    """Depth of a ditch."""
    depth_max_m: float | None = None
    """The depth of a ditch is drawn from depth_m to this."""
    slope_deg: float | None = None
    """Slope of a ramp."""


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """Everything that the processes of one run agree on."""

    robot: str
    """Name of a robot that Saltus ships, or path of an MJCF or of a folder with a robot.toml."""
    grid: str
    """Name of a grid of heights that Saltus ships, or path of a TOML file (`saltus.grid`)."""
    prefix: str = "robot/0"
    """Prefix of every key."""
    terrain: TerrainConfig = field(default_factory=TerrainConfig)
    seed: int = 0
    pace: Pace = "lockstep"
    renderer: RendererName = "auto"
    camera: str = "ideal"
    """"ideal": true depth at the model's resolution. "d435i": a stereo camera's errors at 80x240.

    "d435i_whole": at 70x40, four times as wide. Or a TOML file.
    """
    profile: str = "shipped"
    """Effects of the hardware: "shipped" (those of the robot), "ideal", or the name or path of a
    TOML profile."""
    known: str | None = None
    """Profile of what is known of the drives, by name or path: the leg controller takes it out of
    its commands."""
    planner: RunPlanner = "learned"
    """scripted: rules that read the heightmap. learned: a network. walking: a network that commands
    joints."""
    policy_model: str | None = None
    """Path of the learned planner's ONNX file, or of the walking one's; by default the shipped
    policy."""
    heightmap_model: str | None = None
    """Path of the heightmap service's ONNX file; by default the shipped one."""
    heights: RunHeights = "predicted"
    """predicted: the heightmap service's network makes them of images. true: the service says the
    ground as the simulator has it."""
    commands: str | None = None
    """Path of a script of commands (`saltus.drive.script`), which an operator's process gives: in
    lockstep the planner waits for the command of each step."""
    time_limit_s: float = 20.0
    link: LinkName = "here"
    """here: the robot is simulated in the controller's process. dds: it is another process, which
    is spoken to over its own protocol."""
    domain: int = 1
    """DDS domain of a robot over DDS."""
    interface: str = "lo"
    """Network interface to it."""
    speed: float = 1.0
    """Real time: seconds of the run for each second of the machine, more than 0 and at most 1."""
    epoch_ns: int = 0
    """Start of the run on the monotonic clock of this machine.

    The zero of the run's clock in real time.
    """

    @property
    def plan_topics(self) -> tuple[str, ...]:
        """Topics on which the planner of this run publishes its plans, out of `PLAN_TOPICS`."""
        return PLAN_TOPICS if self.planner == "walking" else PLAN_TOPICS[:1]

    @property
    def link_speed(self) -> float:
        """Divisor of the 0.5 s after which a silent link is given up
        (`saltus.wire.joining`, its `speed`).

        In real time the clock's own; in lockstep, where nobody is late however slow,
        `LOCKSTEP_LINK_SPEED`.
        """
        return self.speed if self.pace == "realtime" else LOCKSTEP_LINK_SPEED

    def check(self) -> None:
        """Raises what would make a run fail; called before one begins, not where one is read:
        older recordings may hold what was ignored then.

        Raises:
            ConfigError: it has no end, or a prefix or speed that no run can have.
        """
        if not re.fullmatch(r"[\w.-]+(/[\w.-]+)*", self.prefix):
            raise ConfigError(
                f"prefix = '{self.prefix}': it must be names with / between them, e.g. robot/0"
            )
        if not 0.0 < self.speed <= 1.0:
            raise ConfigError(
                f"speed = {self.speed:g}: it must be more than 0 and at most 1 (real time)"
            )
        if self.speed < 1.0 and self.pace == "lockstep":
            raise ConfigError(
                f"speed = {self.speed:g}: a lockstep run has no clock to slow; use pace = "
                f'"realtime"'
            )
        if not 0.0 < self.time_limit_s <= LONGEST_RUN_S:
            raise ConfigError(
                f"time_limit_s = {self.time_limit_s:g}: it must be more than 0, up to "
                f"{LONGEST_RUN_S:g}"
            )


class TomlValue:
    """A frozen dataclass that is handed down, with a TOML form that reads back equal to the bit."""

    @classmethod
    def from_toml(cls, text: str) -> Self:
        """Reads what `to_toml` writes; the errors of `saltus.config.from_toml`."""
        return from_toml(cls, text)

    def to_toml(self) -> str:
        """The value as TOML."""
        return to_toml(self)

    @cached_property
    def fingerprint(self) -> str:
        """Changes with every number of the value:
        first 16 hexadecimal digits of the sha256 of its TOML.
        """
        return hashlib.sha256(self.to_toml().encode()).hexdigest()[:16]


def check_between(config: object, **ranges: tuple[float, float]) -> None:
    """Raises `ConfigError` for the first field with a number outside of its range (ends included),
    or with none.

    A field that is None is left to whoever fills it in.
    """
    for name, (low, high) in ranges.items():
        value = getattr(config, name)
        numbers = value if isinstance(value, tuple) else () if value is None else (value,)
        if not all(low <= number <= high for number in numbers):
            limits = f"{low} to {high}" if high != math.pi else "-pi to pi radians"
            raise ConfigError(f"{name} = {value}: it must be from {limits}")


def to_toml(config: object) -> str:
    """Writes a config dataclass as TOML; fields that are None are left out."""
    return tomli_w.dumps(_plain(config), multiline_strings=True)


def from_toml(kind: type[Config], text: str) -> Config:
    """Reads a config dataclass from TOML.

    Raises:
        ConfigError: not TOML, an unknown key (the nearest known one is named), a missing key, a
            value of a wrong type.
    """
    return from_table(kind, read_toml(text))


def read_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text, or `ConfigError`."""
    if _LONG_NAME.search(text):
        raise ConfigError("not valid TOML: a name has more than 30 parts")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ConfigError("not valid TOML: its tables are nested too deeply") from error
    except ValueError as error:  # also of a number with thousands of digits
        raise ConfigError(f"not valid TOML: {error}") from error


def from_table(kind: type[Config], table: Mapping[str, object], where: str = "") -> Config:
    """Builds a config dataclass from nested tables; same errors as `from_toml`."""
    hints = typing.get_type_hints(kind)
    keys = [f for f in dataclasses.fields(kind) if f.init]  # type: ignore[arg-type]
    known = [f.name for f in keys]
    values: dict[str, object] = {}
    for name, value in table.items():
        path = f"{where}{name}"
        check_known("unknown key", name, known, within=where)
        values[name] = _checked(hints[name], value, path)
    for key in keys:
        if key.name not in values and key.default is key.default_factory is dataclasses.MISSING:
            if key.name in UNNAMED:
                values[key.name] = UNNAMED[key.name]
                continue
            raise ConfigError(f"the key '{where}{key.name}' is missing")
    return kind(**values)


def load_config(kind: type[Config], path: Path) -> Config:
    """Reads a config dataclass, or a value in the form of its own, from a TOML file.

    Errors name the file.
    """
    read: Callable[[str], Config] = getattr(kind, "from_toml", partial(from_toml, kind))
    return read_file(path, read)


def load_changes(config: Config, path: Path) -> Config:
    """`config` with what a TOML file names of it in place of its own values.

    Errors name the file.
    """
    return read_file(path, lambda text: with_changes(config, read_toml(text)))


def with_changes(config: Config, table: Mapping[str, object], where: str = "") -> Config:
    """A copy of a configuration with the entries of a table changed;
    raises what `from_toml` raises.
    """
    return from_table(type(config), _merged(_plain(config), table), where)


def read_file(path: Path, make: Callable[[str], Config]) -> Config:
    """Value that `make` makes of the text of a file; errors name the file.

    Raises:
        ConfigError: the file cannot be read, is no text, or what `make` raises.
    """
    try:
        with path.open(encoding="utf-8-sig") as file:  # some editors begin a file with a mark
            text = file.read(TOML_MAX + 1)
        if len(text) > TOML_MAX:
            raise ConfigError(f"not valid TOML: it is longer than {TOML_MAX} characters")
        return make(text)
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{path}: not valid TOML: it is not text in UTF-8 (save it as UTF-8)"
        ) from error
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def _merged(table: dict[str, Any], changes: Mapping[str, object]) -> dict[str, Any]:
    """`table` with the entries of `changes` in place of its own, table by table."""
    merged = dict(table)
    for name, value in changes.items():
        own = table.get(name)
        if isinstance(value, dict) and isinstance(own, dict):
            value = _merged(own, value)
        merged[name] = value
    return merged


def _plain(value: object) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        pairs = ((f.name, getattr(value, f.name)) for f in dataclasses.fields(value))
        return {name: _plain(item) for name, item in pairs if item is not None}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, Path):
        return str(value)
    return value


def _checked(hint: object, value: object, path: str) -> object:
    """Returns `value` as `hint` wants it; integers may stand for floats."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        if not isinstance(value, dict):
            raise ConfigError(f"'{path}' must be a table, not {value!r}")
        return from_table(hint, value, f"{path}.")
    if origin is Literal:
        if value not in args:
            raise ConfigError(f"'{path}' = {value!r}: {nearest_hint(str(value), map(str, args))}")
        return value
    if origin is typing.Union or type(hint).__name__ == "UnionType":
        options = [option for option in args if option is not type(None)]
        for option in options:
            if len(options) == 1 or (dataclasses.is_dataclass(option) and isinstance(value, dict)):
                return _checked(option, value, path)
            try:
                return _checked(option, value, path)
            except ConfigError:
                continue
        raise ConfigError(
            f"'{path}' = {value!r} must be {' or '.join(dict.fromkeys(map(_in_words, options)))}"
        )
    if origin is tuple:
        if not isinstance(value, list):
            raise ConfigError(f"'{path}' must be a list, not {value!r}")
        item_hints = (
            [args[0]] * len(value) if len(args) == 2 and args[1] is Ellipsis else list(args)
        )
        if len(item_hints) != len(value):
            raise ConfigError(f"'{path}' must have {len(item_hints)} entries, not {len(value)}")
        return tuple(
            _checked(h, v, f"{path}[{i}]")
            for i, (h, v) in enumerate(zip(item_hints, value, strict=True))
        )
    if origin is np.ndarray:
        try:
            return np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise ConfigError(f"'{path}' must hold numbers, not {value!r}") from None
    if origin is dict:
        if not isinstance(value, dict):
            raise ConfigError(f"'{path}' must be a table, not {value!r}")
        return {name: _checked(args[1], item, f"{path}.{name}") for name, item in value.items()}
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            raise ConfigError(f"'{path}' is a number of {len(str(value))} digits") from None
    if hint is float and isinstance(value, float) and math.isnan(value):
        raise ConfigError(f"{path} = nan: it must be a number")
    if hint is Path and isinstance(value, str):
        return Path(value)
    if hint is Any:
        return value
    if isinstance(hint, type) and (
        not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool)
    ):
        raise ConfigError(f"'{path}' = {value!r} must be {_in_words(hint)}")
    return value


def _in_words(hint: object) -> str:
    """A type in words for people."""
    words: dict[object, str] = {
        float: "a number",
        int: "a whole number",
        bool: "true or false",
        str: "text",
        Path: "a path",
    }
    listed = typing.get_origin(hint) in (tuple, np.ndarray)
    return "a list" if listed else words.get(hint, "a table")
