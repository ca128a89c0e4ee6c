"""A Go2 by an MJCF of somebody else in place of ours: the policies that are shipped for the Go2
jump up its stairs and walk over its grounds.

The file is the user's: unitree_robots/go2/go2.xml of unitreerobotics/unitree_mujoco,
unitree_go2/go2.xml of MuJoCo Menagerie, or another, with the meshes that it names. Its are masses,
inertias, lengths, limits and armature, damping and dry friction of its joints, softness and turning
friction of its feet. Ours are the box of the trunk, rods for the links (`saltus robot show FILE`),
the motors' torque over speed, the camera, and what each trial draws, sliding friction too.

    saltus bench users_go2 -- --mjcf unitree_mujoco/unitree_robots/go2/go2.xml --trials 100
"""

import json
import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from benchmarks._command import Command
from saltus.config import JUMPING_CAMERA, WALKING_CAMERA, TerrainConfig
from saltus.effects.body import ContactCompliance, SoftFeet
from saltus.effects.joint_loads import CoulombFriction, ViscousFriction
from saltus.effects.profile import SHIPPED, load_profile
from saltus.errors import ConfigError
from saltus.flags import flag_help
from saltus.grid import DEFAULT_GRID, WALKING_GRID
from saltus.heightmap.data.predicted import PredictedHeightsFactory
from saltus.heightmap.data.scan_heights import ScanHeightSourceFactory
from saltus.loop.heights import shifted_heights
from saltus.policy.evaluation.evaluate import EvaluationSettings, evaluate_policy, merge_batches
from saltus.policy.evaluation.walking_trials import WalkTrials, crossing_row, run_tasks, trial_tasks
from saltus.policy.evaluation.walks import TrueHeightSource
from saltus.policy.planner import make_planner
from saltus.robots.loading import load_robot
from saltus.robots.shipped import PROFILE_FILE, SUPPLEMENT_FILE, shipped_folder
from saltus.robots.structure import read_structure
from saltus.used_networks import model_path, walking_path

ROBOT = "go2"
STAIRS = TerrainConfig(terrain="stairs", rise_m=0.20)


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    mjcf: Path
    """The model, an MJCF file."""
    jumps: bool = True
    """Up 14 stairs of 0.20 m."""
    grounds: tuple[str, ...] = ("plain", "rubble", "stairs")
    """Grounds to walk over, see `saltus policy walk trials`; none by --grounds alone."""
    heights: Literal["true", "predicted"] = "predicted"
    """predicted: a network makes them of the D435i's images. true: the terrain as it is."""
    trials: int = 20
    """Trials of each row."""
    seed: int = 94_000
    """Seed of the first trial; the others have SEED + 1, SEED + 2, ..."""
    processes: Annotated[int | None, flag_help("INT", "one for each core")] = None
    """Number of processes that share the trials."""

    def measure(self) -> dict[str, Any]:
        """Successes and causes of failure in each row."""
        if not self.mjcf.is_file():
            raise ConfigError(f"there is no model '{self.mjcf}': --mjcf is a Go2's MJCF file")
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            write_robot(self.mjcf, folder)
            rows = {"jumps, stairs 0.20": self._jumps(folder)} if self.jumps else {}
            rows |= {f"walks, {ground}": self._walks(folder, ground) for ground in self.grounds}
        return {
            "model": str(self.mjcf), "heights": self.heights, "trials": self.trials,
            "seed": self.seed, "rows": rows,
        }  # fmt: skip

    def _jumps(self, folder: Path) -> dict[str, Any]:
        evaluation = EvaluationSettings(
            robot=str(folder), grid=DEFAULT_GRID, camera=JUMPING_CAMERA, course=STAIRS,
            profile=str(folder / PROFILE_FILE), trials=self.trials, seed=self.seed,
        )  # fmt: skip
        predicted = PredictedHeightsFactory(model=model_path("heightmap", robot=ROBOT))
        heights = predicted if self.heights == "predicted" else shifted_heights
        planner = partial(make_planner, "learned")
        found = merge_batches(evaluate_policy(evaluation, heights, planner, self.processes))
        return {"successes": found.successes, "failures": found.failures,
                "median_time_s": found.median_time_s}  # fmt: skip

    def _walks(self, folder: Path, ground: str) -> dict[str, Any]:
        trials = WalkTrials(
            robot=str(folder), grid=WALKING_GRID, model=walking_path(ROBOT), camera=WALKING_CAMERA,
            profile=str(folder / PROFILE_FILE),
        )  # fmt: skip
        predicted = ScanHeightSourceFactory(model=model_path("scan"))
        source = predicted if self.heights == "predicted" else TrueHeightSource
        seeds = range(self.seed, self.seed + self.trials)
        parts = run_tasks(trials, trial_tasks("cross", [ground], source, seeds), self.processes)
        row = crossing_row([each for part in parts for each in part])  # type: ignore[misc]
        return {key: row[key] for key in ("successes", "failures", "speed_by_commanded")}


def write_robot(mjcf: Path, folder: Path) -> None:
    """Writes robot.toml and profile.toml of a Go2 with another model.

    Raises:
        ModelError: the model cannot be read, or its legs are not of our kind.
    """
    (folder / SUPPLEMENT_FILE).write_text(_supplement(mjcf), encoding="utf-8")
    profile = load_profile(SHIPPED, load_robot(ROBOT)).having(*passive(mjcf))
    (folder / PROFILE_FILE).write_text(profile.to_toml(), encoding="utf-8")


def passive(
    mjcf: Path,
) -> tuple[CoulombFriction, ViscousFriction, ContactCompliance, SoftFeet]:
    """Effects of a model's joints and feet, in place of those of a profile."""
    structure = read_structure(str(mjcf))
    model = structure.model
    dofs = model.jnt_dofadr[[joint for leg in structure.legs for joint in leg.joint]]
    foot = structure.legs[0].foot
    turns = model.geom_condim[foot] > 3  # contacts of three dimensions only slide
    _, torsion, rolling = model.geom_friction[foot] * (1.0, turns, turns)
    touch, _, depth = model.geom_solimp[foot][:3]
    return (
        CoulombFriction(torque=tuple(model.dof_frictionloss[dofs].tolist())),
        ViscousFriction(coefficient=tuple(model.dof_damping[dofs].tolist())),
        ContactCompliance(time_constant=float(model.geom_solref[foot][0])),
        SoftFeet(
            torsion=float(torsion), rolling=float(rolling), touch=float(touch), depth=float(depth)
        ),
    )


def _supplement(mjcf: Path) -> str:
    """Our robot.toml with another model and the trunk's box as we have it, without its head."""
    ours = load_robot(ROBOT)
    box = {"trunk_size": ours.trunk_size, "trunk_center": ours.trunk_center}
    own = [f"{name} = {value.tolist()}" for name, value in box.items()]
    lines = (shipped_folder(ROBOT) / SUPPLEMENT_FILE).read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if not line.startswith("mjcf")]
    # a TOML string is a JSON string; keys come before the first table
    return "\n".join([f"mjcf = {json.dumps(str(mjcf.resolve()))}", *own, *kept, ""])
