"""The setup of a run, made of the names that stand in its configuration."""

from saltus.config import RunConfig
from saltus.depth_camera import load_camera
from saltus.effects.profile import load_profile
from saltus.grid import load_grid
from saltus.robots.loading import load_robot
from saltus.setup import Setup
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Trial


def named_setup(run: RunConfig) -> Setup:
    """The values that a run names.

    Raises:
        ConfigError, ModelError: there is no such robot, grid, terrain, camera or profile.
    """
    camera = load_camera(run.camera)
    robot = camera.mounted_on(load_robot(run.robot))
    return Setup(
        robot=robot,
        grid=load_grid(run.grid),
        terrain=make_terrain(run.terrain),
        profile=camera.delivered(load_profile(run.profile, robot)),
        camera=camera,
        trial=Trial.draw(run.seed),
    )
