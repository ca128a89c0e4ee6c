"""A judgement as `saltus real2sim find` prints it; the report says the same."""

from pathlib import Path

from saltus.real2sim.reporting.draws import drawn_lines
from saltus.real2sim.reporting.steps import next_steps
from saltus.real2sim.reporting.words import sentence, value_lines
from saltus.real2sim.results import Judgement


def lines(judgement: Judgement, directory: Path) -> list[str]:
    """The verdict's word, values with intervals, what is doubtful, and what comes next.

    `directory` holds the patch.
    """
    verdict, profile = judgement.verdict, judgement.profile
    said = [f"{verdict.verdict}: {sentence(verdict, profile)}"]
    said += [f"  {line}" for line in value_lines(verdict)]
    said += drawn_lines(judgement)
    said += [f"note: {remark}" for remark in verdict.log_faults if verdict.verdict != "bad_log"]
    told = {each.sensor for each in verdict.missing} if verdict.gap is None else set()
    if lacking := {sensor: why for sensor, why in judgement.not_compared.items() if sensor not in told}:
        said.append("not compared: " + "; ".join(f"{sensor} ({why})" for sensor, why in lacking.items()))
    if unseen := [name for name in profile.effects if name in verdict.untestable]:
        said.append(f"not tested, of the profile: {', '.join(unseen)}")
    if verdict.next_experiment is not None:
        said.append(f"next experiment: {verdict.next_experiment.name}, {verdict.next_experiment.why}")
    return said + [f"next: {step}" for step in next_steps(judgement, directory)]
