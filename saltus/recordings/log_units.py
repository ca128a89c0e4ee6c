"""Units in which other people's recordings come, and the one place that turns them into SI units.

A unit is a name of the tables below, or a number: how many SI units one of it is (-1 for a sign
that is flipped).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import AnyArray, Floats
from saltus.config import from_table
from saltus.depth import MILLIMETRE
from saltus.errors import ConfigError, RecordingError, check_known, nearest_hint

Log = TypeVar("Log")
"""`saltus.recordings.run_log.RunLog`, whose module reads by this one."""
Unit = str | float | None
FARTHEST_MM = 65535
"""Largest distance that uint16 holds."""
POUND_FORCE_N, INCH_M = 4.4482216152605, 0.0254
STANDARD_GRAVITY = 9.80665
"""The pound, the inch and g are exact by definition (NIST Special Publication 811, appendix B)."""

TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ANGLES = {"rad": 1.0, "deg": math.pi / 180.0, "mrad": 1e-3, "rev": 2.0 * math.pi}
SPEEDS = {
    "rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0, "rev/s": 2.0 * math.pi,
    "mrad/s": 1e-3,
    "mdeg/s": 1e-3 * math.pi / 180.0,
}  # fmt: skip
TORQUES = {
    "Nm": 1.0, "mNm": 1e-3, "kgf cm": 1e-2 * STANDARD_GRAVITY, "kgf m": STANDARD_GRAVITY,
    "gf cm": 1e-5 * STANDARD_GRAVITY, "lbf ft": 12.0 * POUND_FORCE_N * INCH_M,
    "lbf in": POUND_FORCE_N * INCH_M,
    "ozf in": POUND_FORCE_N * INCH_M / 16.0,
}  # fmt: skip
ACCELERATIONS = {
    "m/s^2": 1.0,
    "g": STANDARD_GRAVITY,
    "mg": 1e-3 * STANDARD_GRAVITY,
    "mm/s^2": 1e-3,
    "cm/s^2": 1e-2,
}
LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": INCH_M, "ft": 12.0 * INCH_M}
VELOCITIES = {
    **{f"{name}/s": metres for name, metres in LENGTHS.items()},
    **LENGTHS,
    "km/h": 1.0 / 3.6,
}


@dataclass(frozen=True)
class LogSignal:
    """A signal of a run log that has one unit, and the units in which others log it."""

    key: str
    """Field of `LogUnits` that says it."""
    units: dict[str, float]
    """How many SI units one of each is."""
    table: str = "joints"
    columns: tuple[int, int] = (0, 0)
    """First column and end, of a table other than that of the joints."""


SIGNALS = {
    "q": LogSignal("angle_unit", ANGLES),
    "q_des": LogSignal("angle_unit", ANGLES),
    "dq": LogSignal("speed_unit", SPEEDS),
    "dq_des": LogSignal("speed_unit", SPEEDS),
    "tau_ff": LogSignal("torque_unit", TORQUES),
    "tau_est": LogSignal("torque_unit", TORQUES),
    "gyro": LogSignal("gyro_unit", SPEEDS, "imu", (4, 7)),
    "acc": LogSignal("acceleration_unit", ACCELERATIONS, "imu", (7, 10)),
    "position": LogSignal("length_unit", LENGTHS, "base", (0, 3)),
    "velocity": LogSignal("length_unit", VELOCITIES, "base", (7, 10)),
}


@dataclass(frozen=True, kw_only=True)
class LogUnits:
    """Units of a recording where they are not SI units: a name, or how many SI units one of it is.

    Raises:
        ConfigError: a unit that is not known, or a number that is no unit.
    """

    time_unit: Unit = None
    """Unit of all times: "s", "ms", "us", "ns"."""
    angle_unit: Unit = None
    """Unit of q and q_des: "rad", "deg", "mrad", "rev"."""
    speed_unit: Unit = None
    """Unit of dq and dq_des: "rad/s", "deg/s", "rpm", "rev/s", "mrad/s"."""
    torque_unit: Unit = None
    """Unit of tau_est and tau_ff: "Nm", "mNm", "kgf cm", "kgf m", "lbf ft", "lbf in", "ozf in"."""
    gyro_unit: Unit = None
    """Unit of the gyroscope: as speed_unit."""
    acceleration_unit: Unit = None
    """Unit of the accelerometer: "m/s^2", "g", "mg"."""
    length_unit: Unit = None
    """Unit of the base's position, and of its velocity per second: "m", "mm", "cm", "in", "ft"."""
    depth_unit_m: float | None = None
    """Metres that one step of a depth image is: 0.001 (millimetres), 0.0001 (D405), 0.00025
    (L515)."""
    signals: dict[str, str | float] = field(default_factory=dict)
    """Units of single signals, in place of those above: q, q_des, dq, dq_des, tau_ff, tau_est,
    gyro, acc, position, velocity."""

    def __post_init__(self) -> None:
        for name in self.signals:
            check_known("units.signals: no signal", name, SIGNALS)
        for name in SIGNALS:
            self.of(name)
        _value("time_unit", self.time_unit, TIMES)
        if self.depth_unit_m is not None:
            check_depth_unit(self.depth_unit_m)

    def of(self, signal: str) -> float:
        """How many SI units one unit of a signal of `SIGNALS` is."""
        what = SIGNALS[signal]
        own = self.signals.get(signal)
        return (
            _value(what.key, getattr(self, what.key), what.units)
            if own is None
            else _value(signal, own, what.units)
        )

    @property
    def seconds(self) -> float:
        """How many seconds one unit of time is."""
        return _value("time_unit", self.time_unit, TIMES)


def check_depth_unit(unit_m: float) -> None:
    """Raises `ConfigError` for a step of depth images that is not from 1e-6 to 1 m."""
    if not 1e-6 <= unit_m <= 1.0:
        raise ConfigError(
            f"depth_unit_m = {unit_m:g}: 1e-06 to 1 m is allowed, 0.001 is a millimetre"
        )


def _value(key: str, unit: Unit, units: dict[str, float]) -> float:
    if unit is None:
        return 1.0
    if isinstance(unit, str):
        if unit not in units:
            raise ConfigError(
                f"{key} = '{unit}': {nearest_hint(unit, units)}; or a number, how many SI units "
                "one is"
            )
        return units[unit]
    if not (math.isfinite(unit) and 1e-12 < abs(unit) < 1e12):
        raise ConfigError(f"{key} = {unit:g}: a unit is a name or a number other than 0")
    return float(unit)


def stated_units(meta: Mapping[str, object]) -> LogUnits:
    """Units that the claims of a run log state; SI units where they state none.

    Raises:
        RecordingError: a unit that is not known.
    """
    table = meta.get("units", {})
    try:
        if not isinstance(table, dict):
            raise ConfigError(f"'units' must be a table, not {table!r}")
        return from_table(LogUnits, table, "units.")
    except ConfigError as error:
        raise RecordingError(f"meta.json: {error}") from error


def in_si(any_log: Log, units: LogUnits) -> Log:
    """A log whose numbers are in other units, in SI units and whole millimetres."""
    log: Any = any_log
    signals = {
        name: units.of(name) * values
        for name, signal in SIGNALS.items()
        if signal.table == "joints"
        and units.of(name) != 1.0
        and (values := getattr(log.joints, name)) is not None
    }
    depth = log.depth
    if depth is not None:
        depth = replace(
            depth, arrival_s=units.seconds * depth.arrival_s,
            capture_s=None if depth.capture_s is None else units.seconds * depth.capture_s,
            depth_mm=depth.depth_mm if units.depth_unit_m is None else millimetres(depth.depth_mm,
                units.depth_unit_m),
        )  # fmt: skip
    in_units: Log = replace(
        log,
        meta={key: value for key, value in log.meta.items() if key != "units"},
        joints=replace(log.joints, time_s=units.seconds * log.joints.time_s, **signals),
        imu=_table("imu", log.imu, units),
        base=_table("base", log.base, units),
        feet=log.feet and replace(log.feet, time_s=units.seconds * log.feet.time_s),
        depth=depth,
    )
    return in_units


def _table(name: str, table: Any, units: LogUnits) -> Any:
    """A table of a run log, or None, in SI units."""
    if table is None:
        return None
    values: Floats = table.values.copy()
    for own, signal in SIGNALS.items():
        if signal.table == name:
            values[:, slice(*signal.columns)] *= units.of(own)
    return replace(table, time_s=units.seconds * table.time_s, values=values)


def millimetres(steps: AnyArray, unit_m: float) -> NDArray[np.uint16]:
    """Depth images of steps of `unit_m` [m], of any shape, in whole millimetres; 0 stays 0."""
    if unit_m == MILLIMETRE:
        return steps.astype(np.uint16)
    return np.minimum(np.rint(steps * (unit_m / MILLIMETRE)), FARTHEST_MM).astype(np.uint16)
