"""A verdict in a sentence."""

from collections.abc import Mapping, Sequence

from saltus.effects.profile import IDEAL, Profile
from saltus.real2sim.search.findings import FoundEffect, Interval
from saltus.real2sim.verdict import Verdict

CLOSED_FROM = 0.005  # smaller shares round to 0 %
MOST_PLACES = 4  # one of each leg; more are counted


def sentence(verdict: Verdict, profile: Profile = IDEAL) -> str:
    """The verdict on a simulator with this profile in a sentence, and a second one if effects of it do not fit."""
    if verdict.verdict == "bad_log":
        return f"The log contradicts itself, so nothing was fitted to it: {verdict.log_faults[0]}"
    if verdict.verdict == "no_gap":
        return "The log agrees with the simulator within its noise."
    if verdict.gap is None and verdict.missing:
        return f"Too little to test anything by, so nothing is named. {'. '.join(m.why for m in verdict.missing)}."
    changed = ", and ".join(
        f"the profile's {name} does not fit the log, while {_effects(verdict, {name})} does"
        for name in dict.fromkeys(effect.name for effect in verdict.effects)
        if name in profile.effects
    )
    named = _effects(verdict, {effect.name for effect in verdict.effects} - profile.effects.keys())
    sets = "; ".join(f"either {' or '.join(names)}, which these data cannot tell apart" for names in verdict.sets)
    lacking = "; ".join(part for part in (named, sets) if part)
    found = "; ".join(part for part in (lacking and f"the simulator lacks {lacking}", changed) if part)
    start = "Something else is missing, too: " if verdict.verdict == "unexplained" and verdict.effects else ""
    whole = f"{start}{found}{_closed(verdict)}." if found else _unexplained(verdict)
    return f"{whole} {_misfits(verdict.misfits)}" if verdict.misfits else whole


def value_lines(verdict: Verdict) -> list[str]:
    """A line for each effect that is named, or else is nearest to what has no name, with values and 90 % intervals.

    An effect with values of its own at many places has a line for some of them.
    """
    lines: list[str] = []
    for effects, remark in ((verdict.effects, ""), (verdict.nearest, " (nearest, not named)")):
        for name in dict.fromkeys(effect.name for effect in effects):
            own = [effect for effect in effects if effect.name == name]
            lines += [_line(effect, remark) for effect in own[:MOST_PLACES]]
            if len(own) > MOST_PLACES:
                lines.append(f"{name} at {len(own) - MOST_PLACES} more places: see the report{remark}")
    return lines


def places(effect: FoundEffect) -> Sequence[str]:
    """Place of an effect, e.g. some joints or one sensor."""
    return [effect.where] if isinstance(effect.where, str) else effect.where


def by_reason(untestable: Mapping[str, str]) -> list[tuple[str, str]]:
    """Effects that data cannot show, those of one reason in one row, and the reason."""
    reasons: dict[str, list[str]] = {}
    for name, why in untestable.items():
        reasons.setdefault(why, []).append(name)
    return [(", ".join(names), why) for why, names in reasons.items()]


def _line(effect: FoundEffect, remark: str) -> str:
    values = ", ".join(
        f"{name} {found.value:.4g} ({found.ci90[0]:.4g} to {found.ci90[1]:.4g}) {found.unit}".rstrip()
        for name, found in effect.params.items()
    )
    return f"{effect.name} at {', '.join(places(effect))}: {values}{remark}"


def _misfits(names: tuple[str, ...]) -> str:
    do = "does" if len(names) == 1 else "do"
    without = "compare it with a profile without, as --profile ideal"
    return f"The profile's {' and '.join(names)} {do} not fit the log: {without}."


def _unexplained(verdict: Verdict) -> str:
    if verdict.misfits:
        return "The log and the simulator differ."
    start = "The log and the simulator differ, and no effect that Saltus knows explains it"
    if not verdict.nearest:
        return f"{start}{_closed(verdict, 'the best model')}."
    nearest = _spoken(verdict.nearest)
    return f"{start}; the nearest is {nearest}{_closed(verdict)}."


def _effects(verdict: Verdict, names: set[str]) -> str:
    return _spoken([effect for effect in verdict.effects if effect.name in names])


def _spoken(effects: Sequence[FoundEffect]) -> str:
    alike: dict[str, list[FoundEffect]] = {}
    for effect in effects:
        alike.setdefault(effect.name, []).append(effect)
    return " and ".join(_effect(name, effects) for name, effects in alike.items())


def _effect(name: str, effects: list[FoundEffect]) -> str:
    """An effect once, however many places have values of their own."""
    values = ", ".join(_value(param, [effect.params[param] for effect in effects]) for param in effects[0].params)
    where = [place for effect in effects for place in places(effect)]
    return f"{name} ({values}; {', '.join(where) if len(where) <= MOST_PLACES else f'{len(where)} joints'})"


def _value(param: str, found: list[Interval]) -> str:
    low, high = (f"{end(each.value for each in found):.3g}" for end in (min, max))
    return f"{param} {low if low == high else f'{low} to {high}'} {found[0].unit}".rstrip()


def _closed(verdict: Verdict, added: str = "it") -> str:
    if verdict.gap is None or verdict.gap.closed < CLOSED_FROM:
        return ""
    return f"; with {added} {verdict.gap.closed:.0%} of the gap on unseen segments is closed"
