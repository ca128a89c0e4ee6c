"""Effects: frozen values that each change one signal,
used by plant, camera, training and real2sim alike.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, ClassVar, Generic, Literal, Self, TypeAlias, TypeVar

import numpy as np

from saltus.arrays import Array, Constant, Floats, Namespace, Reals, namespace
from saltus.errors import ConfigError
from saltus.robots.robot import JOINTS, Robot

Site = Literal[
    "command",
    "torque",
    "joint",
    "joint_state",
    "imu",
    "depth",
    "heightmap",
    "model",
    "stand",
    "view",
]

Signal = TypeVar("Signal")
Value = TypeVar("Value")
State = TypeVar("State")
"""Arrays, alone or in tuples and dataclasses."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """A parameter that is drawn anew while its effect is in use, as at each episode of a training.

    Has no TOML form.
    """

    read: Callable[[Array], Array]
    """The present values, as an array of the kind, type and device of the one given.

    Shape (robots, 1 or 12).
    """
    greatest: float
    """No value is greater."""


Values: TypeAlias = float | tuple[float, ...] | Floats
"""A parameter of the joints: one value for all, 12 values in the order of `JOINTS`, or, for a batch
of robots that differ, an array of shape (robots, 1) or (robots, 12), which has no TOML form."""
Drawable: TypeAlias = Values | Drawn
"""A parameter of the joints that trainings may draw."""


PerRobot: TypeAlias = float | Floats
"""A parameter of a camera: one value, or, for a batch of robots that differ, an array of shape
(robots,)."""


def parameter(
    *,
    unit: str,
    null: Value,
    low: float,
    high: float,
    sought: tuple[float, float] | None = None,
    per_joint: bool = False,
    adds_to: str | tuple[str, int] | None = None,
    scales: str | None = None,
) -> Value:
    """Declares a parameter of an effect: its unit, bounds, and the value at which it has no effect.

    Args:
        unit: As in `[unit]`.
        null: Where it changes nothing; the default.
        low: Least value.
        high: Greatest value.
        sought: Between which values fits seek it: what hardware of this class can have; the bounds
            by default.
        per_joint: Whether joints may have different ones.
        adds_to: Field of the signal that it is added to, or that field and the place of one of its
            entries.
        scales: Field of the signal that is multiplied by the parameter over `null`.
    """
    name, axis = adds_to if isinstance(adds_to, tuple) else (adds_to, None)
    changes: dict[str, object] = {
        "changes": name or scales,
        "axis": axis,
        "scales": scales is not None,
    }
    metadata: dict[str, object] = {
        "unit": unit,
        "null": null,
        "low": low,
        "high": high,
        "per_joint": per_joint,
        **changes,
    }
    metadata["sought"] = (low, high) if sought is None else sought
    return field(default=null, metadata=metadata)


def from_robot(source: str, *, unit: str, high: float) -> Any:
    """Declares what an effect takes from a field of the robot if it is not stated.

    Not an effect in itself.
    """
    return field(
        default=None,
        metadata={"unit": unit, "low": 0.0, "high": high, "per_joint": True, "robot": source},
    )


def setting(default: float, *, unit: str, low: float, high: float) -> float:
    """Declares a number that shapes an effect and has no value at which nothing happens."""
    metadata = {"unit": unit, "low": low, "high": high, "per_joint": False}
    return field(default=default, metadata=metadata)


def period(default: float) -> float:
    """Declares the period [s] at which an effect gets its signal."""
    return setting(default, unit="s", low=1e-5, high=1.0)


@dataclass(frozen=True, kw_only=True)
class Effect(Generic[Signal]):
    """One way in which hardware differs from the ideal.

    A subclass is a frozen dataclass whose fields are made with `parameter`. At its null values it
    returns its input unchanged, to the bit. `apply` is written once for numpy and torch and for any
    leading batch dimensions. Signals are values: whoever passes one does not change its arrays
    afterwards, as an effect with memory keeps them.

    Raises:
        ConfigError: a parameter is out of its bounds, not a number, or has neither one value nor
            one per joint.
    """

    name: ClassVar[str]
    """Name in the schema of run logs, snake_case."""
    site: ClassVar[Site]

    def __init_subclass__(
        cls, name: str | None = None, site: Site | None = None, **rest: object
    ) -> None:
        super().__init_subclass__(**rest)
        if name is not None:
            cls.name = name
        if site is not None:
            cls.site = site

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if (
                "low" in f.metadata
                and not isinstance(value, Drawn)
                and not ("robot" in f.metadata and value is None)
            ):
                _check(f"{self.name}.{f.name}", value, f.metadata)

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> Any:
        """State before the first signal, for a batch of robots;
        None where the effect has no memory.
        """
        return None

    def first(self, signal: Signal) -> Any:
        """State as if a robot's first signal had been there for long;
        None where the effect has no memory.
        """

    def apply(self, signal: Signal, time_s: Array, state: Any) -> tuple[Signal, Any]:
        """Returns the changed signal and the next state; changes neither argument.

        Where a subclass does nothing else, parameters add to, or scale, the fields of the signal
        that they name.
        """
        for own, name, axis, null in self._changes:
            array = getattr(signal, name)
            value = self.value(own, array)
            if null is not None:
                changed = array * (value / null)
            elif axis is None:
                changed = array + value
            else:
                entries = [array[..., i] for i in range(array.shape[-1])]
                entries[axis] = entries[axis] + value
                changed = namespace(array).stack(entries, axis=-1)
            signal = dataclasses.replace(signal, **{name: changed})  # type: ignore[type-var]
        return signal, state

    @cached_property
    def _changes(self) -> list[tuple[str, str, int | None, float | None]]:
        """Parameter, the field that it changes, the place therein,
        and for one that scales its null value.
        """
        declared = [(f.name, f.metadata) for f in fields(self) if f.metadata.get("changes")]
        return [
            (name, m["changes"], m["axis"], m["null"] if m["scales"] else None)
            for name, m in declared
        ]

    def value(self, parameter: str, array: Array) -> Array:
        """A parameter in the form in which it combines with `array`:
        a float, or an array of its kind and device.
        """
        value = getattr(self, parameter)
        if isinstance(value, float | int):
            return value
        if isinstance(value, Drawn):
            return value.read(array)
        if parameter not in self._constants:
            self._constants[parameter] = Constant(value)
        return self._constants[parameter].like(array)

    @cached_property
    def _constants(self) -> dict[str, Constant]:
        return {}

    def fitted(self, robot: Robot) -> Self:
        """The effect in the drives of a robot,
        with what `from_robot` declares taken from there unless it is given.
        """
        lacking = [
            f for f in fields(self) if "robot" in f.metadata and getattr(self, f.name) is None
        ]
        # what the robot has without limit is as high as may be
        values = [
            np.minimum(getattr(robot, f.metadata["robot"]), f.metadata["high"]).tolist()
            for f in lacking
        ]
        taken = {f.name: tuple(found) for f, found in zip(lacking, values, strict=True)}
        return dataclasses.replace(self, **taken) if taken else self

    def of_robot(self, name: str) -> Floats:
        """A parameter that `fitted` takes from the robot, or `ConfigError`."""
        values = getattr(self, name)
        if values is None:
            raise ConfigError(f"{self.name}.{name} is not given: fit the effect to a robot first")
        return np.asarray(values, dtype=np.float64)

    def moved(self, **by: float | Reals) -> Self:
        """The effect with parameters changed by so much,
        one number or one a robot, as far as their bounds allow.
        """
        declared = {f.name: f.metadata for f in fields(self)}
        moved = {name: getattr(self, name) + change for name, change in by.items()}
        clipped = {n: np.clip(v, declared[n]["low"], declared[n]["high"]) for n, v in moved.items()}
        return dataclasses.replace(
            self, **{n: v if np.ndim(v) else float(v) for n, v in clipped.items()}
        )

    @classmethod
    def sought(cls, parameter: str) -> tuple[float, float]:
        """Between which values fits seek a parameter, in its unit."""
        declared = next(f.metadata for f in fields(cls) if f.name == parameter)
        low, high = declared.get("sought", (declared["low"], declared["high"]))
        return float(low), float(high)

    def is_null(self) -> bool:
        """True where every parameter has the value at which nothing changes."""
        return self._is_null

    @cached_property
    def _is_null(self) -> bool:
        return all(
            _equal(getattr(self, f.name), f.metadata["null"])
            for f in fields(self)
            if "null" in f.metadata
        )


def as_parameter_of(values: PerRobot, array: Array, xp: Namespace) -> Array:
    """A parameter in the form in which it combines with `array`:
    a float, or an array of its kind, type and device.
    """
    if isinstance(values, float | int):
        return values
    return xp.asarray(np.asarray(values), dtype=array.dtype, device=array.device)


def per_image(value: PerRobot, array: Array, xp: Namespace) -> Array:
    """A parameter in the form in which it combines with images: a float, or shape (..., 1, 1)."""
    found = as_parameter_of(value, array, xp)
    return found if isinstance(found, float | int) or found.ndim == 0 else found[..., None, None]


def pixels_within(value: PerRobot, images: Array) -> Iterator[tuple[int, Array]]:
    """1, 2, ... up to the greatest of a parameter in pixels, rounded,
    each with whether an image's own is as great.
    """
    reach = per_image(value, images, namespace(images))
    greatest = min(math.floor(float(np.max(value)) + 0.5), images.shape[-1] - 1)
    return ((k, reach > k - 0.5) for k in range(1, greatest + 1))


def map_arrays(function: Callable[..., Array], value: State, *others: State) -> State:
    """Applies `function` to every array in a signal or a state,
    e.g. to move it to torch or to pick one robot.

    With `others`, which are built alike, it gets their arrays too.
    """
    if value is None or isinstance(value, float | int):
        return value
    if isinstance(value, tuple):
        parts: Any = tuple(map_arrays(function, *each) for each in zip(value, *others, strict=True))
        return parts
    # Asked last: torch.compile of torch 2.11 cannot ask it of None.
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        return function(value, *others)
    names = [f.name for f in fields(value)]
    changes = {
        n: map_arrays(function, getattr(value, n), *(getattr(other, n) for other in others))
        for n in names
    }
    return dataclasses.replace(value, **changes)


def stack_states(states: Sequence[State]) -> State:
    """The states of single robots as that of a batch, in numpy."""
    return map_arrays(lambda *arrays: np.stack(arrays), *states)


def _check(label: str, value: object, metadata: Mapping[str, Any]) -> None:
    """Checks a parameter against its declaration; the null value is always allowed."""
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"{label} = {value!r} is not a number, or not an array of numbers"
        ) from error
    is_curve = isinstance(metadata.get("null"), tuple)
    if (
        isinstance(value, tuple)
        and not is_curve
        and not (metadata["per_joint"] and numbers.shape == (len(JOINTS),))
    ):
        allowed_count = (
            f"one value, or {len(JOINTS)}, one per joint" if metadata["per_joint"] else "one value"
        )
        raise ConfigError(f"{label} has {len(value)} values: give {allowed_count}")
    low, high = metadata["low"], metadata["high"]
    allowed = (numbers >= low) & (numbers <= high)
    if "null" in metadata and not is_curve:
        allowed |= numbers == metadata["null"]
    if not np.all(allowed):
        raise ConfigError(
            f"{label} = {value!r} must lie within {low:g} to {high:g} {metadata['unit']}".rstrip()
        )


def _equal(value: Values | str, null: Values) -> bool:
    """True where a parameter has its null value, in every entry."""
    if isinstance(null, tuple) or isinstance(value, str):
        return isinstance(value, tuple) and value == null
    try:
        return bool(np.all(np.equal(value, null)))
    except (TypeError, ValueError):  # not numbers, or lists of unequal length
        return False
