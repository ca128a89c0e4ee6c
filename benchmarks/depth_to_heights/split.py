"""The fixed split of the benchmark: which runs, and how they are made.

A split follows from this code alone, and is made rather than downloaded. Robots go by true heights,
shifted as each trial says, so that no predictor has a part in how they move, and all are judged on
the same images.
"""

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Singles
from saltus.config import PlannerName, TerrainConfig
from saltus.effects.camera import drawn_around
from saltus.effects.profile import SHIPPED
from saltus.errors import ConfigError
from saltus.grid import LINE
from saltus.heightmap.data.arriving_images import LateImages
from saltus.heightmap.data.delivery import TICK_S, TRAINING
from saltus.heightmap.data.export_columns import NO_IMAGE_S
from saltus.heightmap.data.robot_cameras import robot_cameras
from saltus.heightmap.evaluation.held_out import held_out_course
from saltus.heightmap.evaluation.visibility import visibility
from saltus.heightmap.service.proprioception_vector import proprioception_of_states
from saltus.loop.heights import true_heights
from saltus.loop.loop import Loop
from saltus.named_setup import named_setups
from saltus.policy.planner import make_planner
from saltus.render.eyes import Eyes
from saltus.render.randomisation import STRENGTH, of_strength
from saltus.render.stereo.camera import StereoConfig
from saltus.robots.legs import LegKinematics
from saltus.robots.mount import Mount
from saltus.robots.robot import Robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.setup import Setup
from saltus.states import ProprioceptionArrays
from saltus.terrain.curriculum import FAMILIES, make_terrain
from saltus.trial import Trial
from saltus.used_networks import model_id, model_path
from saltus.workers import tell_progress

VERSION = 2
"""Version of the split. Whoever changes what a definition says makes another: rows of two versions
are not compared."""
# In a batch: each family twice, those of the paper once of a size that all planners master
ROBOTS = 2 * len(FAMILIES)
RUNS = 4 * ROBOTS
"""In the whole split: two batches behind each planner."""
FIRST_SEED = 4_250_000_000
"""First seed of trials: above those of `saltus heightmap eval`, below those that training data are
drawn from (2**32)."""
TIME_LIMIT_S = (
    10.0  # as of `saltus heightmap eval`: at 1.2 m/s any course is behind a robot that still runs
)
CAMERA = "d435i"
PLANNERS: tuple[PlannerName, ...] = ("learned", "scripted")
OBSERVED = (
    "quaternion_base_in_world", "angular_velocity_base", "acceleration_base", "joint_position",
    "joint_velocity",
    "velocity_base_in_world", "base_height", "leg_contact", "leg_trusted",
)  # fmt: skip
"""Fields of `saltus.states.ProprioceptionArrays` that predictors are given."""
_DIGITS = 9  # of definitions: compilers may round the last bits of a draw in other ways


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """Values that differ from run to run."""

    terrain: TerrainConfig
    level: str
    """See `saltus.heightmap.evaluation.held_out`."""
    planner: PlannerName
    seed: int
    """Seed of the trial, and of the noise of its camera."""
    strength: float
    """Factor on the errors of a usual camera."""
    loss: float
    """Share of the images that never arrive."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Inputs:
    """Inputs of a predictor in one run, at each step of 10 ms from 0 on."""

    proprioception: Singles
    """See `saltus.heightmap.service.proprioception_vector`, shape (n, 21)."""
    depth: NDArray[np.uint16]
    """The newest image that has arrived [mm], shape (n, 48, 16); 0 is invalid, 65535 nothing within
    range."""
    depth_age_s: Singles
    """Time since it was taken, -1 before the first, shape (n,)."""
    robot: dict[str, Any]
    """Each of `OBSERVED`, shape (n, ...)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """Truth by which predictions of one run are judged, n steps."""

    terrain: str
    height: Singles
    """[m], shape (n, 30)."""
    view: NDArray[np.int8]
    """See `saltus.heightmap.evaluation.visibility`, shape (n, 30)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SplitRun:
    """One run, from its start to its end, however it ends."""

    inputs: Inputs
    truth: Truth


def plans(runs: int = RUNS) -> list[RunPlan]:
    """The first runs of the split.

    Raises:
        ConfigError: it has not so many.
    """
    if not 1 <= runs <= RUNS:
        raise ConfigError(f"runs = {runs}: it must be from 1 to {RUNS}")
    return [plan for number in range(math.ceil(runs / ROBOTS)) for plan in _batch(number)][:runs]


def definition(plans: Sequence[RunPlan]) -> str:
    """A digest of what is drawn for runs and of what drives them; the same on every computer."""
    policy = model_id(model_path("policy").read_bytes())
    table = {"version": VERSION, "camera": CAMERA, "policy": policy, "time_limit_s": TIME_LIMIT_S}
    runs = [asdict(plan) | {"trial": asdict(Trial.draw(plan.seed))} for plan in plans]
    return _digest(json.dumps(_rounded(table | {"runs": runs}), sort_keys=True).encode())


def truth_digest(truths: Sequence[Truth]) -> str:
    """A digest of the true heights of runs, in whole millimetres."""
    heights = (np.rint(1e3 * truth.height.astype(np.float64)).astype("<i4") for truth in truths)
    return _digest(b"".join(height.tobytes() for height in heights))


def batches(plans: Sequence[RunPlan]) -> list[Sequence[RunPlan]]:
    """Runs that are made together."""
    return [plans[first : first + ROBOTS] for first in range(0, len(plans), ROBOTS)]


WORK = math.ceil(TIME_LIMIT_S / TICK_S) + 2
"""Count that `make_batch` tells, see `saltus.workers.tell_progress`: its steps."""


def make_batch(batch: Sequence[RunPlan]) -> list[SplitRun]:
    """Runs one of `batches`."""
    terrains, trials = (
        [make_terrain(plan.terrain) for plan in batch],
        [Trial.draw(plan.seed) for plan in batch],
    )
    setups = named_setups(DEFAULT_ROBOT, LINE, CAMERA, SHIPPED, terrains, trials)
    robot, (eyes, late) = setups[0].robot, _cameras(setups, batch)
    loop = Loop(setups, make_planner(batch[0].planner, robot, LINE), time_limit_s=TIME_LIMIT_S)
    steps, images = [], []
    for step in loop.run():
        now, fresh = step.states, step.fresh
        late.step(eyes.expose(step.truth, now.step, fresh), now.time_s, fresh)
        steps.append(step)
        images.append(late.in_hand)
        tell_progress(1)
    tell_progress(WORK - len(steps))
    made = []
    for number, terrain in enumerate(terrains):
        count = sum(bool(step.running[number]) for step in steps)
        depth = np.array([image.depth[number] for image in images[:count]])
        captured_s = np.array([image.time_s[number] for image in images[:count]])
        position, quaternion = (
            np.array([getattr(step.truth, name)[number] for step in steps[:count]])
            for name in ("position_base_in_world", "quaternion_base_in_world")
        )
        truth = Truth(
            terrain=terrain.kind,
            height=true_heights(terrain, position, quaternion, LINE).astype(np.float32),
            view=visibility(terrain, Mount.of(robot), LINE, position, quaternion, captured_s),
        )
        states = [step.states for step in steps[:count]]
        made.append(SplitRun(inputs=_inputs(robot, states, number, depth, captured_s), truth=truth))
    return made


def _batch(number: int) -> list[RunPlan]:
    # A key that is spawned equals none that evaluations and trainings draw from: these are lists of
    # numbers.
    rng = np.random.default_rng(np.random.SeedSequence(FIRST_SEED, spawn_key=(VERSION, number)))
    made = []
    for i in range(ROBOTS):
        level, terrain = held_out_course(rng, i, tuple(FAMILIES))
        made.append(
            RunPlan(
                terrain=terrain,
                level=level,
                planner=PLANNERS[number % len(PLANNERS)],
                seed=FIRST_SEED + ROBOTS * number + i,
                strength=float(rng.uniform(*STRENGTH)),
                loss=float(rng.uniform(0.0, TRAINING.loss)),
            )
        )
    return made


def _cameras(setups: Sequence[Setup], batch: Sequence[RunPlan]) -> tuple[Eyes, LateImages]:
    """As in runs of Saltus a robot's camera draws from the seed of its trial."""
    losses, strengths = np.array([(plan.loss, plan.strength) for plan in batch]).T
    profile = replace(setups[0].profile, camera=drawn_around(setups[0].profile.camera, loss=losses))
    errors = of_strength(strengths, StereoConfig.of(setups[0].camera))
    return robot_cameras([replace(setup, profile=profile) for setup in setups], errors)


def _inputs(
    robot: Robot,
    states: Sequence[ProprioceptionArrays],
    number: int,
    depth: NDArray[np.uint16],
    captured_s: Floats,
) -> Inputs:
    seen = np.isfinite(captured_s)
    now_s = np.array([state.time_s for state in states])
    legs = LegKinematics(robot)
    return Inputs(
        proprioception=np.array(
            [proprioception_of_states(state, legs)[number] for state in states]
        ),
        depth=np.where(seen[:, None, None], depth, np.uint16(0)),
        depth_age_s=np.where(seen, now_s - np.where(seen, captured_s, 0.0), NO_IMAGE_S).astype(
            np.float32
        ),
        robot={
            name: np.array([getattr(state, name)[number] for state in states]) for name in OBSERVED
        },
    )


def _rounded(value: object) -> object:
    if isinstance(value, dict):
        return {name: _rounded(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return round(value, _DIGITS) if isinstance(value, float) else value


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
