"""Tells whose factor is off in the law of a drive: of torque, gains, kp, kd or feed-forward.

The law of the drive, torque = kp error + kd rate + tau_ff, holds in the log's own units but for one
factor. Each cause leaves another part of the law as it is, so that what it does not explain tells
them apart, in whatever unit.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from saltus.arrays import Floats
from saltus.real2sim.screening.fault import Fault
from saltus.real2sim.screening.scales import ALIKE, by_cause, is_off, likely, unit_of
from saltus.recordings.units import ANGLES

CAUSES = ("tau_est", "gains", "kp", "kd", "tau_ff")
"""In the order in which one is preferred that explains as much."""
EXPLAINED = 0.6
"""Share of a torque that its law must explain, but for a factor: columns of other joints explain
0.28 at most."""
BETTER = 2.0
"""Times more that the law leaves as it is logged than with the factor."""
AS_GOOD = 0.1
"""Difference of the logarithm of what two causes leave, below which they explain as much."""
LEAST_LAW_NM = 0.05
"""RMS of the torque by the law, as logged, from which it is compared: encoder noise of 1 mrad makes
0.02 Nm of it at a kp of 20."""
MOST = 0.5
"""Share of the drives that must tell a factor by their motion, so that what they hold is not
asked."""
JOINTS_OF_MEANS, LEAST_MEAN_NM, OF_MEANS = 4, 1.0, 0.95
"""Fewest drives, RMS of the torques that they hold [Nm] and the share of these that one factor must
explain."""
AGREEING, NOISY = 0.8, 0.3
"""Share of the drives with a slow motion that must agree in a factor, and largest share of a slow
torque that it may leave: noise of the law then makes the factor smaller by as much at most."""
SLOW_ROWS = 15
"""Rows of a moving average: a tenth of a second of a log of 20 s."""
PER_DEGREE = 1.0 / ANGLES["deg"]


@dataclass(frozen=True, kw_only=True)
class Cause:
    """One factor of a drive's law."""

    factor: float
    """Logged torque over the part of the law that it scales."""
    left: float
    """Share of the torque's variance that the law with this factor leaves."""


@dataclass(frozen=True, kw_only=True)
class Causes:
    """Causes that explain the torque of one drive."""

    of: Mapping[str, Cause]
    """By name, of `CAUSES`; without what the law has no part of."""
    left: float
    """Share that the law leaves as it is logged."""
    means: tuple[float, float]
    """Means of the torque and of the law [Nm]."""
    slow: Cause | None = None
    """The factor of the torque in slow motion; None where the law hardly changes."""

    @property
    def are_told(self) -> bool:
        """Whether the law holds but for a factor that no effect makes."""
        best = min(self.of.values(), key=lambda cause: cause.left, default=None)
        if best is None or best.left > 1.0 - EXPLAINED or self.left < BETTER * best.left:
            return False
        return any(is_off(cause.factor) for cause in self.of.values() if cause.left < BETTER * best.left)


def causes(
    torque: Floats, error: Floats, rate: Floats, feedforward: Floats | None, *, is_rate_measured: bool = True
) -> Causes:
    """Compares the causes on rows of one drive.

    Args:
        torque: As the drive tells it, shape (rows,).
        error: kp times the position error [Nm], shape (rows,).
        rate: kd times the velocity error [Nm], shape (rows,).
        feedforward: tau_ff [Nm], shape (rows,), or None where it never changes.
        is_rate_measured: Whether the rate is a reading. That of noisy angles is too noisy to judge
            kd alone by.
    """
    extra = np.zeros_like(torque) if feedforward is None else feedforward
    parts = {"tau_est": error + rate + extra, "gains": error + rate, "kp": error, "kd": rate, "tau_ff": extra}
    law, variance = parts["tau_est"], max(float(np.var(torque)), np.finfo(np.float64).tiny)
    means = float(np.mean(torque)), float(np.mean(law))
    if np.std(law) < LEAST_LAW_NM:
        return Causes(of={}, left=1.0, means=means)
    found = {}
    for name, part in parts.items():
        power = float(np.var(part))
        is_there = {"gains": feedforward is not None, "kd": is_rate_measured}.get(name, True)
        if power > 0.0 and is_there:
            rest = torque - (law - part)
            factor = float(np.mean((rest - rest.mean()) * (part - part.mean()))) / power
            left = float(np.var(rest - factor * part))
            if left < (1.0 - EXPLAINED) * float(np.var(rest)):  # noise beside a strong tau_ff tells no gains
                found[name] = Cause(factor=factor, left=left / variance)
    return Causes(of=found, left=float(np.var(torque - law)) / variance, means=means, slow=_slow(torque, law))


def _slow(torque: Floats, law: Floats) -> Cause:
    """The factor of slow motion, in which noise is less."""
    slow_law, slow_torque = uniform_filter1d(law, SLOW_ROWS), uniform_filter1d(torque, SLOW_ROWS)
    tiny = float(np.finfo(np.float64).tiny)
    product = float(np.mean((slow_torque - slow_torque.mean()) * (slow_law - slow_law.mean())))
    factor = product / max(float(np.var(slow_law)), tiny)
    left = float(np.var(slow_torque - factor * slow_law)) / max(float(np.var(slow_torque)), tiny)
    return Cause(factor=factor, left=left)


def cause_faults(names: Sequence[str], drives: Sequence[Causes], gears: Sequence[float]) -> Iterator[Fault]:
    """Faults of factors, by the cause that explains most of the drives for which they are told."""
    told = [joint for joint, drive in enumerate(drives) if drive.are_told]
    few = len(told) < MOST * len(drives)
    if few and (factor := _of_means(drives) or _of_all(drives)) is not None:
        yield _fault("tau_est", "all joints", factor, gears)
        return
    if not told:
        return
    tiny = np.finfo(np.float64).tiny
    left = {name: [drives[j].of[name].left if name in drives[j].of else 1.0 for j in told] for name in CAUSES}
    scores = {name: float(np.mean(np.log(np.maximum(own, tiny)))) for name, own in left.items()}
    cause = next(name for name in CAUSES if scores[name] < min(scores.values()) + AS_GOOD)
    factors = {joint: drives[joint].of[cause].factor for joint in told if cause in drives[joint].of}
    for where, factor in by_cause(names, factors):
        yield _fault(cause, where, factor, gears)


def _of_means(drives: Sequence[Causes]) -> float | None:
    """The factor of the torques that all drives hold on average; None if an effect may make it.

    A drive whose zero is another than that of the log is off by a torque of its own, not by a
    factor.
    """
    torque, law = np.array([drive.means for drive in drives]).T
    power = float(np.sum(law**2))
    if len(drives) < JOINTS_OF_MEANS or power < len(drives) * LEAST_MEAN_NM**2:
        return None
    factor = float(np.sum(torque * law)) / power
    left = float(np.sum((torque - factor * law) ** 2))
    return factor if is_off(factor) and left < (1.0 - OF_MEANS) * float(np.sum(torque**2)) else None


def _of_all(drives: Sequence[Causes]) -> float | None:
    """The factor in which drives agree whose torques are noisy; None where they do not.

    Columns of other joints make another factor for each.
    """
    factors = [drive.slow.factor for drive in drives if drive.slow is not None and drive.slow.left < NOISY]
    if len(factors) < max(JOINTS_OF_MEANS, MOST * len(drives)):
        return None
    factor = float(np.median(factors))
    alike = np.abs(np.array(factors) / factor - 1.0) < ALIKE
    return factor if is_off(factor) and np.mean(alike) >= AGREEING else None


def _fault(cause: str, where: str, factor: float, gears: Sequence[float]) -> Fault:
    is_flipped = factor < 0.0
    if cause == "tau_ff":
        text = f"tau_ff of {where} is {1.0 / factor:.4g} times its part in tau_est: "
        text += likely("tau_ff", 1.0 / factor, gears)
        return Fault(name="flipped_sign" if is_flipped else "torque_unit", text=text)
    if cause == "tau_est":
        text = f"tau_est of {where} is {factor:.4g} times what kp, kd and tau_ff make of q and dq: "
        text += _gains_instead(factor) or likely("tau_est", factor, gears)
        return Fault(name="flipped_sign" if is_flipped else "torque_unit", text=text)
    if cause == "gains" and unit_of("tau_est", factor, gears):
        text = f"tau_est and tau_ff of {where} are {factor:.4g} times what kp and kd make of q and dq: "
        return Fault(name="torque_unit", text=text + likely("tau_est", factor, gears))
    which = "kp and kd" if cause == "gains" else cause
    text = f"tau_est of {where} shows {factor:.4g} times the {which} that meta.json claims: "
    text += _gains_instead(factor) or "correct the claim"
    if cause == "kd":
        text += f"; or dq is {1.0 / factor:.4g} times the rate of q, {likely('dq', 1.0 / factor, gears)}"
    return Fault(name="flipped_sign" if is_flipped else "wrong_gains", text=text)


def _gains_instead(factor: float) -> str:
    """Names gains and angles in degrees, for a factor that no unit of torque has."""
    if abs(factor / PER_DEGREE - 1.0) < 0.1:
        return "kp and kd in Nm/deg, or angles that were turned into rad twice?"
    return (
        "angles in deg, or kp and kd that were turned into Nm/rad twice?" if abs(factor * PER_DEGREE - 1) < 0.1 else ""
    )
