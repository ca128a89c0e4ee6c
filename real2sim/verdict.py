"""`verdict.json`: what was found in run logs, with the keys of the schema of run logs."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

from saltus.config import from_table
from saltus.effects.profile import EFFECTS
from saltus.real2sim.problem.problem import ParameterEstimate
from saltus.real2sim.search.findings import FoundEffect, SearchFindings

Ruling = Literal["named", "set", "unexplained", "no_gap", "bad_log"]


@dataclass(frozen=True, kw_only=True)
class ResidualGap:
    """Mean squared whitened residual on segments that no fit has seen; 1 is noise alone."""

    before: float
    after: float
    floor: float

    @property
    def closed(self) -> float:
        """Share of the closable gap that is closed; 0 if there is none."""
        closable = self.before - self.floor
        return (self.before - self.after) / closable if closable > 0.0 else 0.0


@dataclass(frozen=True, kw_only=True)
class NextExperiment:
    """The experiment that would tell the effects of a set apart."""

    name: str
    why: str
    expected_separation: float


@dataclass(frozen=True, kw_only=True)
class MissingData:
    """Missing data, without which a sensor's effects could not be tested."""

    sensor: str
    why: str
    """How much there is, and how much it takes."""
    experiment: str
    """Which gets it."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The verdict on run logs: contents of `verdict.json`."""

    verdict: Ruling
    effects: tuple[FoundEffect, ...] = ()
    sets: tuple[tuple[str, ...], ...] = ()
    next_experiment: NextExperiment | None = None
    untestable: dict[str, str] = field(default_factory=dict)
    """Effects that these data cannot show, and why."""
    missing: tuple[MissingData, ...] = ()
    """Sensors of which the logs show too little to test anything."""
    misfits: tuple[str, ...] = ()
    """Effects of the profile without which the simulator is much nearer to the log."""
    nearest: tuple[FoundEffect, ...] = ()
    """Where a gap is unexplained, the best model for it: not the cause, only where to look."""
    gap: ResidualGap | None = None
    minimum_detectable: dict[str, ParameterEstimate] = field(default_factory=dict)
    log_faults: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.gap is None and (
            self.effects or self.sets or self.nearest or self.verdict in ("named", "set")
        ):
            raise ValueError("a verdict names effects that nothing was left to test by")

    def to_dict(self) -> dict[str, object]:
        """The verdict as JSON holds it."""
        return {
            "verdict": self.verdict,
            "effects": [effect_to_dict(effect) for effect in self.effects],
            "sets": [list(names) for names in self.sets],
            "next_experiment": None
            if self.next_experiment is None
            else vars(self.next_experiment).copy(),
            "untestable": [{"name": name, "why": why} for name, why in self.untestable.items()],
            "missing": [vars(each).copy() for each in self.missing],
            "misfits": list(self.misfits),
            "nearest": [effect_to_dict(effect) for effect in self.nearest],
            "gap": None if self.gap is None else {**vars(self.gap), "closed": self.gap.closed},
            "minimum_detectable": {
                name: {"value": size.value, "unit": size.unit}
                for name, size in self.minimum_detectable.items()
            },
            "log_faults": list(self.log_faults),
        }

    def to_json(self) -> str:
        """The verdict as one line of JSON."""
        return json.dumps(self.to_dict())


def merge_findings(findings: Sequence[SearchFindings], log_faults: Sequence[str] = ()) -> Verdict:
    """One verdict for a log from what was found for each kind of sensor.

    A damaged log gets no other ruling. An unexplained gap outweighs a set, and a set outweighs
    names: the verdict is never more certain than its least certain part. The gap pools squared
    residuals.
    """
    if log_faults:
        return Verdict(verdict="bad_log", log_faults=tuple(log_faults))
    rulings = {each.verdict for each in findings}
    order: tuple[Ruling, ...] = ("unexplained", "set", "named")
    ruling: Ruling = next((name for name in order if name in rulings), "no_gap")
    sets = dict.fromkeys(names for each in findings for names in each.sets)
    return Verdict(
        verdict=ruling,
        effects=tuple(effect for each in findings for effect in each.effects),
        sets=tuple(sets),
        untestable={name: why for each in findings for name, why in each.untestable.items()},
        misfits=tuple(name for each in findings for name in each.misfits),
        nearest=tuple(effect for each in findings for effect in each.nearest),
        gap=_pool(findings),
        minimum_detectable={
            name: size for each in findings for name, size in each.minimum_detectable.items()
        },
    )


def _pool(findings: Sequence[SearchFindings]) -> ResidualGap | None:
    """The gap of the sensors that show one, or of all sensors if none does,
    weighted by their numbers of residuals.
    """
    counted = [each for each in findings if each.verdict != "no_gap"] or list(findings)
    rows = sum(gap.residuals for each in counted for gap in each.gaps)
    if rows == 0:
        return None

    def mean(name: str) -> float:
        return float(
            sum(getattr(gap, name) * gap.residuals for each in counted for gap in each.gaps) / rows
        )

    return ResidualGap(before=mean("before"), after=mean("after"), floor=mean("floor"))


def effect_to_dict(effect: FoundEffect) -> dict[str, object]:
    """An effect as JSON and TOML hold it."""
    params: dict[str, object] = {
        name: {"value": found.value, "ci90": list(found.ci90), "unit": found.unit}
        for name, found in effect.params.items()
    }
    if effect.curve:
        params["curve"] = {"value": [list(pair) for pair in effect.curve], "unit": "Nm"}
    return {
        "name": effect.name,
        "where": effect.where if isinstance(effect.where, str) else list(effect.where),
        "params": params,
    }


def effect_from_dict(data: dict[str, Any]) -> FoundEffect:
    """The effect that `effect_to_dict` was called on;
    `ConfigError` says what is wrong with an entry.
    """
    params = dict(data.get("params", {}))
    curve = params.pop("curve", {}).get("value", [])
    return from_table(FoundEffect, {**data, "params": params, "curve": curve})


MARGIN = 1.5
"""An effect is ruled out if it would have to be this many times larger than the smallest detectable
size, which doubles the gain in nats."""


def without_ruled_out(findings: Sequence[SearchFindings]) -> tuple[SearchFindings, ...]:
    """Findings without the effects that other findings rule out.

    A set of one effect becomes a name.

    If another finding names exactly one effect of a set, that one stays. If another finding would
    have detected an effect at the size that the set needs, and did not, that effect goes.
    """
    named = {effect.name for each in findings for effect in each.effects if each.verdict == "named"}
    result = []
    for each in findings:
        others = [other for other in findings if other is not each]
        sets, effects = [], list(each.effects)
        for members in each.sets:
            if len(named & set(members)) == 1:
                continue
            left = tuple(
                name
                for name in members
                if not any(_rules_out(other, name, each) for other in others)
            )
            if len(left) == 1 and (
                values := [rival for rival in each.rivals if rival.name == left[0]]
            ):
                effects += values
            else:
                sets.append(left if len(left) > 1 else members)
        decided = each.verdict == "set" and not sets
        result.append(
            replace(
                each,
                effects=tuple(effects),
                sets=tuple(sets),
                verdict="named" if decided else each.verdict,
            )
        )
    return tuple(result)


def deviation(name: str, parameter: str, value: float) -> float:
    """Distance of a parameter from its null value; NaN if the null value is not finite."""
    null = next(
        (f.metadata["null"] for f in fields(EFFECTS[name]) if f.name == parameter), math.nan
    )
    return abs(value - null) if isinstance(null, int | float) and math.isfinite(null) else math.nan


def largest_distance(name: str, rivals: Sequence[FoundEffect]) -> float:
    """Largest distance of the first parameter of an effect from null over all its places;
    NaN if unknown.
    """
    sizes = [
        deviation(name, p, found.value)
        for r in rivals
        if r.name == name
        for p, found in list(r.params.items())[:1]
    ]
    return max((size for size in sizes if math.isfinite(size)), default=math.nan)


def _rules_out(other: SearchFindings, name: str, of: SearchFindings) -> bool:
    """True where a finding would have shown an effect of the size that another finding needs,
    and did not.
    """
    if (
        other.verdict not in ("no_gap", "named")
        or other.problem == of.problem
        or name not in other.minimum_detectable
    ):
        return False
    if any(effect.name == name for effect in other.effects):
        return False
    parameter = next((p for r in of.rivals if r.name == name for p in r.params), "")
    would_show = (
        deviation(name, parameter, other.minimum_detectable[name].value) if parameter else math.nan
    )
    return MARGIN * would_show <= largest_distance(name, of.rivals)  # false if either is NaN
