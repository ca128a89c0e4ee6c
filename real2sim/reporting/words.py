"""A verdict in a sentence."""

from saltus.real2sim.search.findings import FoundEffect
from saltus.real2sim.verdict import Verdict

CLOSED_FROM = 0.005  # smaller shares round to 0 %


def sentence(verdict: Verdict) -> str:
    """The verdict as one sentence."""
    if verdict.verdict == "bad_log":
        return f"The log contradicts itself, so nothing was fitted to it: {verdict.log_faults[0]}"
    if verdict.verdict == "no_gap":
        return "The log agrees with the simulator within its noise."
    named = " and ".join(_effect(effect) for effect in verdict.effects)
    sets = "; ".join(f"either {' or '.join(names)}, which these data cannot tell apart" for names in verdict.sets)
    found = "; ".join(part for part in (named, sets) if part) or "no effect that Saltus knows explains it"
    start = "Something else is missing, too: " if verdict.verdict == "unexplained" and named else ""
    return f"{start}the simulator lacks {found}{_closed(verdict)}." if named or sets else _unexplained(verdict)


def _unexplained(verdict: Verdict) -> str:
    best = _closed(verdict, "the best model")
    return f"The log and the simulator differ, and no effect that Saltus knows explains it{best}."


def _effect(effect: FoundEffect) -> str:
    values = ", ".join(f"{name} {found.value:.3g} {found.unit}".rstrip() for name, found in effect.params.items())
    where = effect.where if isinstance(effect.where, str) else ", ".join(effect.where)
    return f"{effect.name} ({values}; {where})"


def _closed(verdict: Verdict, added: str = "it") -> str:
    if verdict.gap is None or verdict.gap.closed < CLOSED_FROM:
        return ""
    return f"; with {added} {verdict.gap.closed:.0%} of the gap on unseen segments is closed"
