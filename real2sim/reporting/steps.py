"""Commands that come after a verdict: apply what was found, or make the motion that tells."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from saltus.effects.profile import IDEAL, SHIPPED, load_profile
from saltus.real2sim.patch import PATCH_FILE
from saltus.real2sim.problem.log import model_of
from saltus.real2sim.reporting.draws import is_drawn
from saltus.real2sim.results import Judgement
from saltus.robots.robot import Robot
from saltus.robots.shipped import robot_named

HELD = "joint_tour"
"""Shows all that a held robot's drives can show."""


class Step(NamedTuple):
    """A command and what it is for."""

    command: str
    why: str

    def __str__(self) -> str:
        return f"{self.command}  ({self.why})"


def next_steps(judgement: Judgement, directory: Path = Path()) -> list[Step]:
    """Commands in the order of their worth; `directory` is where the patch lies.

    None where the log contradicts itself, or agrees with the simulator and shows enough.
    """
    verdict = judgement.verdict
    metas = [each.log.meta for each in judgement.examinations]
    if verdict.verdict == "bad_log":
        return []
    steps = []
    if any(not is_drawn(effect, metas) for effect in judgement.patch.effects):
        patch = shlex.quote(str(directory / PATCH_FILE))
        command = f"saltus real2sim apply {patch} --profile mine{_base(judgement)}"
        steps.append(Step(command, "puts what is named into a profile"))
    proposed = [] if verdict.next_experiment is None else [verdict.next_experiment.name]
    whys = dict.fromkeys(proposed, "and give find both logs")
    for missing in verdict.missing:
        whys.setdefault(missing.experiment, f"long enough for the {missing.sensor}")
    if verdict.verdict in ("set", "unexplained") and _is_on_the_ground(metas):
        whys.setdefault(HELD, "hang it up: a robot in the air shows its drives without the ground")
    elif verdict.verdict == "unexplained" and not any(_is_of(meta, HELD) for meta in metas):
        whys.setdefault(HELD, "all that a held robot's drives can show, each motion twice")
    return steps + [Step(_command(name, metas), why) for name, why in whys.items()]


def _base(judgement: Judgement) -> str:
    """The flag that begins a new profile with the one of the comparison."""
    if judgement.profile == IDEAL:
        return ""
    model = model_of(judgement.examinations[0].log.meta)
    is_shipped = isinstance(model, Robot) and judgement.profile == load_profile(SHIPPED, model)
    return f" --base {SHIPPED if is_shipped else 'PROFILE'}"


def _is_of(meta: dict[str, Any], experiment: str) -> bool:
    """Says if a log claims to be of an experiment, as `saltus real2sim experiments` writes it."""
    excitation = meta.get("excitation")
    return isinstance(excitation, dict) and str(excitation.get("text", "")).startswith(f"{experiment}:")


def _is_on_the_ground(metas: Sequence[dict[str, Any]]) -> bool:
    return all(meta.get("base") != "fixed" for meta in metas)


def _command(experiment: str, metas: Sequence[dict[str, Any]]) -> str:
    robot = robot_named(metas[0])
    own = "" if robot == robot_named({}) else f" --robot {shlex.quote(robot)}"
    return f"saltus real2sim experiments --run {experiment}{own} --out logs/{experiment}"
