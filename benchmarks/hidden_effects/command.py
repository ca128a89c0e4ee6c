"""Does real2sim find, name and measure effects that are hidden in run logs? Generate,
identify, follow up, score.

Each part goes on where it was stopped. It shares no code with what it measures.

    saltus bench hidden_effects -- generate --seed 1 --out LOGS --truth TRUTH
    saltus bench hidden_effects -- identify LOGS --out VERDICTS
    saltus bench hidden_effects -- score VERDICTS TRUTH
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional, subcommand

from benchmarks.hidden_effects import cases, confusion, followup, identify, score
from benchmarks.hidden_effects.generate import generate
from benchmarks.hidden_effects.plan import KINDS, Kind, make_plan
from benchmarks.hidden_effects.plan import Part as PlanPart


@dataclass(frozen=True, kw_only=True)
class Part:
    """Flags of all parts; each has a method `measure`, which does the part and returns figures."""

    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print the figures as one JSON object on the last line."""


@dataclass(frozen=True, kw_only=True)
class Generate(Part):
    """Writes logs, and the truth about them elsewhere."""

    seed: int
    """Seed of all runs."""
    runs: int = 200
    """How many."""
    out: Path
    """Folder of the logs."""
    truth: Path
    """A folder that the identifier does not read."""
    jobs: int = 2
    """Processes."""
    kinds: tuple[Kind, ...] = tuple(KINDS)
    """Kinds of logs."""
    only: PlanPart = "all"
    """Runs of joints alone that tell pairs and play."""
    tuning: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Other motions and colours of noise, to tune methods on."""

    def measure(self) -> dict[str, Any]:
        runs = make_plan(self.seed, self.runs, self.kinds, tuning=self.tuning, part=self.only)
        generate(runs, self.out, self.truth, tuning=self.tuning, jobs=self.jobs)
        return {"runs": len(runs), "logs": str(self.out), "truth": str(self.truth)}


@dataclass(frozen=True, kw_only=True)
class Identify(Part):
    """Lets real2sim look at every log, and seals its verdicts."""

    logs: Positional[Path]
    """Folder of logs."""
    out: Path
    """Folder of the verdicts."""
    jobs: int = 2
    """Processes."""
    second: Annotated[Path | None, tyro.conf.arg(name="with")] = None
    """Second logs of some of the robots: both are read as one."""

    def measure(self) -> dict[str, Any]:
        count = identify.identify(self.logs, self.out, identify.command, self.jobs, self.second)
        return {"verdicts": count, "folder": str(self.out)}


@dataclass(frozen=True, kw_only=True)
class _Judged(Part):
    verdicts: Positional[Path]
    """Folder of sealed verdicts."""
    truth: Positional[Path]
    """Folder of what is true."""


@dataclass(frozen=True, kw_only=True)
class FollowUp(_Judged):
    """Has robots do what was proposed for them; opens the truth."""

    out: Path
    """Folder of the second logs."""

    def measure(self) -> dict[str, Any]:
        count = followup.followup(cases.read_cases(self.verdicts, self.truth), self.out)
        return {"logs": count, "folder": str(self.out)}


@dataclass(frozen=True, kw_only=True)
class Score(_Judged):
    """Compares sealed verdicts with the truth.

    Writes score.json and the confusion matrix beside the verdicts.
    """

    followup: Path | None = None
    """Verdicts on robots that did what was proposed."""

    def measure(self) -> dict[str, Any]:
        marked = cases.read_cases(self.verdicts, self.truth)
        again = None if self.followup is None else cases.read_cases(self.followup, self.truth)
        table = score.table(marked, again)
        (self.verdicts / "score.json").write_text(json.dumps(table, indent=1), encoding="utf-8")
        confusion.write_confusion(marked, self.verdicts)
        return table


Benchmark = (
    Annotated[Generate, subcommand("generate")]
    | Annotated[Identify, subcommand("identify")]
    | Annotated[FollowUp, subcommand("followup")]
    | Annotated[Score, subcommand("score")]
)
