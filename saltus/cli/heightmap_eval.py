"""`saltus heightmap eval`: what a predictor is worth in runs that no training saw."""

import sys
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from saltus.cli.heightmap_train import QUIET_S
from saltus.cli.output import JsonOption, table_lines
from saltus.cli.run_options import ModelOptions, RobotOption, mounted_camera
from saltus.flags import shown
from saltus.grid import DEFAULT_GRID
from saltus.models import model_id, model_path
from saltus.robots.loading import load_robot

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
class Eval(RobotOption, ModelOptions, JsonOption):
    """Measures a predictor in held-out runs, with policy and predictor in the loop, beside deprojection alone.

    For example:
      saltus heightmap eval --runs 20 --baselines
      saltus heightmap eval --heightmap-model runs/heightmap/heightmap.onnx --seed 5 --json
    """

    runs: int = 200
    """How many, in batches of 20: half of a batch on courses that both planners master, half on harder ones. The
    learned policy and the scripted planner drive a batch in turns."""
    seed: int = 0
    """Seed of courses, trials and cameras; whatever it is, no training draws the same."""
    terrains: tuple[str, ...] = ("flat", "stairs", "stepping_stones", "step", "gap")
    """Families of the courses, yours too; no files."""
    camera: str = "d435i"
    """ideal: true depth. d435i: a stereo camera, whose errors have another strength in each run. Or a TOML file."""
    baselines: tuple[str, ...] = ("geometric", "geometric-feet")
    """Predictors without training that are shown the same images: geometric, geometric-feet; none by --baselines
    alone."""
    time_limit_s: float = 10.0
    """Time limit of a run."""
    processes: Annotated[int | None, shown("INT", "one for each core")] = None
    """How many share the runs. The numbers do not depend on it."""

    def run(self) -> int:
        """Runs them all and prints how far robots went, and a table, in millimetres."""
        from tqdm import tqdm

        from saltus.heightmap.evaluation.held_out import HeldOutRun, HeldOutRuns
        from saltus.heightmap.evaluation.scores import scores
        from saltus.heightmap.evaluation.way import way_warning
        from saltus.heightmap.service.network import HeightmapNetwork
        from saltus.workers import in_order

        config = HeldOutRuns(
            robot=self.robot, grid=DEFAULT_GRID, runs=self.runs, seed=self.seed, terrains=self.terrains,
            camera=self.camera, policy=self.policy_model, baselines=self.baselines, time_limit_s=self.time_limit_s,
        )  # fmt: skip
        models = {"heightmap": model_path("heightmap", self.heightmap_model)}
        models["policy"] = model_path("policy", self.policy_model)
        HeightmapNetwork(mounted_camera(self.camera, load_robot(self.robot))[1], models["heightmap"])
        work = partial(config.measure, models["heightmap"])
        measured: list[HeldOutRun] = []
        total = len(config.batches) * config.work
        with tqdm(total=total, desc="eval", bar_format=BAR, delay=QUIET_S, file=sys.stderr) as bar:
            bar.set_postfix_str(f"0 of {self.runs} runs", refresh=False)
            for batch in in_order(work, config.batches, self.processes, bar.update):
                measured += batch
                bar.set_postfix_str(f"{len(measured)} of {self.runs} runs")
        table = scores(measured)
        warning = way_warning(table)
        _print_table(table, warning)
        self.tell_json(
            table
            | {"warning": warning}
            | {"models": {kind: model_id(path.read_bytes()) for kind, path in models.items()}}
        )
        return 0


def _print_table(table: dict[str, Any], warning: str) -> None:
    """A row for all runs, each level and terrain, and each baseline; errors in millimetres, ways in metres."""
    print(
        f"{table['runs']} robots went {table['distance_m']:.1f} m (median) and met {table['edges_met']:.1f} of "
        f"{table['edges']:.1f} edges; {100.0 * table['moved']:.0f} % met one, or went as far on flat ground"
    )
    if warning:
        print(f"WARNING: {warning}")
    groups = (*table["by_level"].items(), *table["by_terrain"].items())
    network = "network, hardly moved" if warning else "network"
    rows = [(network, table), *((f"  {name}", row) for name, row in groups)]
    for baseline, row in table["baselines"].items():
        rows += [(baseline, row), *((f"  {name}", part) for name, part in row["by_terrain"].items())]
    shown = [
        (name, {title: round(factor * row[key], 2) for title, key, factor in (*COLUMNS, *WAY)}) for name, row in rows
    ]
    print("error [mm]", *table_lines(shown), sep="\n")
