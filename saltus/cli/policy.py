"""`saltus policy`: train, export and evaluate planners, run the process."""

import sys
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from saltus.cli.output import JsonOption, run_directory, table_lines
from saltus.cli.policy_train import TrainPolicy
from saltus.cli.policy_walk import WalkTrialsCommand
from saltus.cli.run_options import (
    CourseOptions,
    HardwareOptions,
    ModelOptions,
    RobotOption,
    SizedCourse,
    mounted_camera,
)
from saltus.cli.serve import ServeProcess
from saltus.config import PlannerName
from saltus.errors import ConfigError, SaltusError
from saltus.extras import packages_of
from saltus.flags import CommandGroup, Subcommands, flag_help
from saltus.folders import new_folder
from saltus.grid import DEFAULT_GRID, load_grid
from saltus.policy.walking import command
from saltus.policy.walking.settings import WalkTrainSettings
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.used_networks import model_id, model_path
from saltus.workers import check_processes

BAR = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
MAX_DIFFERENCE = 1e-5  # of an action's range, between torch and the exported file

if TYPE_CHECKING:
    from saltus.loop.heights import HeightsFactory
    from saltus.policy.evaluation.evaluate import EvaluationResult


@dataclass(frozen=True, kw_only=True)
class EvalPolicy(ModelOptions, HardwareOptions, RobotOption, JsonOption):
    """Runs trials on one terrain, many robots at once, without the bus; leaves a report.

    Example: saltus policy eval --terrain stairs --rise-m 0.2 --trials 100 --seed 92000
    """

    course: CourseOptions = field(default_factory=SizedCourse)
    planner: PlannerName = "learned"
    """scripted: rules that read the heightmap. learned: a network."""
    trials: int = 20
    """Number of trials."""
    seed: int = 0
    """Seed of the first trial; the others have SEED + 1, SEED + 2, ..."""
    heightmap: Literal["true", "true-exact", "predicted"] = "true"
    """true: the terrain, shifted by up to 8 cm ahead and 5 cm up as the trial says. true-exact: the
    terrain as it is. predicted: what the heightmap service makes of late depth images
    (--heightmap-model)."""
    camera: str = "d435i"
    """With --heightmap predicted. d435i: with the errors of a stereo camera. ideal: true depth.

    Or a TOML file.
    """
    friction: Annotated[float | None, flag_help("FLOAT", "drawn by each trial from 0.5 to 1")] = (
        None
    )
    """Friction of the ground in all trials."""
    push_ns: float = 0.0
    """Impulse of one push from the side in each trial, for 0.1 s at a place of the course that its
    seed draws [Ns]."""
    plan_delay_s: float = 0.0
    """From a state to its plan being obeyed, in steps of 2 ms: what the computer of a real robot
    takes."""
    processes: Annotated[int | None, flag_help("INT", "one for each core")] = None
    """How many run at once."""
    report: bool = True
    """Write an HTML report."""
    out: Annotated[Path | None, flag_help("PATH", "a new one, runs/DATE-policy-eval")] = None
    """Folder for the report."""

    def run(self) -> int:
        """Runs them; 0 where all succeeded, else 1."""
        from tqdm import tqdm

        from saltus.effects.heightmap_shift import refuse_shift
        from saltus.policy.evaluation.evaluate import (
            EvaluationSettings,
            evaluate_policy,
            merge_batches,
        )
        from saltus.policy.planner import make_planner

        planner = partial(make_planner, self.planner, model=self.policy_model)
        robot = load_robot(self.robot)
        planner(robot, load_grid(DEFAULT_GRID))  # what is wrong with a model is said at once
        evaluation = EvaluationSettings(
            robot=self.robot,
            grid=DEFAULT_GRID,
            camera=self.camera,
            course=self.course,
            trials=self.trials,
            seed=self.seed,
            profile=self.profile,
            known=self.known,
            friction=self.friction,
            push_ns=self.push_ns,
            plan_delay_s=self.plan_delay_s,
        )
        check_processes(self.processes)
        if self.heightmap != "true":
            (first,) = evaluation.setups([self.seed])
            refuse_shift(first.profile.heightmap, f"--heightmap {self.heightmap}")
        heights = self._heights()
        directory = run_directory("policy-eval", self.out) if self.report else None
        with tqdm(total=self.trials, desc="eval", bar_format=BAR, file=sys.stderr) as bar:
            result = merge_batches(
                evaluate_policy(evaluation, heights, planner, self.processes, bar.update)
            )
        table = _as_table(self, result)
        _print_table(result, str(table["timed"]))
        if directory is not None:
            from saltus.policy.evaluation.report import write_evaluation_report

            path = directory / "report.html"
            write_evaluation_report(evaluation, result, table, path)
            print(f"report    {path}")
        self.tell_json(table)
        return 0 if result.successes == self.trials else 1

    def _heights(self) -> "HeightsFactory":
        """The source of heights.

        The one that predicts lies above the planner, so it is handed down from here.
        """
        if self.heightmap == "predicted":
            from saltus.heightmap.data.predicted import PredictedHeightsFactory, load_predictor

            _, robot = mounted_camera(self.camera, load_robot(self.robot))
            load_predictor(model_path("heightmap", self.heightmap_model, robot.name), robot)
            return PredictedHeightsFactory(model=self.heightmap_model)
        if self.heightmap_model is not None:
            raise ConfigError(
                f"heightmap_model = {self.heightmap_model}: --heightmap {self.heightmap} has no "
                "use for it; "
                "add --heightmap predicted"
            )
        from saltus.policy.evaluation.evaluate import HEIGHTS

        return HEIGHTS[self.heightmap]


@dataclass(frozen=True, kw_only=True)
class ExportPolicy:
    """Exports a checkpoint to the ONNX file that the planner runs.

    Example: saltus policy export --checkpoint runs/DATE-policy-train/checkpoint.pt
    """

    checkpoint: Path
    """The checkpoint.pt of a training."""
    out: Annotated[Path | None, flag_help("PATH", "a new one, runs/DATE-policy-export")] = None
    """Folder for policy.onnx and its checksum."""

    def run(self) -> int:
        """Writes the file; 0 where it equals the checkpoint's network, else 1."""
        with packages_of("train", "exporting"):
            from saltus.policy.training.export import export_policy
        folder = self.out or new_folder("policy-export")
        if folder.suffix == ".onnx":
            raise SaltusError(f"--out {folder}: name a folder; policy.onnx is written into it")
        model = folder / "policy.onnx"
        difference = export_policy(self.checkpoint, model)
        print(f"{model}: differs from torch by at most {difference:.1e} of an action's range")
        return 0 if difference <= MAX_DIFFERENCE else 1


@dataclass(frozen=True, kw_only=True)
class ServePlanner(ServeProcess):
    """Runs the planner process against a running stack.

    Example: saltus policy serve --run-dir runs/one
    """

    module = "saltus.policy"


@dataclass(frozen=True, kw_only=True)
class TrainWalk(command.TrainWalkCommand):  # noqa: D101 - that of the training below
    __doc__ = command.TrainWalkCommand.__doc__

    training: Annotated[WalkTrainSettings, tyro.conf.arg(name="")] = field(
        default_factory=lambda: WalkTrainSettings(robot=DEFAULT_ROBOT)
    )


@dataclass(frozen=True, kw_only=True)
class WalkCommands(CommandGroup):
    """Policies that walk on velocity commands: train, export, eval, trials."""

    command: Subcommands[
        Annotated[TrainWalk, tyro.conf.subcommand("train")]
        | Annotated[command.ExportWalk, tyro.conf.subcommand("export")]
        | Annotated[command.EvalWalk, tyro.conf.subcommand("eval")]
        | Annotated[WalkTrialsCommand, tyro.conf.subcommand("trials")]
    ]


@dataclass(frozen=True, kw_only=True)
class PolicyCommands(CommandGroup):
    """The motion planner: train, export, eval, serve; and walking."""

    command: Subcommands[
        Annotated[TrainPolicy, tyro.conf.subcommand("train")]
        | Annotated[ExportPolicy, tyro.conf.subcommand("export")]
        | Annotated[EvalPolicy, tyro.conf.subcommand("eval")]
        | Annotated[ServePlanner, tyro.conf.subcommand("serve")]
        | Annotated[WalkCommands, tyro.conf.subcommand("walk")]
    ]


def _print_table(result: "EvaluationResult", start: str) -> None:
    rows = []
    for seed, trial in zip(result.seeds, result.trials, strict=True):
        outcome = trial.outcome
        timed = {"time [s]": outcome.time_s, "speed [m/s]": outcome.mean_speed_mps}
        cells = {
            "result": trial.failure or "success",
            "from the start [m]": outcome.distance_m,
            **timed,
        }
        rows.append((f"seed {seed}", cells))
    print(*table_lines(rows), sep="\n")
    failures = ", ".join(f"{count} {cause}" for cause, count in sorted(result.failures.items()))
    speed = (
        f": {result.median_time_s:.2f} s at {result.mean_speed_mps:.2f} m/s {start}"
        if result.successes
        else ""
    )
    low, high = result.success_interval
    share = f"{result.successes} of {len(result.trials)} succeeded ({100 * low:.0f} to {100 * high:.0f} %)"
    print(f"{share}{speed}{'; failed: ' + failures if failures else ''}")


def _models(command: EvalPolicy) -> dict[str, str]:
    """Names of the networks that take part, by their kind."""
    paths = (
        {"policy": model_path("policy", command.policy_model, command.robot)}
        if command.planner == "learned"
        else {}
    )
    if command.heightmap == "predicted":
        paths["heightmap"] = model_path("heightmap", command.heightmap_model, command.robot)
    return {kind: model_id(path.read_bytes()) for kind, path in paths.items()}


def _as_table(command: EvalPolicy, result: "EvaluationResult") -> dict[str, object]:
    from saltus.terrain.curriculum import make_terrain

    terrain = make_terrain(command.course)
    return {
        "terrain": terrain.kind,
        "params": dict(terrain.params),
        "timed": terrain.timed,
        "planner": command.planner,
        "heightmap": command.heightmap,
        "camera": command.camera if command.heightmap == "predicted" else None,
        "models": _models(command),
        "profile": command.profile,
        "known": command.known,
        "friction": command.friction,
        "push_ns": command.push_ns,
        "plan_delay_s": command.plan_delay_s,
        "trials": len(result.trials),
        "seed": command.seed,
        "success_rate": result.successes / len(result.trials),
        "success_interval95": list(result.success_interval),
        "mean_speed_mps": result.mean_speed_mps,
        "time_s": {"p50": result.median_time_s},
        "failures": result.failures,
        "outcomes": [asdict(outcome) for outcome in result.outcomes],
    }
