"""Where the gap between simulation and measurement lies: by signal, joint and regime, in words.

This is independent of every fit. Residuals are related to their explanatory variables (torque,
speed, acceleration, reversals, posture, time, contact), and the one that explains most of their
power is named, e.g. "calf joints: q is off by 4.1 sigma where |tau| is above 15 Nm, by 1.1
elsewhere". A statement must hold in most parts of the log, not in one of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.real2sim.problem.log import drive_torque, joint_rates
from saltus.real2sim.problem.problem import ExplanatoryVariable, Problem
from saltus.recordings.run_log import RunLog

CHUNKS = 20  # parts of a log; their disagreement gives standard errors
MIN_T = 3.0  # smallest effect in jackknife standard errors
MIN_SHARE = 0.1  # smallest explained share of a residual's power
MIN_CONTRAST = 1.5  # smallest ratio of the RMS above a threshold to that below
QUANTILES = np.linspace(0.1, 0.9, 17)  # of the variable's size: thresholds that are tried


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualSignal:
    """The residual of one signal at one place of a robot, in which a cause is looked for."""

    signal: str
    """E.g. "q"."""
    place: str
    """E.g. "FR_calf"; the last word, here "calf", is the kind of place."""
    residual: Floats
    """Measured minus simulated in units of noise, shape (n,), in order of time."""
    variables: tuple[ExplanatoryVariable, ...]


@dataclass(frozen=True, kw_only=True)
class ResidualExplanation:
    """An explanatory variable that explains a residual at one or several places."""

    signal: str
    places: tuple[str, ...]
    variable: str
    share: float
    """Share of the residual's power that it explains, or that lies in the regime beyond the level
    elsewhere."""
    t_statistic: float
    """Size of the effect in jackknife standard errors."""
    text: str


@dataclass(frozen=True, kw_only=True)
class _Clue:
    """A statement about one channel."""

    channel: ResidualSignal
    variable: ExplanatoryVariable
    kind: str
    share: float
    t_statistic: float
    slope: float
    """Slope of the residual on the variable [sigma per unit], or the RMS above the threshold."""
    threshold: float
    """Threshold of the variable's size; `elsewhere` is the RMS below it."""
    elsewhere: float


def localise_gap(channels: Sequence[ResidualSignal]) -> tuple[ResidualExplanation, ...]:
    """Statements on where the gap lies, those first that explain most power.

    Each channel gives at most one statement on proportionality and one on a regime. Equal
    statements on channels of one signal are joined.
    """
    clues = [clue for channel in channels for clue in _clues(channel)]
    groups: dict[tuple[str, str, str], list[_Clue]] = {}
    for clue in clues:
        groups.setdefault((clue.channel.signal, clue.variable.name, clue.kind), []).append(clue)
    places = {signal: [c.place for c in channels if c.signal == signal] for signal, _, _ in groups}
    # by power, so that a joint that is off by 5 sigma comes before one that is off by 1
    powers = {
        key: sum(c.share * float(np.sum(c.channel.residual**2)) for c in group)
        for key, group in groups.items()
    }
    ranked = sorted(groups, key=lambda key: -powers[key])
    return tuple(_statement(groups[key], places[key[0]]) for key in ranked)


def _clues(channel: ResidualSignal) -> list[_Clue]:
    found = []
    for clues in (
        [
            _proportional(channel, variable)
            for variable in channel.variables
            if not variable.is_regime
        ],
        [
            _beyond(channel, variable)
            for variable in channel.variables
            if variable.unit or variable.is_regime
        ],
    ):
        kept = [
            clue
            for clue in clues
            if clue is not None and clue.share > MIN_SHARE and clue.t_statistic > MIN_T
        ]
        if kept:
            found.append(max(kept, key=lambda clue: clue.share))
    return found


def _proportional(channel: ResidualSignal, variable: ExplanatoryVariable) -> _Clue | None:
    """The share of the residual that a multiple of the variable explains."""
    product, power = _sums(channel.residual * variable.values), _sums(variable.values**2)
    if power.sum() <= 0:
        return None
    slope = float(product.sum() / power.sum())
    share = slope * float(product.sum()) / max(float(np.sum(channel.residual**2)), 1e-30)
    without = _but_one(product) / np.maximum(_but_one(power), 1e-30)
    t_statistic = abs(slope) / max(_error(without), 1e-30)
    return _Clue(
        channel=channel, variable=variable, kind="proportional", share=share,
        t_statistic=t_statistic, slope=slope,
        threshold=0.0, elsewhere=0.0,
    )  # fmt: skip


def _beyond(channel: ResidualSignal, variable: ExplanatoryVariable) -> _Clue | None:
    """The threshold of the variable's size above which the residual's power is concentrated."""
    size, power = np.abs(variable.values), channel.residual**2
    best: tuple[float, float] | None = None
    for threshold in [0.5] if variable.is_regime else np.unique(np.quantile(size, QUANTILES)):
        above = size > threshold
        if not 0 < above.sum() < len(above):
            continue
        excess = float(np.sum(power[above])) - float(np.mean(power[~above])) * float(above.sum())
        # a regime that covers the whole log says nothing: weight by the share outside
        score = excess * float(np.sqrt(np.mean(~above)))
        if best is None or score > best[0]:
            best = score, float(threshold)
    if best is None:
        return None
    above = size > best[1]
    inside, outside = float(np.sqrt(np.mean(power[above]))), float(np.sqrt(np.mean(power[~above])))
    if inside < MIN_CONTRAST * max(outside, 1e-12):
        return None
    share = (inside**2 - outside**2) * float(above.sum()) / max(float(power.sum()), 1e-30)
    means = [
        _but_one(_sums(power * a)) / np.maximum(_but_one(_sums(a.astype(float))), 1)
        for a in (above, ~above)
    ]
    t_statistic = (inside**2 - outside**2) / max(_error(means[0] - means[1]), 1e-30)
    return _Clue(
        channel=channel, variable=variable, kind="beyond", share=share, t_statistic=t_statistic,
        slope=inside,
        threshold=best[1], elsewhere=outside,
    )  # fmt: skip


def _sums(values: Floats) -> Floats:
    """Sums over the parts of the log, shape (chunks,)."""
    edges = np.linspace(0, len(values), min(CHUNKS, len(values)) + 1).astype(int)[:-1]
    return np.add.reduceat(values, edges)


def _but_one(sums: Floats) -> Floats:
    return np.asarray(sums.sum() - sums)


def _error(without: Floats) -> float:
    """Standard error by the jackknife."""
    return float(np.sqrt((len(without) - 1) * np.var(without)))


def _statement(clues: Sequence[_Clue], places: Sequence[str]) -> ResidualExplanation:
    named = tuple(clue.channel.place for clue in clues)
    first = clues[0]
    share = float(np.mean([clue.share for clue in clues]))
    rms = float(np.sqrt(np.mean([np.mean(clue.channel.residual**2) for clue in clues])))
    where, signal, variable = in_words(named, places), first.channel.signal, first.variable
    slope = float(np.median([clue.slope for clue in clues]))
    unit = f" {variable.unit}" if variable.unit else ""
    if first.kind == "proportional":
        per = f" per{unit}" if unit else ""
        text = (
            f"{where}: {signal} is off by {rms:.1f} sigma; "
            f"{variable.name} explains {share:.0%} of its power"
        )
        text += f" ({slope:+.2g} sigma{per})"
    else:
        threshold = float(np.median([clue.threshold for clue in clues]))
        elsewhere = float(np.median([clue.elsewhere for clue in clues]))
        size = f"|{variable.name}|" if np.any(variable.values < 0.0) else variable.name
        regime = (
            variable.name if variable.is_regime else f"where {size} is above {threshold:.3g}{unit}"
        )
        text = (
            f"{where}: {signal} is off by {slope:.1f} sigma {regime}, by {elsewhere:.1f} elsewhere"
        )
    least = min(clue.t_statistic for clue in clues)
    return ResidualExplanation(
        signal=signal,
        places=named,
        variable=variable.name,
        share=share,
        t_statistic=least,
        text=text,
    )


def in_words(named: Sequence[str], places: Sequence[str]) -> str:
    """Places in a phrase, e.g. "all joints", "calf joints", "FR leg", "FR_hip, RL_calf"."""
    chosen, all_of = set(named), set(places)
    if chosen == all_of and len(all_of) > 1:
        return "all joints"
    for part, word in ((-1, "joints"), (0, "leg")):
        kinds = {place.split("_")[part] for place in chosen}
        same = {place for place in all_of if place.split("_")[part] in kinds}
        if same == chosen and len(chosen) > len(kinds):
            return f"{', '.join(sorted(kinds))} {word}"
    return ", ".join(sorted(chosen))


TIME = "time in the run"
"""Name of the explanatory variable that every residual has."""
SMOOTH_S = 0.02  # moving average before differentiation, which would amplify the noise of dq
REVERSAL_S = 0.05  # after a reversal: in this time backlash closes and friction changes sign
MOVING = 0.05  # rad/s, one sigma of dq: below it the direction is noise


def channels_of(
    problem: Problem, log: RunLog, residuals: Floats, chosen: NDArray[np.bool_] | None = None
) -> tuple[ResidualSignal, ...]:
    """Residuals of a problem, one channel for each signal of each block,
    with their explanatory variables.

    Residuals, and the rows of them that are `chosen` (all by default), have the shape (blocks, m).
    """
    channels = []
    own = problem.explanatory_variables()
    counts = np.ones(residuals.shape, dtype=bool) if chosen is None else chosen
    for block, places in enumerate(problem.places):
        for index, name in enumerate(problem.signals):
            rows = np.flatnonzero((problem.signal == index) & counts[block])
            rows = rows[np.argsort(problem.time_s[rows], kind="stable")]
            if not len(rows):
                continue
            where = next((w for w in places if name.endswith(f"_{w}")), "")
            signal = name.removesuffix(f"_{where}") if where else name
            place = places[where] if where else problem.name
            seen = (replace(variable, values=variable.values[rows]) for variable in own)
            every = (*explanatory_variables_of(log, place, problem.time_s[rows]), *seen)
            variables = tuple(variable for variable in every if np.isfinite(variable.values).all())
            channels.append(
                ResidualSignal(
                    signal=signal, place=place, residual=residuals[block, rows], variables=variables
                )
            )
    return tuple(channels)


def explanatory_variables_of(
    log: RunLog, place: str, time_s: Floats
) -> tuple[ExplanatoryVariable, ...]:
    """Explanatory variables of a residual at a joint or another place, at given times."""
    variables = [ExplanatoryVariable(name="a constant", unit="", values=np.ones(len(time_s)))]
    if place in log.meta["joints"]:
        variables += _joint_variables(log, log.meta["joints"].index(place), time_s)
    variables.append(
        ExplanatoryVariable(name=TIME, unit="s", values=time_s - float(log.joints.time_s[0]))
    )
    if log.base is not None:
        for name, unit, column in (("height", "m", 2), ("vertical speed", "m/s", 9)):
            values = _at(time_s, log.base.time_s, log.base.values[:, column])
            variables.append(
                ExplanatoryVariable(name=f"the base's {name}", unit=unit, values=values)
            )
    return tuple(variables)


def _joint_variables(log: RunLog, joint: int, time_s: Floats) -> list[ExplanatoryVariable]:
    joints = log.joints
    q, dq = joints.q[:, joint], joint_rates(joints)[:, joint]
    # What the drive believes, if known
    torque = (drive_torque(log) if joints.tau_est is None else joints.tau_est)[:, joint]
    width = max(1, round(SMOOTH_S / float(np.median(np.diff(joints.time_s)))))
    smooth = np.convolve(dq, np.ones(width) / width, mode="same")
    direction = np.where(np.abs(smooth) > MOVING, np.sign(smooth), 0.0)
    turned = np.flatnonzero(np.diff(np.sign(smooth)) != 0)
    turns_s = np.concatenate([[-np.inf], joints.time_s[turned]])
    since = joints.time_s - turns_s[np.searchsorted(turns_s, joints.time_s, side="right") - 1]
    signals = (
        ("torque", "Nm", torque),
        ("velocity", "rad/s", dq),
        ("acceleration", "rad/s2", np.gradient(smooth, joints.time_s)),
        ("the direction of motion", "", direction),
        ("angle", "rad", q - np.nanmean(q)),
    )
    variables = [
        ExplanatoryVariable(name=n, unit=u, values=_at(time_s, joints.time_s, v))
        for n, u, v in signals
    ]
    turning = np.interp(time_s, joints.time_s, (since < REVERSAL_S).astype(np.float64))
    return [
        *variables,
        ExplanatoryVariable(name="just after reversals", unit="", values=turning, is_regime=True),
    ]


def _at(time_s: Floats, times: Floats, values: Floats) -> Floats:
    """Interpolated values, across missing samples; NaN if all are missing."""
    known = np.isfinite(values)
    return (
        np.interp(time_s, times[known], values[known])
        if known.any()
        else np.full(len(time_s), np.nan)
    )
