"""Sets that shrink because other sensors or other logs rule some of their effects out."""

import math
from collections.abc import Sequence
from dataclasses import fields, replace

from saltus.effects.profile import EFFECTS
from saltus.real2sim.search.findings import Findings, FoundEffect

MARGIN = 1.5
"""An effect is ruled out if it would have to be this many times larger than the smallest detectable size, which doubles
the gain in nats."""


def resolved(findings: Sequence[Findings]) -> tuple[Findings, ...]:
    """Findings without the effects that other findings rule out; a set of one effect becomes a name.

    If another finding names exactly one effect of a set, that one stays. If another finding would have detected an
    effect at the size that the set needs, and did not, that effect goes.
    """
    named = {effect.name for each in findings for effect in each.effects if each.verdict == "named"}
    result = []
    for each in findings:
        others = [other for other in findings if other is not each]
        sets, effects = [], list(each.effects)
        for members in each.sets:
            if len(named & set(members)) == 1:
                continue
            left = tuple(name for name in members if not any(_rules_out(other, name, each) for other in others))
            if len(left) == 1 and (values := [rival for rival in each.rivals if rival.name == left[0]]):
                effects += values
            else:
                sets.append(left if len(left) > 1 else members)
        decided = each.verdict == "set" and not sets
        result.append(
            replace(each, effects=tuple(effects), sets=tuple(sets), verdict="named" if decided else each.verdict)
        )
    return tuple(result)


def deviation(name: str, parameter: str, value: float) -> float:
    """Distance of a parameter from its null value; NaN if the null value is not finite."""
    null = next((f.metadata["null"] for f in fields(EFFECTS[name]) if f.name == parameter), math.nan)
    return abs(value - null) if isinstance(null, int | float) and math.isfinite(null) else math.nan


def largest(name: str, rivals: Sequence[FoundEffect]) -> float:
    """Largest distance of the first parameter of an effect from null over all its places; NaN if unknown."""
    sizes = [
        deviation(name, p, found.value) for r in rivals if r.name == name for p, found in list(r.params.items())[:1]
    ]
    return max((size for size in sizes if math.isfinite(size)), default=math.nan)


def _rules_out(other: Findings, name: str, of: Findings) -> bool:
    """True where a finding would have shown an effect of the size that another finding needs, and did not."""
    if other.verdict not in ("no_gap", "named") or other.problem == of.problem or name not in other.minimum_detectable:
        return False
    if any(effect.name == name for effect in other.effects):
        return False
    parameter = next((p for r in of.rivals if r.name == name for p in r.params), "")
    would_show = deviation(name, parameter, other.minimum_detectable[name].value) if parameter else math.nan
    return MARGIN * would_show <= largest(name, of.rivals)  # false if either is NaN
