"""`report.html`: what was found, the evidence for it, and what these data cannot show.

It opens without a network. Residuals are in units of noise (sigma) and from test segments, unless
the page says otherwise.
"""

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from saltus.effects.profile import EFFECTS, Profile
from saltus.provenance import current_commit, package_version
from saltus.real2sim.problem.camera.problem import COLUMN, ROW
from saltus.real2sim.reporting import figures
from saltus.real2sim.reporting.localise import (
    ResidualExplanation,
    ResidualSignal,
    channels_of,
    localise_gap,
)
from saltus.real2sim.reporting.verdict_text import (
    by_reason,
    drawn_lines,
    next_steps,
    place_text,
    verdict_sentence,
)
from saltus.real2sim.results import Judgement, SensorResult
from saltus.real2sim.search.findings import ModelResiduals, SearchFindings
from saltus.real2sim.verdict import Verdict
from saltus.reports.page import render_page

MEANING = {
    "named": "Named: these effects explain the gap, "
    "and nothing else that was tried explains it as well.",
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
IN_PART = (
    "Unexplained in part: what is named explains its part; "
    "a gap remains that no effect of the library closes."
)
UNTESTED = (
    "Unexplained: these logs show too little to test anything, so nothing is named, "
    "and nothing is ruled out."
)
LONG = 12  # length of a list in the claims; longer ones are cut
SAID_BEFORE, SAID_AFTER = 6, 3
"""Number of statements on where the gap lies, and on what is left."""

Pair = tuple[ResidualSignal, ResidualSignal]
"""A channel before and after what was found."""


@dataclass(frozen=True, kw_only=True)
class ShownResiduals:
    """Residuals of one sensor, as the page shows them."""

    statements: Sequence[ResidualExplanation]
    left: Sequence[ResidualExplanation] | None
    """Statements on what the chosen model leaves; None where it changes nothing."""
    before: Sequence[ResidualSignal]
    after: Sequence[ResidualSignal]
    worst: Sequence[Pair]
    images: Sequence[go.Figure]

    @property
    def has_places(self) -> bool:
        """True where channels are at several places, e.g. joints."""
        return len({channel.place for channel in self.before}) > 1


def report_page(judgement: Judgement, *, seed: int = 0) -> str:
    """The text of `report.html`; the simulator had the effects of its profile from the start."""
    verdict = judgement.verdict
    findings = [
        comparison.findings for each in judgement.examinations for comparison in each.comparisons
    ]
    return render_page(
        __file__,
        judgement=judgement,
        verdict=verdict,
        sentence=verdict_sentence(verdict, judgement.profile),
        meaning=_meaning(verdict),
        drawn=drawn_lines(judgement),
        effects=_effects(verdict, findings),
        has_findings=bool(findings),
        residuals=_residuals,
        figures=figures,
        steps=next_steps(judgement),
        no_step=NO_STEP[verdict.verdict],
        untestable=by_reason(verdict.untestable),
        detectable=[
            (name, _known(judgement.profile, name, size.unit), f"{size.value:.4g}", size.unit)
            for name, size in sorted(verdict.minimum_detectable.items())
        ],
        logs=[(each.log, each.sha256) for each in judgement.evidence],
        provenance=_provenance(judgement, findings, seed),
    )


def _meaning(verdict: Verdict) -> str:
    if verdict.gap is None and verdict.missing:
        return UNTESTED
    return (
        IN_PART
        if verdict.verdict == "unexplained" and verdict.effects
        else MEANING[verdict.verdict]
    )


def _effects(verdict: Verdict, findings: Sequence[SearchFindings]) -> list[tuple[str, ...]]:
    """Values of the effects, of the members of sets as they fit alone,
    and of the best model of what has no name.
    """
    rivals = [rival for each in findings for rival in each.rivals]
    return [
        (effect.name, ", ".join(place_text(effect)), name, f"{found.value:.4g}",
         "{:.4g} to {:.4g}".format(*found.ci90), found.unit, remark)
        for effects, remark in (
            (verdict.effects, "named"), (rivals, "in a set"),
            (verdict.nearest, "nearest, not named")
        )
        for effect in effects
        for name, found in effect.params.items()
    ]  # fmt: skip


def _residuals(comparison: SensorResult, residuals: ModelResiduals) -> ShownResiduals:
    """Residuals of a comparison before and after what was found."""
    problem, log = comparison.problem, comparison.log
    both = (residuals.before, residuals.after)
    known = (residuals.before != 0.0) | (residuals.after != 0.0)  # missing samples are 0
    before, after = (channels_of(problem, log, left, known & residuals.is_test) for left in both)
    worst = [(before[i], after[i]) for i in figures.worst_channels(before)]
    variables = [
        {variable.name: variable for variable in channel.variables} for channel, _ in worst
    ]
    return ShownResiduals(
        statements=localise_gap(channels_of(problem, log, residuals.before, known))[:SAID_BEFORE],
        left=None
        if np.array_equal(*both)
        else localise_gap(channels_of(problem, log, residuals.after, known))[:SAID_AFTER],
        before=before,
        after=after,
        worst=worst,
        images=[
            figures.image_figure(*pair, of[ROW], of[COLUMN])
            for pair, of in zip(worst, variables, strict=True)
            if ROW in of
        ],
    )


def _known(profile: Profile, name: str, unit: str) -> str:
    """Returns what a profile gives the first parameter of an effect with this unit,
    or where it changes nothing.
    """
    of_unit = (
        [each for each in fields(EFFECTS[name]) if each.metadata.get("unit") == unit]
        if name in EFFECTS
        else []
    )
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


def _provenance(judgement: Judgement, findings: Sequence[SearchFindings], seed: int) -> list[str]:
    """Commit and versions of the code with the profile, and the claims of each log."""
    lines = [
        f"commit = {current_commit()}",
        f"seed = {seed}",
        f"python = {platform.python_version()}",
        *(f"{name} = {package_version(name)}" for name in PACKAGES),
        f"simulated sets of unknowns = {sum(each.evaluations for each in findings)}",
        "",
        "# effects that the simulator had from the start",
        judgement.profile.to_toml().strip() or "none",
    ]
    claims = [
        "\n".join(
            [
                "# claimed by the log",
                *(f"{name} = {json.dumps(value)}" for name, value in claimed.items()),
            ]
        )
        for claimed in (_claims(each.log.meta) for each in judgement.examinations)
    ]
    return ["\n".join(lines), *claims]


def _claims(meta: Mapping[str, object]) -> dict[str, object]:
    """The claims without the path of a model and the segments."""
    claims = {name: value for name, value in meta.items() if name not in ("excitation", "segments")}
    claims["robot"] = Path(str(meta.get("robot", ""))).name
    return {name: _short(value) for name, value in claims.items()}


def _short(value: object) -> object:
    return [*value[:LONG], "..."] if isinstance(value, list) and len(value) > LONG else value
