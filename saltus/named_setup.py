"""Setups, made of the names that stand in a configuration."""

from collections.abc import Sequence

from saltus.config import RunConfig
from saltus.depth_camera import DepthCamera, load_camera
from saltus.effects.profile import Profile, load_profile
from saltus.grid import HeightGrid, load_grid
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.setup import Setup
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain
from saltus.trial import Trial


def named_setup(run: RunConfig) -> Setup:
    """The values that a run names; the errors of `named_setups`."""
    terrains, trials = [make_terrain(run.terrain)], [Trial.draw(run.seed)]
    return named_setups(run.robot, run.grid, run.camera, run.profile, terrains, trials)[0]


def named_setups(
    robot: str | Robot,
    grid: str | HeightGrid,
    camera: str | DepthCamera,
    profile: str | Profile,
    terrains: Sequence[Terrain],
    trials: Sequence[Trial],
) -> list[Setup]:
    """A setup for each robot of a batch, which have a terrain and a trial of their own.

    Raises:
        ConfigError, ModelError: there is no such robot, grid, camera or profile.
    """
    kind = load_camera(camera) if isinstance(camera, str) else camera
    robot = kind.mounted_on(load_robot(robot) if isinstance(robot, str) else robot)
    known = load_profile(profile, robot) if isinstance(profile, str) else profile
    grid, known = load_grid(grid) if isinstance(grid, str) else grid, kind.delivered(known)
    return [
        Setup(robot=robot, grid=grid, terrain=terrain, profile=known, camera=kind, trial=trial)
        for terrain, trial in zip(terrains, trials, strict=True)
    ]
