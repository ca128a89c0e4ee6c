"""Tells whose factor is off in the law of a drive: of torque, gains, kp, kd or feed-forward.

The law of the drive, torque = kp error + kd rate + tau_ff, holds in the log's own units but for one
factor. Each cause leaves another part of the law as it is, so that what it does not explain tells
them apart, in whatever unit.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from saltus.arrays import Floats
from saltus.real2sim.screening.channel_scales import (
    LogFault,
    by_cause,
    is_off,
    likely_cause,
    unit_of,
)
from saltus.recordings.log_units import ANGLES

CAUSES = ("tau_est", "gains", "kp", "kd", "tau_ff")
"""In the order in which one is preferred that explains as much."""
EXPLAINED = 0.6
"""Share of a torque that its law must explain, but for a factor: columns of other joints explain
0.28 at most."""
BETTER = 2.0
"""Times more that the law leaves as it is logged than with the factor."""
AS_GOOD = 0.1
"""Difference of the logarithm of what two causes leave, below which they explain as much."""
MOST = 0.5
"""Share of the drives that must tell a factor by their motion, so that what they hold is not
asked, unless it is `EXACT`."""
OF_FEW = 0.2
"""Share that a factor may leave where less than `MOST` of the drives tell it. The rear calves of a
robot that turns, logged as the front ones, leave 0.39."""
JOINTS_OF_MEANS, OF_MEANS = 4, 0.95
"""Fewest drives whose torques on average are compared, and the share of these that one factor must
explain: twelve zeros that are off by chance are along their law by a third at most."""
EXACT = 0.001
"""Share that a factor leaves of the torques on average, below which it is better than that of the
motion: a zero that is off by 1 mrad at a kp of 100 leaves more beside the 3 Nm of a standing robot,
and so do gears of hips and knees that are both left out."""
LEAST_MEAN = 0.3
"""RMS of what the drives hold on average, as a share of that of their motion, from which it tells
more than where the motion happened to end."""
SLOW_ROWS = 15
"""Rows of a moving average: a tenth of a second of a log of 20 s."""
AROUND_ROWS, OWN_ROWS, SEEN = 11, 5, 0.3
"""Rows of a moving average by which a row is seen without its noise; those in its middle that it
leaves out, since a rate made of angles shares the noise of two rows on either side; and the
correlation from which it shows the row. Steps that ring fast are not seen so."""
PER_DEGREE = 1.0 / ANGLES["deg"]


@dataclass(frozen=True, kw_only=True)
class TorqueCause:
    """One factor in a drive's law that would explain the torque that a log tells."""

    factor: float
    """Logged torque over the part of the law that it scales."""
    left: float
    """Share of the torque's variance that the law with this factor leaves."""


class TorqueMoments(NamedTuple):
    """Mean and standard deviation of a torque [Nm]."""

    mean: float
    deviation: float


@dataclass(frozen=True, kw_only=True)
class TorqueCauses:
    """Causes that explain the torque of one drive."""

    of: Mapping[str, TorqueCause]
    """By name, of `CAUSES`; without what the law has no part of."""
    left: float
    """Share that the law leaves as it is logged."""
    torque: TorqueMoments
    parts: Mapping[str, TorqueMoments]
    """By cause, the part of the law that it scales; as a whole that of tau_est."""

    @property
    def are_told(self) -> bool:
        """True where the law holds but for a factor that no effect makes."""
        best = self.least_left
        if best > 1.0 - EXPLAINED or self.left < BETTER * best:
            return False
        return any(is_off(cause.factor) for cause in self.of.values() if cause.left < BETTER * best)

    @property
    def least_left(self) -> float:
        """Share that the best of them leaves."""
        return min((cause.left for cause in self.of.values()), default=1.0)


def torque_causes(
    torque: Floats,
    error: Floats,
    rate: Floats,
    feedforward: Floats | None,
    *,
    is_rate_measured: bool = True,
) -> TorqueCauses:
    """Compares the causes on rows of one drive, as they are or in slow motion:
    where one tells more.

    Args:
        torque: As the drive tells it, shape (rows,).
        error: kp times the position error [Nm], shape (rows,).
        rate: kd times the velocity error [Nm], shape (rows,).
        feedforward: tau_ff [Nm], shape (rows,), or None where it never changes.
        is_rate_measured: Whether the rate is a reading. That of noisy angles is too noisy to judge
            kd alone by.
    """
    extra = np.zeros_like(torque) if feedforward is None else feedforward
    parts = {
        "tau_est": error + rate + extra,
        "gains": error + rate,
        "kp": error,
        "kd": rate,
        "tau_ff": extra,
    }
    is_there = {
        "gains": feedforward is not None,
        "kd": is_rate_measured,
        "tau_ff": feedforward is not None,
    }
    parts = {name: part for name, part in parts.items() if is_there.get(name, True)}
    factors = {
        name: _factor(torque - (parts["tau_est"] - part), part) for name, part in parts.items()
    }
    slow = {name: uniform_filter1d(part, SLOW_ROWS) for name, part in parts.items()}
    moments = {name: _moments(part) for name, part in parts.items()}
    seen = [
        TorqueCauses(of=of, left=left, torque=_moments(torque), parts=moments)
        for of, left in (
            _explained(torque, parts, factors),
            # dampers do next to nothing in slow motion
            _explained(
                uniform_filter1d(torque, SLOW_ROWS),
                slow,
                {k: v for k, v in factors.items() if k != "kd"},
            ),
        )
    ]
    return min(
        [each for each in seen if each.are_told] or seen[:1], key=lambda each: each.least_left
    )


def _moments(values: Floats) -> TorqueMoments:
    return TorqueMoments(float(np.mean(values)), float(np.std(values)))


def _factor(rest: Floats, part: Floats) -> float:
    """Slope of what the other parts leave over a part that is noisy itself, shape (rows,) each.

    Noise makes a slope smaller. So the part is seen through its neighbouring rows, which have other
    noise (an instrumental variable; Angrist and Pischke, Mostly Harmless Econometrics, 4.1).
    """
    part, rest = part - part.mean(), rest - rest.mean()
    around = AROUND_ROWS * uniform_filter1d(part, AROUND_ROWS) - OWN_ROWS * uniform_filter1d(
        part, OWN_ROWS
    )
    around -= around.mean()
    power, along = float(part @ part), float(around @ part)
    if along > SEEN * np.sqrt(power * float(around @ around)) > 0.0:
        return float(around @ rest) / along
    return float(part @ rest) / power if power > 0.0 else 0.0


def _explained(
    torque: Floats, parts: Mapping[str, Floats], factors: Mapping[str, float]
) -> tuple[dict[str, TorqueCause], float]:
    """Causes that explain the torque, and the share that the law leaves as it is logged."""
    law, variance = parts["tau_est"], max(float(np.var(torque)), np.finfo(np.float64).tiny)
    found = {}
    for name, factor in factors.items():
        rest = torque - (law - parts[name])
        left = float(np.var(rest - factor * parts[name]))
        if left < (1.0 - EXPLAINED) * float(
            np.var(rest)
        ):  # noise beside a strong tau_ff tells no gains
            found[name] = TorqueCause(factor=factor, left=left / variance)
    return found, float(np.var(torque - law)) / variance


def cause_faults(
    names: Sequence[str], drives: Sequence[TorqueCauses], gears: Sequence[float]
) -> Iterator[LogFault]:
    """Faults of factors, by the cause that explains most of the drives for which they are told."""
    told = [joint for joint, drive in enumerate(drives) if drive.are_told]
    if (held := _held(drives, told)) is not None:
        yield _fault(held[0], "all joints", held[1], gears)
        return
    if not told:
        return
    cause = _likeliest(
        {
            name: [drives[j].of[name].left if name in drives[j].of else 1.0 for j in told]
            for name in CAUSES
        }
    )
    of = {joint: drives[joint].of[cause] for joint in told if cause in drives[joint].of}
    if len(told) < MOST * len(drives) and np.median([each.left for each in of.values()]) > OF_FEW:
        return
    factors = {joint: each.factor for joint, each in of.items()}
    for where, factor in by_cause(names, factors):
        yield _fault(cause, where, factor, gears)


def _held(drives: Sequence[TorqueCauses], told: Sequence[int]) -> tuple[str, float] | None:
    """Cause and factor of what the drives hold on average; None where the motion says more."""
    means = _of_means(drives)
    if not means:
        return None
    cause = _likeliest({name: [each.left] for name, each in means.items()})
    factor, left = means[cause].factor, means[cause].left
    is_asked = len(told) < MOST * len(drives) or left < EXACT
    return (cause, factor) if is_off(factor) and is_asked else None


def _likeliest(left: Mapping[str, Sequence[float]]) -> str:
    """The first cause that leaves hardly more than any."""
    tiny = np.finfo(np.float64).tiny
    scores = {name: float(np.mean(np.log(np.maximum(own, tiny)))) for name, own in left.items()}
    return next(
        name for name in CAUSES if name in scores and scores[name] < min(scores.values()) + AS_GOOD
    )


def _of_means(drives: Sequence[TorqueCauses]) -> dict[str, TorqueCause]:
    """Causes that explain the torques that all drives hold on average.

    A drive whose zero is another than that of the log is off by a torque of its own, not by a
    factor.
    """
    if len(drives) < JOINTS_OF_MEANS:
        return {}
    torque = np.array([drive.torque.mean for drive in drives])
    law, found = np.array([drive.parts["tau_est"].mean for drive in drives]), {}
    for name in drives[0].parts:
        part, moves = np.array([drive.parts[name] for drive in drives]).T
        rest, power = torque - (law - part), float(part @ part)
        if power > LEAST_MEAN**2 * float(moves @ moves) and power > 0.0:
            factor = float(rest @ part) / power
            left = float(np.sum((rest - factor * part) ** 2))
            if left < (1.0 - OF_MEANS) * float(rest @ rest):
                found[name] = TorqueCause(factor=factor, left=left / float(torque @ torque))
    return found


def _fault(cause: str, where: str, factor: float, gears: Sequence[float]) -> LogFault:
    is_flipped = factor < 0.0
    if cause == "tau_ff":
        text = f"tau_ff of {where} is {1.0 / factor:.4g} times its part in tau_est: "
        text += likely_cause("tau_ff", 1.0 / factor, gears)
        return LogFault(name="flipped_sign" if is_flipped else "torque_unit", text=text)
    if cause == "tau_est":
        text = f"tau_est of {where} is {factor:.4g} times what kp, kd and tau_ff make of q and dq: "
        text += _gains_instead(factor) or likely_cause("tau_est", factor, gears)
        return LogFault(name="flipped_sign" if is_flipped else "torque_unit", text=text)
    if cause == "gains" and unit_of("tau_est", factor, gears):
        text = (
            f"tau_est and tau_ff of {where} are {factor:.4g} times what kp and kd "
            "make of q and dq: "
        )
        return LogFault(name="torque_unit", text=text + likely_cause("tau_est", factor, gears))
    which = "kp and kd" if cause == "gains" else cause
    text = f"tau_est of {where} shows {factor:.4g} times the {which} that meta.json claims: "
    text += _gains_instead(factor) or "correct the claim"
    if cause == "kd":
        inverse = 1.0 / factor
        text += (
            f"; or dq is {inverse:.4g} times the rate of q, {likely_cause('dq', inverse, gears)}"
        )
    return LogFault(name="flipped_sign" if is_flipped else "wrong_gains", text=text)


def _gains_instead(factor: float) -> str:
    """Names gains and angles in degrees, for a factor that no unit of torque has."""
    if abs(factor / PER_DEGREE - 1.0) < 0.1:
        return "kp and kd in Nm/deg, or angles that were turned into rad twice?"
    return (
        "angles in deg, or kp and kd that were turned into Nm/rad twice?"
        if abs(factor * PER_DEGREE - 1) < 0.1
        else ""
    )
