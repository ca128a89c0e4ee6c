"""Tables and paragraphs of the report on what a simulator lacks."""

import html
import json
import platform
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from saltus.effects.profile import Profile, profile_to_toml
from saltus.effects.registry import EFFECTS
from saltus.provenance import commit, package_version
from saltus.real2sim.reporting.draws import drawn_lines
from saltus.real2sim.reporting.localise import Statement
from saltus.real2sim.reporting.steps import next_steps
from saltus.real2sim.reporting.words import sentence
from saltus.real2sim.results import Examination, Judgement
from saltus.real2sim.search.findings import FoundEffect, RankedModel
from saltus.real2sim.verdict import Gap, Verdict
from saltus.recordings.page import table

MEANING = {
    "named": "Named: these effects explain the gap, and nothing else that was tried explains it as well.",
    "set": "A set: something is missing, but these data cannot tell which of these effects it is.",
    "unexplained": "Unexplained: no effect of the library closes the gap.",
    "no_gap": "No gap: what the log differs by is within its noise.",
    "bad_log": "Bad log: it contradicts itself, and a fit to it would be wrong.",
}
PACKAGES = ("saltus", "mujoco", "numpy", "scipy")
NO_STEP = {
    "named": "None is needed.",
    "set": "No experiment of the menu would tell them apart.",
    "unexplained": "None is proposed: these data are where to look.",
    "no_gap": "None is needed.",
    "bad_log": "The log must be mended first.",
}
IN_PART = "Unexplained in part: what is named explains its part; a gap remains that no effect of the library closes."
UNTESTED = "Unexplained: these logs show too little to test anything, so nothing is named, and nothing is ruled out."
LEAST_NATS = 1.0
"""Gain below which a model is not shown, because it is chance."""
LONG = 12  # length of a list in the claims; longer ones are cut


def headline(verdict: Verdict, profile: Profile) -> str:
    """The verdict on a simulator with a profile in a sentence, its meaning, and the faults of the log."""
    kind = "good" if verdict.verdict in ("named", "no_gap") else "bad"
    meaning = IN_PART if verdict.verdict == "unexplained" and verdict.effects else MEANING[verdict.verdict]
    meaning = UNTESTED if verdict.gap is None and verdict.missing else meaning
    said = sentence(verdict, profile)
    faults = "".join(f'<p class="bad">{_text(fault)}</p>' for fault in verdict.log_faults)
    return f'<h1>{_text(said[0].upper() + said[1:])}</h1><p class="{kind}">{meaning}</p>{faults}'


def effects_table(
    found: Sequence[FoundEffect], rivals: Sequence[FoundEffect], nearest: Sequence[FoundEffect] = ()
) -> str:
    """Values of the effects, of the members of sets as they fit alone, and of the best model of what has no name."""
    rows = [
        (effect.name, _where(effect), name, f"{value.value:.4g}", _interval(*value.ci90), value.unit, remark)
        for effects, remark in ((found, "named"), (rivals, "in a set"), (nearest, "nearest, not named"))
        for effect in effects
        for name, value in effect.params.items()
    ]
    return (
        table(("effect", "where", "parameter", "value", "90 % interval", "unit", "status"), rows, "text")
        if rows
        else ""
    )


def gap_paragraph(gap: Gap | None) -> str:
    """The gap before and after, and its floor, in words."""
    if gap is None:
        return "<p>Nothing was left to judge by, so nothing is named.</p>"
    return (
        f"<p>Mean squared residual on segments that no fit has seen: <b>{gap.before:.3g}</b> before, "
        f"<b>{gap.after:.3g}</b> after, {gap.floor:.3g} for a perfect model. "
        f"Of what could be closed, <b>{gap.closed:.0%}</b> is closed.</p>"
    )


def statements(found: Sequence[Statement], count: int) -> str:
    """The first statements on where a gap lies."""
    if not found:
        return "<p>Nothing that goes with anything else in the log.</p>"
    return "<ul>" + "".join(f"<li>{_text(statement.text)}</li>" for statement in found[:count]) + "</ul>"


def what_is_left(effects: Sequence[str]) -> str:
    """Heading of what a model leaves."""
    return f"<p>With {_text(' and '.join(effects))} added, where it is large enough to be told, this is left:</p>"


def next_paragraph(judgement: Judgement) -> str:
    """The commands that come next, and the effects that an experiment would separate."""
    verdict = judgement.verdict
    said = "".join(f"<p>Not told apart: {_text(' or '.join(names))}.</p>" for names in verdict.sets)
    if verdict.next_experiment is not None:
        said += f"<p><b>{_text(verdict.next_experiment.name)}</b>, {_text(verdict.next_experiment.why)}</p>"
    steps = [
        f"<p>{_text(step.why[0].upper() + step.why[1:])}:</p><pre>{_text(step.command)}</pre>"
        for step in next_steps(judgement)
    ]
    return said + ("".join(steps) or f"<p>{NO_STEP[verdict.verdict]}</p>")


def draws(judgement: Judgement) -> str:
    """What the seed of a simulated run drew, and what is unknown."""
    return "".join(f'<p class="note">{_text(line[0].upper() + line[1:])}.</p>' for line in drawn_lines(judgement))


def untestable_table(verdict: Verdict) -> str:
    """Effects about which these data say nothing."""
    if verdict.verdict == "bad_log":
        return "<p>Nothing was tested: the log contradicts itself.</p>"
    if not verdict.untestable:
        return "<p>All effects of the library were tested.</p>"
    reasons: dict[str, list[str]] = {}
    for name, why in verdict.untestable.items():
        reasons.setdefault(why, []).append(name)
    return table(("effects", "why"), [(", ".join(names), why) for why, names in reasons.items()], "words")


def detectable_table(verdict: Verdict, profile: Profile) -> str:
    """Value of each effect from which on it would have been found, beside what the simulator has."""
    sizes = sorted(verdict.minimum_detectable.items())
    if not sizes:
        return "<p>None was worked out.</p>"
    rows = [(name, _known(profile, name, size.unit), f"{size.value:.4g}", size.unit) for name, size in sizes]
    return table(("effect", "the simulator has", "would be seen from", "unit"), rows)


def _known(profile: Profile, name: str, unit: str) -> str:
    """What a profile gives the first parameter of an effect with this unit, or where it changes nothing."""
    of_unit = [each for each in fields(EFFECTS[name]) if each.metadata.get("unit") == unit] if name in EFFECTS else []
    if not of_unit:
        return ""
    effect = profile.effects.get(name)
    value = of_unit[0].metadata.get("null") if effect is None else getattr(effect, of_unit[0].name)
    if value is None or np.ndim(value) > 1 or not np.size(value):  # a curve is no size
        return ""
    if not np.all(np.isfinite(value)):
        return "none"
    low, high = (f"{end:.4g}" for end in (np.min(value), np.max(value)))
    return low if low == high else f"{low} to {high}"


def idle_models(ranking: Sequence[RankedModel]) -> str:
    """The models without gain on held-out data."""
    names = [" + ".join(model.effects) for model in ranking if model.effects and model.gain < LEAST_NATS]
    return f'<p class="note">Without gain: {_text("; ".join(names))}.</p>' if names else ""


def clocks(examination: Examination) -> str:
    """Offsets between the streams of a log."""
    return "".join(f"<p>{_text(offset.text)}.</p>" for offset in examination.offsets)


def provenance(judgement: Judgement, profile: Profile, seed: int) -> str:
    """Digests of the logs, commit and versions of the code, and the claims."""
    logs = table(("log", "SHA-256"), [(each.log, each.sha256) for each in judgement.evidence], "text")
    runs = sum(comparison.findings.evaluations for each in judgement.examinations for comparison in each.comparisons)
    lines = [
        f"commit = {commit()}",
        f"seed = {seed}",
        f"python = {platform.python_version()}",
        *(f"{name} = {package_version(name)}" for name in PACKAGES),
        f"simulated sets of unknowns = {runs}",
        "",
        "# effects that the simulator had from the start",
        profile_to_toml(profile).strip() or "none",
    ]
    claims = [
        "\n".join(["# claimed by the log", *(f"{name} = {json.dumps(value)}" for name, value in claimed.items())])
        for claimed in (_claims(each.log.meta) for each in judgement.examinations)
    ]
    return logs + "".join(f"<pre>{_text(part)}</pre>" for part in ("\n".join(lines), *claims))


def _claims(meta: dict[str, Any]) -> dict[str, Any]:
    """The claims without the path of a model and the segments."""
    claims = {name: value for name, value in meta.items() if name not in ("excitation", "segments")}
    claims["robot"] = Path(str(meta.get("robot", ""))).name
    return {name: _short(value) for name, value in claims.items()}


def _short(value: Any) -> Any:
    return [*value[:LONG], "..."] if isinstance(value, list) and len(value) > LONG else value


def _where(effect: FoundEffect) -> str:
    return effect.where if isinstance(effect.where, str) else ", ".join(effect.where)


def _interval(low: float, high: float) -> str:
    return f"{low:.4g} to {high:.4g}"


def _text(value: str) -> str:
    return html.escape(str(value))
