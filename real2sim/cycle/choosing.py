"""Which of the trained models are taken: those with
which simulated robots of the found profile do best.

A further training gains where it trains and may lose elsewhere. The shipped models stay in the
running, and the robot itself is not asked: it is for the measurement. Whether the leg controller
makes up for the drives that were found is chosen, too: friction may have been what held a robot
with other faults upright. A trained policy knows no other way.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import combinations
from pathlib import Path

from saltus.config import from_table
from saltus.controller.compensation import KNOWN
from saltus.files import write_whole
from saltus.real2sim.cycle import trials
from saltus.real2sim.cycle.folder import MODELS, CycleFolder
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.real2sim.progress import ProgressListener
from saltus.used_networks import ModelKind

SEEDS_APART = 500_000
"""From the seeds of the measurement: no trial that chooses is one that measures."""


DRIVES = "drives"
"""In the name of a pair: its leg controller makes up for the drives that were found."""


LEFT = (
    "left as they are: simulated robots with the found profile do no better where "
    "they are made up for"
)


@dataclass(frozen=True, kw_only=True)
class PairTally:
    """Trials of one pair of models (heightmap and policy) on one course, counted."""

    successes: int = 0
    trials: int = 0


@dataclass(frozen=True, kw_only=True)
class ModelChoice:
    """How robots did with the trained models that a key names, and the other ones as shipped."""

    models: dict[str, str]
    """Name of each trained network by its kind."""
    tallies: dict[str, dict[str, PairTally]] = field(default_factory=dict)
    """By pairs of models ("heightmap+policy", "policy+drives", ..., "" for the shipped ones), and
    by course."""

    @property
    def best(self) -> tuple[str, ...]:
        """The names of the best pair: by its worst course,
        then by all, then by how much of it is new.
        """

        def worth(pair: str) -> tuple[float, float, int]:
            shares = [tally.successes / tally.trials for tally in self.tallies[pair].values()]
            return min(shares), sum(shares), len(pair)

        return tuple(max(self.tallies, key=worth).split("+"))

    @property
    def taken(self) -> tuple[ModelKind, ...]:
        """The trained models of the best pair."""
        return tuple(kind for kind in MODELS if kind in self.best)


def choose(folder: CycleFolder, settings: CycleSettings, tell: ProgressListener) -> ModelChoice:
    """Runs the trials that are still missing, and writes down what came of them."""
    trained = [kind for kind in MODELS if folder.model(kind) is not None]
    files = {kind: folder.model(kind) for kind in trained}
    names = trials.names_of(files, settings.loop.robot)
    known = read_choice(folder)
    choice = known if known is not None and known.models == names else ModelChoice(models=names)
    pairs = pairs_of(trained, with_drives=finds_drives(folder))
    done, total = 0.0, len(pairs) * len(trials.COURSES) * settings.choice_trials

    def ran(more: float) -> None:
        nonlocal done
        done += more
        tell("choose the models", done / total)

    for pair in pairs:
        row = choice.tallies.setdefault("+".join(pair), {})
        models = {kind: folder.model(kind) if kind in pair else None for kind in MODELS}
        for course in trials.COURSES:
            before = row.get(course, PairTally())
            ran(before.trials)
            if (count := settings.choice_trials - before.trials) > 0:
                seed = settings.seed + SEEDS_APART + before.trials
                knows = folder.profile if DRIVES in pair else folder.known
                robot = (settings.loop, folder.profile, str(knows))
                batches = trials.run_trials(
                    models, trials.trials_of(*robot, course, seed, count), ran
                )
                more = sum(not trial.failure for batch in batches for trial in batch.values())
                row[course] = PairTally(
                    successes=before.successes + more, trials=settings.choice_trials
                )
                write_whole(folder.choice, json.dumps(asdict(choice)), synced=True)
    return choice


def pairs_of(trained: Sequence[ModelKind], *, with_drives: bool) -> list[tuple[str, ...]]:
    """Pairs in the running, by names, most that is new first.

    A trained policy only with the drives it knows.
    """
    pairs: list[tuple[str, ...]] = []
    for size in range(len(trained), -1, -1):
        pairs += combinations(trained, size)
    if not with_drives:
        return pairs
    return [(*pair, DRIVES) for pair in pairs] + [pair for pair in pairs if "policy" not in pair]


def finds_drives(folder: CycleFolder) -> bool:
    """True where the search found something of the drives that a leg controller makes up for."""
    before, after = (folder.read(path).effects for path in (folder.known, folder.profile))
    return any(before.get(effect.name) != after.get(effect.name) for effect in KNOWN)


def read_choice(folder: CycleFolder) -> ModelChoice | None:
    """Reads what was tried so far; None where nothing was."""
    return (
        from_table(ModelChoice, json.loads(folder.choice.read_text(encoding="utf-8")))
        if folder.choice.exists()
        else None
    )


def taken_models(folder: CycleFolder) -> tuple[ModelKind, ...]:
    """Kinds of the trained models that are taken; before the choice all that there are."""
    choice = read_choice(folder)
    return MODELS if choice is None else choice.taken


def known_after(folder: CycleFolder) -> Path:
    """The profile that the leg controller knows after the search."""
    choice = read_choice(folder)
    return (
        folder.profile
        if choice is None or not finds_drives(folder) or DRIVES in choice.best
        else folder.known
    )


def choice_text(choice: ModelChoice, kind: ModelKind) -> str:
    """Returns what became of a trained model, in words."""
    if kind in choice.taken:
        return "taken"
    return (
        "not taken: simulated robots with the found profile do no better with it than "
        "with the shipped one"
    )
