"""`saltus heightmap check`, `report` and `eval`:
whether heights can be trusted, and how wrong they are.
"""

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from saltus.cli.heightmap_train import QUIET_S
from saltus.cli.output import JsonOption, run_directory, table_lines
from saltus.cli.record import record_stack
from saltus.cli.run_options import ModelOptions, RobotOption, mounted_camera
from saltus.config import check_between
from saltus.errors import RecordingError, SaltusError
from saltus.flags import AT_LEAST_ONE, EndpointOption, flag_help
from saltus.grid import DEFAULT_GRID
from saltus.robots.loading import load_robot
from saltus.used_networks import model_id, model_path


@dataclass(frozen=True, kw_only=True)
class ReportHeightmap(JsonOption):
    """Measures the heightmaps of recorded runs and writes one HTML file.

    Example: saltus heightmap report runs/one/recording.mcap --model geometric
    runs/heightmap/heightmap.onnx
    """

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional, AT_LEAST_ONE]
    """Recorded runs (.mcap), whole or damaged, with ground truth or without."""
    model: Annotated[tuple[str, ...], flag_help("MODEL [MODEL ...]", "none")] = ()
    """To compare, on the same depth: paths of ONNX files, "geometric" (deprojection), or
    "geometric-feet" (the same, its map held to the feet that stand)."""
    out: Annotated[Path | None, flag_help("PATH", "a new one, runs/DATE-heightmap-report")] = None
    """Folder for report.html."""

    def run(self) -> int:
        """Writes report.html; prints what was lost and the errors of each predictor."""
        from saltus.errors import RecordingError, SaltusError
        from saltus.heightmap.evaluation.report import (
            centimetres_text,
            measure_errors,
            write_error_report,
        )
        from saltus.recordings.recording import read_recording

        if not self.recordings:
            raise RecordingError("no recording: name at least one .mcap file")
        if self.out is not None and self.out.suffix:
            raise SaltusError(f"--out {self.out}: name a folder; report.html is written into it")
        report = measure_errors([read_recording(path) for path in self.recordings], self.model)
        path = run_directory("heightmap-report", self.out) / "report.html"
        write_error_report(report, path)
        numbers = report.numbers()
        for run in numbers["runs"]:
            for item in run["lost"]:
                print(f"lost in {run['name']}: {item}")
        for reason in report.failed:
            print(f"not compared: {reason}")
        for name, row in numbers["predictors"].items():
            print(
                f"{name}: {centimetres_text(row['mae_m'])} cm, "
                f"edges {centimetres_text(row['edge_error_m'])} cm, "
                f"90 % intervals cover {100 * row['coverage90']:.0f} %"
            )
        print(f"report    {path}")
        self.tell_json(numbers)
        return 0


@dataclass(frozen=True, kw_only=True)
class Check(EndpointOption, JsonOption):
    """Says whether the heights of a robot can be trusted.

    It must stand on level ground with nothing ahead.

    Rates, delays, where the camera sits, and the heights themselves: ahead, the ground is as high
    as under the feet. Ends with 0 where all is good, with 1 where something is not.

    For example:
      saltus heightmap check --run-dir runs/mine
      saltus heightmap check runs/standing/recording.mcap
    """

    recording: Annotated[
        Path | None, tyro.conf.Positional, flag_help("PATH", "none: a running stack")
    ] = None
    """A recorded run (.mcap) in which the robot stands for a second or more."""
    run_dir: Annotated[Path | None, flag_help("PATH", "none: a recording")] = None
    """Folder of a running stack, with its run.toml."""
    seconds: float = 3.0
    """With --run-dir: how long to listen."""

    def run(self) -> int:
        """Prints a line for each thing that heights rest on,
        and a verdict; returns 1 if one is bad.
        """
        from tempfile import TemporaryDirectory

        check_between(self, seconds=(0.5, 600.0))
        if self.recording is not None and self.run_dir is None:
            return self._judge(self.recording)
        if self.recording is not None or self.run_dir is None:
            raise SaltusError(
                "heightmap check needs a recording, or --run-dir for a running stack, and not both"
            )
        with TemporaryDirectory() as folder:
            heard = Path(folder) / "recording.mcap"

            def begin() -> Path:
                print(f"listening for {self.seconds:g} s", flush=True)
                return heard

            record_stack(self.run_dir, self.endpoint, begin, self.seconds)
            try:
                return self._judge(heard)
            except RecordingError as error:  # the file that it names is about to vanish
                raise SaltusError(str(error).replace(str(heard), str(self.run_dir))) from error

    def _judge(self, path: Path) -> int:
        from saltus.heightmap.evaluation.trust_checks import check_standing
        from saltus.recordings.recording import read_recording

        findings = check_standing(read_recording(path))
        for finding in findings:
            print(
                f"{'good' if finding.good else 'BAD ':5} {finding.name:26} {finding.measured}; "
                f"wanted: {finding.wanted}"
            )
            if not finding.good:
                print(f"      {finding.cure}")
        bad = [finding.name for finding in findings if not finding.good]
        print(
            f"do not trust these heights: {', '.join(bad)}"
            if bad
            else "these heights can be trusted"
        )
        self.tell_json({"trusted": not bad, "findings": [vars(finding) for finding in findings]})
        return 1 if bad else 0


COLUMNS = (
    ("mean", "mae_m", 1e3),
    ("visible", "mae_visible_m", 1e3),
    ("remembered", "mae_remembered_m", 1e3),
    ("unseen", "mae_unseen_m", 1e3),
    ("edges", "edge_error_m", 1e3),
    ("found %", "edges_found", 1e2),
    ("covered %", "coverage90", 1e2),
    ("NLL", "nll", 1.0),
)
"""Columns of the table: title, key, and factor to what is printed."""
WAY = (("way [m]", "distance_m", 1.0), ("edges met", "edges_met", 1.0))
BAR = "{l_bar}{bar}| {elapsed}<{remaining}{postfix}"


@dataclass(frozen=True, kw_only=True)
class EvalHeightmap(RobotOption, ModelOptions, JsonOption):
    """Measures a predictor in held-out runs,
    with policy and predictor in the loop, beside deprojection alone.

    For example:
      saltus heightmap eval --runs 20 --baselines
      saltus heightmap eval --heightmap-model runs/heightmap/heightmap.onnx --seed 5 --json
    """

    runs: int = 200
    """How many, in batches of 20: half of a batch on courses that both planners master,
    half on harder ones. The learned policy and the scripted planner drive a batch in turns."""
    seed: int = 0
    """Seed of courses, trials and cameras; whatever it is, no training draws the same."""
    terrains: tuple[str, ...] = ("flat", "stairs", "stepping_stones", "step", "gap")
    """Families of the courses, yours too; no files."""
    camera: str = "d435i"
    """ideal: true depth. d435i: a stereo camera, whose errors have another strength in each run.

    Or a TOML file.
    """
    baselines: tuple[str, ...] = ("geometric", "geometric-feet")
    """Predictors without training that are shown the same images:
    geometric, geometric-feet; none by --baselines alone."""
    time_limit_s: float = 10.0
    """Time limit of a run."""
    processes: Annotated[int | None, flag_help("INT", "one for each core")] = None
    """How many share the runs. The numbers do not depend on it."""

    def run(self) -> int:
        """Simulates all `runs`; prints how far robots went, and a table in millimetres."""
        from tqdm import tqdm

        from saltus.heightmap.data.predicted import load_predictor
        from saltus.heightmap.evaluation.distance_travelled import way_warning
        from saltus.heightmap.evaluation.held_out import HeldOutRun, HeldOutRuns
        from saltus.heightmap.evaluation.scores import score_table
        from saltus.workers import in_order

        config = HeldOutRuns(
            robot=self.robot, grid=DEFAULT_GRID, runs=self.runs, seed=self.seed,
            terrains=self.terrains,
            camera=self.camera, policy=self.policy_model, baselines=self.baselines,
            time_limit_s=self.time_limit_s,
        )  # fmt: skip
        models = {"heightmap": model_path("heightmap", self.heightmap_model, self.robot)}
        models["policy"] = model_path("policy", self.policy_model, self.robot)
        load_predictor(models["heightmap"], mounted_camera(self.camera, load_robot(self.robot))[1])
        work = partial(config.measure, models["heightmap"])
        measured: list[HeldOutRun] = []
        total = len(config.batches) * config.work
        with tqdm(total=total, desc="eval", bar_format=BAR, delay=QUIET_S, file=sys.stderr) as bar:
            bar.set_postfix_str(f"0 of {self.runs} runs", refresh=False)
            for batch in in_order(work, config.batches, self.processes, bar.update):
                measured += batch
                bar.set_postfix_str(f"{len(measured)} of {self.runs} runs")
        table = score_table(measured)
        warning = way_warning(table)
        _print_table(table, warning)
        self.tell_json(
            table
            | {"warning": warning}
            | {"models": {kind: model_id(path.read_bytes()) for kind, path in models.items()}}
        )
        return 0


def _print_table(table: dict[str, Any], warning: str) -> None:
    """A row for all runs, each level and terrain, and each baseline.

    Errors in millimetres, ways in metres.
    """
    print(
        f"{table['runs']} robots went {table['distance_m']:.1f} m (median) and met "
        f"{table['edges_met']:.1f} of "
        f"{table['edges']:.1f} edges; {100.0 * table['moved']:.0f} % met one, or went as far on "
        "flat ground"
    )
    if warning:
        print(f"WARNING: {warning}")
    groups = (*table["by_level"].items(), *table["by_terrain"].items())
    network = "network, hardly moved" if warning else "network"
    rows = [(network, table), *((f"  {name}", row) for name, row in groups)]
    for baseline, row in table["baselines"].items():
        rows += [
            (baseline, row),
            *((f"  {name}", part) for name, part in row["by_terrain"].items()),
        ]
    shown = [
        (name, {title: round(factor * row[key], 2) for title, key, factor in (*COLUMNS, *WAY)})
        for name, row in rows
    ]
    print("error [mm]", *table_lines(shown), sep="\n")
