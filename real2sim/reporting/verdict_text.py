"""A verdict in words: a sentence, values, what the seeds of simulated runs drew,
and the commands that come next.
"""

import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from saltus.constants import POLICY_DT
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.profile import IDEAL, SHIPPED, Profile, load_profile
from saltus.errors import SaltusError
from saltus.real2sim.patch import PATCH_FILE
from saltus.real2sim.problem.log import claimed_model, robot_of
from saltus.real2sim.results import Judgement
from saltus.real2sim.search.findings import FoundEffect, ParameterInterval
from saltus.real2sim.verdict import Verdict
from saltus.recordings.run_log import RunLog
from saltus.robots.robot import Robot
from saltus.robots.shipped import robot_name_in
from saltus.trial import Trial

CLOSED_FROM = 0.005  # smaller shares round to 0 %
MOST_PLACES = 4  # one of each leg; more are counted


def verdict_sentence(verdict: Verdict, profile: Profile = IDEAL) -> str:
    """The verdict on a simulator with this profile in a sentence,
    and a second one if effects of it do not fit.
    """
    if verdict.verdict == "bad_log":
        return f"The log contradicts itself, so nothing was fitted to it: {verdict.log_faults[0]}"
    if verdict.verdict == "no_gap":
        return "The log agrees with the simulator within its noise."
    if verdict.gap is None and verdict.missing:
        return (
            f"Too little to test anything by, so nothing is named. "
            f"{'. '.join(m.why for m in verdict.missing)}."
        )
    changed = ", and ".join(
        f"the profile's {name} does not fit the log, while {_effects(verdict, {name})} does"
        for name in dict.fromkeys(effect.name for effect in verdict.effects)
        if name in profile.effects
    )
    named = _effects(verdict, {effect.name for effect in verdict.effects} - profile.effects.keys())
    sets = "; ".join(
        f"either {' or '.join(names)}, which these data cannot tell apart" for names in verdict.sets
    )
    lacking = "; ".join(part for part in (named, sets) if part)
    found = "; ".join(
        part for part in (lacking and f"the simulator lacks {lacking}", changed) if part
    )
    start = (
        "Something else is missing, too: "
        if verdict.verdict == "unexplained" and verdict.effects
        else ""
    )
    whole = f"{start}{found}{_closed(verdict)}." if found else _unexplained(verdict)
    return f"{whole} {_misfits(verdict.misfits)}" if verdict.misfits else whole


def value_lines(verdict: Verdict) -> list[str]:
    """A line for each effect that is named, or else is nearest to what has no name,
    with values and 90 % intervals.

    An effect with values of its own at many places has a line for some of them.
    """
    lines: list[str] = []
    for effects, remark in ((verdict.effects, ""), (verdict.nearest, " (nearest, not named)")):
        for name in dict.fromkeys(effect.name for effect in effects):
            own = [effect for effect in effects if effect.name == name]
            lines += [_line(effect, remark) for effect in own[:MOST_PLACES]]
            if len(own) > MOST_PLACES:
                lines.append(
                    f"{name} at {len(own) - MOST_PLACES} more places: see the report{remark}"
                )
    return lines


def place_text(effect: FoundEffect) -> Sequence[str]:
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
        f"{name} {found.value:.4g} ({found.ci90[0]:.4g} to {found.ci90[1]:.4g}) "
        f"{found.unit}".rstrip()
        for name, found in effect.params.items()
    )
    return f"{effect.name} at {', '.join(place_text(effect))}: {values}{remark}"


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
    values = ", ".join(
        _value(param, [effect.params[param] for effect in effects]) for param in effects[0].params
    )
    where = [place for effect in effects for place in place_text(effect)]
    return (
        f"{name} ({values}; "
        f"{', '.join(where) if len(where) <= MOST_PLACES else f'{len(where)} joints'})"
    )


def _value(param: str, found: list[ParameterInterval]) -> str:
    low, high = (f"{end(each.value for each in found):.3g}" for end in (min, max))
    return f"{param} {low if low == high else f'{low} to {high}'} {found[0].unit}".rstrip()


def _closed(verdict: Verdict, added: str = "it") -> str:
    if verdict.gap is None or verdict.gap.closed < CLOSED_FROM:
        return ""
    return f"; with {added} {verdict.gap.closed:.0%} of the gap on unseen segments is closed"


EXACT_S = 0.001
"""Time by which a found latency may be below the drawn one; above it by a tick of images more."""


def drawn_lines(judgement: Judgement) -> list[str]:
    """Returns what the seeds of simulated runs drew, and which effects are not of them.

    Else nothing.

    A line for the draws, one for the effects that are draws, one for those that are not.
    """
    logs = [each.log for each in judgement.examinations]
    trials = {trial.seed: trial for log in logs if (trial := _trial(log)) is not None}
    if not trials:
        return []
    lines = [
        f"drawn by the seed of the run ({seed}), and claimed by its log: payload "
        f"{trial.payload_kg:.3g} kg, "
        f"motor strength {trial.motor_strength:.3g}, friction of the ground {trial.friction:.3g}"
        for seed, trial in trials.items()
    ]
    verdict = judgement.verdict
    told = (*verdict.effects, *verdict.nearest)
    own = [effect for effect in told if is_drawn(effect, logs)]
    for effect in own:
        value = effect.params["latency"].value
        lines.append(
            f"drawn as well, and not claimed: {effect.name} ({value:.3g} s) is that of the seed"
        )
    if unknown := dict.fromkeys(effect.name for effect in told if effect not in own):
        lines.append(f"not drawn by the seed, so of the robot itself: {', '.join(unknown)}")
    return lines


def is_drawn(effect: FoundEffect, logs: Sequence[RunLog]) -> bool:
    """True of a camera latency that is, within a policy step,
    the one that a simulated run's seed drew.
    """
    if effect.name != CameraLatency.name or "latency" not in effect.params:
        return False
    latencies = [_latency_s(log, trial) for log in logs if (trial := _trial(log)) is not None]
    found_s = effect.params["latency"].value
    return any(-EXACT_S <= found_s - drawn_s <= POLICY_DT + EXACT_S for drawn_s in latencies)


def _trial(log: RunLog) -> Trial | None:
    """The trial of a simulated run; the log of a real robot claims no motor strength."""
    config = log.meta.get("config")
    if (
        not isinstance(config, dict)
        or not isinstance(config.get("seed"), int)
        or "motor_strength" not in log.meta
    ):
        return None
    return Trial.draw(config["seed"])


def _latency_s(log: RunLog, trial: Trial) -> float:
    """The camera's latency of a trial's robot; that of the nominal one without its profile."""
    with suppress(SaltusError):
        profile = trial.applied_to(
            load_profile(str(log.meta["config"].get("profile")), robot_of(log))
        )
        return float(next((e.latency for e in profile.camera if isinstance(e, CameraLatency)), 0.0))
    return trial.camera_delay_s


HELD = "joint_tour"
"""Shows all that a held robot's drives can show."""


class NextStep(NamedTuple):
    """A command that a verdict advises, and what it is for."""

    command: str
    why: str

    def __str__(self) -> str:
        return f"{self.command}  ({self.why})"


def next_steps(judgement: Judgement, directory: Path = Path()) -> list[NextStep]:
    """Commands in the order of their worth; `directory` is where the patch lies.

    None where the log contradicts itself, or agrees with the simulator and shows enough.
    """
    verdict = judgement.verdict
    logs = [each.log for each in judgement.examinations]
    if verdict.verdict == "bad_log":
        return []
    steps = []
    if any(not is_drawn(effect, logs) for effect in judgement.patch.effects):
        patch = shlex.quote(str(directory / PATCH_FILE))
        command = f"saltus real2sim apply {patch} --profile mine{_base(judgement)}"
        steps.append(NextStep(command, "puts what is named into a profile"))
    proposed = [] if verdict.next_experiment is None else [verdict.next_experiment.name]
    whys = dict.fromkeys(proposed, "and give find both logs")
    for missing in verdict.missing:
        whys.setdefault(missing.experiment, f"long enough for the {missing.sensor}")
    if verdict.verdict in ("set", "unexplained") and all(
        log.meta.get("base") != "fixed" for log in logs
    ):
        whys.setdefault(HELD, "hang it up: a robot in the air shows its drives without the ground")
    elif verdict.verdict == "unexplained" and not any(_is_of(log, HELD) for log in logs):
        whys.setdefault(HELD, "all that a held robot's drives can show, each motion twice")
    return steps + [
        NextStep(_experiment_command(name, robot_name_in(logs[0].meta)), why)
        for name, why in whys.items()
    ]


def _base(judgement: Judgement) -> str:
    """The flag that begins a new profile with the one of the comparison."""
    if judgement.profile == IDEAL:
        return ""
    model = claimed_model(judgement.examinations[0].log)
    is_shipped = isinstance(model, Robot) and judgement.profile == load_profile(SHIPPED, model)
    return f" --base {SHIPPED if is_shipped else 'PROFILE'}"


def _is_of(log: RunLog, experiment: str) -> bool:
    """Says if a log claims to be of an experiment, as `saltus real2sim experiments` writes it."""
    excitation = log.meta.get("excitation")
    return isinstance(excitation, dict) and str(excitation.get("text", "")).startswith(
        f"{experiment}:"
    )


def _experiment_command(experiment: str, robot: str) -> str:
    own = "" if robot == robot_name_in({}) else f" --robot {shlex.quote(robot)}"
    return f"saltus real2sim experiments --run {experiment}{own} --out logs/{experiment}"


def verdict_lines(judgement: Judgement, directory: Path) -> list[str]:
    """The verdict's word, values with intervals, what is doubtful, and what comes next.

    `directory` holds the patch.
    """
    verdict, profile = judgement.verdict, judgement.profile
    said = [f"{verdict.verdict}: {verdict_sentence(verdict, profile)}"]
    said += [f"  {line}" for line in value_lines(verdict)]
    said += drawn_lines(judgement)
    said += [f"note: {remark}" for remark in verdict.log_faults if verdict.verdict != "bad_log"]
    told = {each.sensor for each in verdict.missing} if verdict.gap is None else set()
    if lacking := {
        sensor: why for sensor, why in judgement.not_compared.items() if sensor not in told
    }:
        said.append(
            "not compared: " + "; ".join(f"{sensor} ({why})" for sensor, why in lacking.items())
        )
    if unseen := [name for name in profile.effects if name in verdict.untestable]:
        said.append(f"not tested, of the profile: {', '.join(unseen)}")
    if verdict.next_experiment is not None:
        said.append(
            f"next experiment: {verdict.next_experiment.name}, {verdict.next_experiment.why}"
        )
    return said + [f"next: {step}" for step in next_steps(judgement, directory)]
