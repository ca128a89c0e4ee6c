"""`saltus policy`: evaluate the planner, search its numbers, run its process."""

import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tqdm import tqdm
from tyro.conf import subcommand

from saltus.cli.output import print_json
from saltus.cli.serve import serve
from saltus.config import TerrainConfig, to_toml

if TYPE_CHECKING:
    from policy.evaluate import EvaluationResult


@dataclass(frozen=True, kw_only=True)
class Eval:
    """Runs trials with fresh seeds on one terrain, all in one process group, without the bus."""

    course: tyro.conf.OmitArgPrefixes[TerrainConfig] = field(default_factory=TerrainConfig)
    trials: int = 20
    """Number of trials."""
    first_seed: int = 0
    """Seed of the first trial; the others follow."""
    heightmap: Literal["true", "true-exact"] = "true"
    """true: the terrain, shifted as the trial says. true-exact: the terrain as it is."""
    profile: str = "go1"
    """Effects of the hardware: ideal, go1, or a TOML file."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print the result as one JSON object on the last line."""

    def run(self) -> int:
        """Runs them; 0 where all succeeded, else 1."""
        from policy.evaluate import HEIGHTS, Evaluation, collect, evaluate

        evaluation = Evaluation(
            course=self.course, trials=self.trials, first_seed=self.first_seed, profile=self.profile
        )  # fmt: skip
        with tqdm(total=self.trials, unit="trial", file=sys.stderr) as bar:
            batches = []
            for batch in evaluate(evaluation, HEIGHTS[self.heightmap]):
                batches.append(batch)
                bar.update(len(batch))
        result = collect(iter(batches))
        _print_table(result)
        if self.json:
            print_json(_as_json(self, result))
        return 0 if result.successes == self.trials else 1


@dataclass(frozen=True, kw_only=True)
class Search:
    """Searches the numbers of the scripted planner in the batched plant; writes the best as TOML."""

    out: Path = Path("scripted.toml")
    """The file to write, after every generation."""
    generations: int = 100
    population: int = 14
    """Candidates of a generation; each runs every course."""
    seed: int = 0

    def run(self) -> int:
        """Searches to the end, or until it is interrupted."""
        from policy.scripted import ScriptedParameters
        from policy.search import SearchConfig, search

        config = SearchConfig(generations=self.generations, population=self.population, seed=self.seed)
        for generation in search(config, ScriptedParameters()):
            self.out.write_text(to_toml(generation.mean))
            print(
                f"{generation.index + 1}/{self.generations}: score {generation.mean_score:.3f}, "
                f"best {generation.best_score:.3f}, success {generation.success:.0%}",
                file=sys.stderr,
                flush=True,
            )
        print(self.out)
        return 0


@dataclass(frozen=True, kw_only=True)
class Serve:
    """Runs the planner process against a running stack."""

    endpoint: str
    """Zenoh router, e.g. tcp/127.0.0.1:7447."""
    run_dir: Path
    """Folder with the run's run.toml."""

    def run(self) -> int:
        """Runs until it is told to stop."""
        return serve("policy", self.run_dir, self.endpoint)


@dataclass(frozen=True, kw_only=True)
class Policy:
    """The motion planner: eval, search, serve."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[Eval, subcommand("eval")]
            | Annotated[Search, subcommand("search")]
            | Annotated[Serve, subcommand("serve")]
        ]
    ]

    def run(self) -> int:
        """Runs the chosen command."""
        return self.command.run()


def _print_table(result: "EvaluationResult") -> None:
    print(f"{'seed':>8}  {'result':<14} {'time':>7} {'distance':>9} {'speed':>9}")
    for seed, outcome in zip(result.seeds, result.outcomes, strict=True):
        how = outcome.cause or "success"
        speed = f"{outcome.mean_speed_mps:5.2f} m/s"
        print(f"{seed:>8}  {how:<14} {outcome.time_s:5.2f} s {outcome.distance_m:7.2f} m {speed:>9}")
    causes = ", ".join(f"{count} {cause}" for cause, count in sorted(result.causes.items()))
    print(
        f"{result.successes} of {len(result.outcomes)} succeeded, {result.mean_speed_mps:.2f} m/s, "
        f"{result.mean_time_s:.2f} s{'; failed: ' + causes if causes else ''}"
    )


def _as_json(command: Eval, result: "EvaluationResult") -> dict[str, object]:
    return {
        "terrain": asdict(command.course),
        "heightmap": command.heightmap,
        "profile": command.profile,
        "trials": len(result.outcomes),
        "first_seed": command.first_seed,
        "success": result.successes,
        "mean_speed_mps": result.mean_speed_mps,
        "mean_time_s": result.mean_time_s,
        "causes": result.causes,
        "outcomes": [asdict(outcome) for outcome in result.outcomes],
    }
