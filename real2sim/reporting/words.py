"""A verdict in a sentence."""

from saltus.effects.profile import IDEAL, Profile
from saltus.real2sim.search.findings import FoundEffect
from saltus.real2sim.verdict import Verdict

CLOSED_FROM = 0.005  # smaller shares round to 0 %


def sentence(verdict: Verdict, profile: Profile = IDEAL) -> str:
    """The verdict on a simulator with this profile in a sentence, and a second one if effects of it do not fit."""
    if verdict.verdict == "bad_log":
        return f"The log contradicts itself, so nothing was fitted to it: {verdict.log_faults[0]}"
    if verdict.verdict == "no_gap":
        return "The log agrees with the simulator within its noise."
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


def _misfits(names: tuple[str, ...]) -> str:
    do = "does" if len(names) == 1 else "do"
    return f"The profile's {' and '.join(names)} {do} not fit the log: compare it with a profile without."


def _unexplained(verdict: Verdict) -> str:
    if verdict.misfits:
        return "The log and the simulator differ."
    best = _closed(verdict, "the best model")
    return f"The log and the simulator differ, and no effect that Saltus knows explains it{best}."


def _effects(verdict: Verdict, names: set[str]) -> str:
    return " and ".join(_effect(effect) for effect in verdict.effects if effect.name in names)


def _effect(effect: FoundEffect) -> str:
    values = ", ".join(f"{name} {found.value:.3g} {found.unit}".rstrip() for name, found in effect.params.items())
    where = effect.where if isinstance(effect.where, str) else ", ".join(effect.where)
    return f"{effect.name} ({values}; {where})"


def _closed(verdict: Verdict, added: str = "it") -> str:
    if verdict.gap is None or verdict.gap.closed < CLOSED_FROM:
        return ""
    return f"; with {added} {verdict.gap.closed:.0%} of the gap on unseen segments is closed"
