"""Says by which factor a channel is off, and which unit or sign that is likely to be.

Factors are what is logged over what it should be: a torque of 1 Nm that is logged as 10.2 kgf cm
has the factor 10.2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.log import claimed_model
from saltus.recordings.log_units import SIGNALS
from saltus.recordings.run_log import RunLog
from saltus.robots.robot import Robot

UNKNOWN_UNIT = "another unit?"
"""In the text of a fault whose factor is that of no known unit."""


@dataclass(frozen=True, kw_only=True)
class LogFault:
    """Something in a log that contradicts its claims or itself."""

    name: str
    """Kind of fault, e.g. "swapped_joints"."""
    text: str
    """One sentence with numbers and the likely cause."""
    is_fatal: bool = True
    """True where the log cannot be fitted."""


def step_means(values: Floats, rows: int) -> Floats:
    """Means over `rows` steps, the ends with half weight.

    Shapes (n, columns) -> (n - rows, columns).
    """
    total = np.concatenate(
        [np.zeros((1, values.shape[1])), np.cumsum(0.5 * (values[1:] + values[:-1]), axis=0)]
    )
    return np.asarray((total[rows:] - total[:-rows]) / rows)


RIGHT = (0.6, 1.6)
"""Factors that an effect or a wrong claim may make: wide backlash takes 0.3 of a drive's stiffness,
sagging under the weight adds 0.3 to a joint's way. No unit that anyone uses lies within."""
NEAR = 0.15
"""Share by which a measured factor may differ from that of a unit; the nearest one counts. Noise of
what a channel is compared with makes the factor of a quiet motion smaller by a tenth."""
AS_NEAR = 0.02
"""Share by which a gear may be farther from a factor than a unit, and is named as well: in slow
motion angles follow their commands to within that."""
ALIKE = 0.25
"""Share by which factors of joints may differ that have one cause: soft drives follow by 0.8, and
the torque of a hip that hardly moves is noisy. The gears of hips and knees are 0.5 apart."""
NOTHING = 1e-7
"""Factors below are of channels that tell nothing: the largest unit in use has 1e6, counts of an
encoder for rad."""
GEARS = (6.33, 9.495)
"""Reductions of a Go1's drives, where a log's robot tells none."""


def is_off(factor: float) -> bool:
    """True for a factor that no effect explains."""
    return not RIGHT[0] < factor < RIGHT[1]


def unit_of(signal: str, factor: float, gears: Sequence[float] = (), near: float = NEAR) -> str:
    """Name of the unit of a signal by its factor, "" if none is near, or a gear is nearer."""
    known = {name: 1.0 / value for name, value in SIGNALS[signal].units.items() if value != 1.0}
    name = min(known, key=lambda name: _apart(factor, known[name]))
    at_gear = min(
        (_apart(factor, turn) for gear in gears for turn in (gear, 1.0 / gear)), default=np.inf
    )
    return name if _apart(factor, known[name]) < min(near, at_gear) else ""


def likely_cause(
    signal: str, factor: float, gears: Sequence[float] = GEARS, near: float = NEAR
) -> str:
    """Says where a factor of a signal, measured to within a share, comes from, and what to do."""
    if abs(factor) < NOTHING:
        return "it tells nothing; leave the columns out"
    if abs(factor + 1.0) < near:
        return "a sign is flipped (-1)"
    if factor < 0.0:
        return f"a sign is flipped, and {likely_cause(signal, -factor, gears, near)}"
    turns = (
        [turn for gear in gears for turn in (gear, 1.0 / gear)]
        if SIGNALS[signal].table == "joints"
        else []
    )
    turn = min(turns, key=lambda each: _apart(factor, each), default=np.inf)
    at_gear = _apart(factor, turn)
    if unit := unit_of(signal, factor, gears if turns else (), near):
        own = SIGNALS[signal]
        as_well = at_gear < _apart(factor, 1.0 / own.units[unit]) + AS_NEAR
        gear = f", or on the motor's side of the gear ({turn:.4g})" if as_well else ""
        cure = f'say {own.key} = "{unit}" in [units] (meta.json: units)'
        return f"in {unit} ({1.0 / own.units[unit]:.4g}){gear}? Then {cure}"
    if at_gear < near:
        return f"on the motor's side of the gear ({turn:.4g})? Log the joint's side"
    if unit := unit_of(signal, 1.0 / factor, (), near):
        return f"turned from {unit} into SI units twice ({SIGNALS[signal].units[unit]:.4g})?"
    return (
        f"{UNKNOWN_UNIT} Then say signals.{signal} = {1.0 / factor:.4g} in [units] (meta.json: "
        "units)"
    )


def _apart(factor: float, known: float) -> float:
    """Distance of two factors, as a share where it is small; infinite where their signs differ."""
    return abs(float(np.log(factor / known))) if factor / known > 0.0 else np.inf


def gear_reductions(log: RunLog) -> tuple[float, ...]:
    """Reductions of the log's robot, those of a Go1 where it has none."""
    robot = claimed_model(log)
    own = sorted(set(np.round(robot.reduction, 4).tolist())) if isinstance(robot, Robot) else []
    return tuple(own) if any(gear > 1.0 for gear in own) else GEARS


def by_cause(names: Sequence[str], factors: Mapping[int, float]) -> list[tuple[str, float]]:
    """Joints in words, with their factor: those together whose factors are alike, most first."""
    groups: list[list[int]] = []
    for joint in sorted(factors, key=lambda j: factors[j]):
        last = factors[groups[-1][0]] if groups else np.inf
        if abs(factors[joint] - last) <= ALIKE * abs(last) < np.inf:
            groups[-1].append(joint)
        else:
            groups.append([joint])
    groups.sort(key=len, reverse=True)
    return [
        (_listed(names, sorted(group)), float(np.median([factors[j] for j in group])))
        for group in groups
    ]


def _listed(names: Sequence[str], chosen: Sequence[int]) -> str:
    if len(chosen) == len(names) and len(names) > 1:
        return "all joints"
    parts = {names[j].removesuffix("_joint").rpartition("_")[2] for j in chosen}
    whole = [
        j for j, name in enumerate(names) if name.removesuffix("_joint").rpartition("_")[2] in parts
    ]
    if len(chosen) > 3 and list(chosen) == whole:
        return " and ".join(f"all {part} joints" for part in sorted(parts))
    shown = ", ".join(names[j] for j in chosen[:4])
    return shown if len(chosen) <= 4 else f"{shown} and {len(chosen) - 4} more joints"


def unit_fault(
    name: str,
    signal: str,
    where: str,
    factor: float,
    than: str,
    gears: Sequence[float] = GEARS,
    near: float = NEAR,
) -> LogFault:
    """A fault of a signal that is `factor` times `than`, measured to within a share."""
    is_flipped = abs(factor + 1.0) < near
    verb = "are" if " and " in where.partition(" of ")[0] else "is"
    text = f"{where} {verb} {factor:.4g} times {than}: {likely_cause(signal, factor, gears, near)}"
    return LogFault(name="flipped_sign" if is_flipped else name, text=text)
