"""What a run of the whole stack is told, by `demo` and `up` alike."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from saltus.cli.flags import shown
from saltus.config import DEFAULT_ROBOT, Camera, Pace, PlannerName, Renderer, RunConfig, TerrainConfig


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Flags of a run."""

    course: tyro.conf.OmitArgPrefixes[TerrainConfig] = field(default_factory=TerrainConfig)
    robot: str = DEFAULT_ROBOT
    """A robot that Saltus ships, or the path of an MJCF or of a folder with a robot.toml."""
    seed: int = 0
    """Seed of everything that is drawn."""
    speed: float = 1.0
    """With realtime: seconds of the run for each second of this computer; less than 1 where it cannot keep up."""
    camera: Camera = "ideal"
    """ideal: true depth. d435i: with the errors of a stereo camera."""
    renderer: Renderer = "auto"
    """Back end of the ideal camera."""
    planner: PlannerName = "learned"
    """scripted: rules that read the heightmap. learned: a network."""
    policy_model: Annotated[Path | None, shown("PATH", "the shipped policy")] = None
    """ONNX file of the learned planner."""
    heightmap_model: Annotated[Path | None, shown("PATH", "the shipped model")] = None
    """ONNX file of the heightmap service."""
    profile: str = "shipped"
    """Effects of the hardware: shipped (those of the robot), ideal, one of your own, or a TOML file."""

    def config(self, pace: Pace, time_limit_s: float) -> RunConfig:
        """The configuration of the run, checked: what is wrong with it is said before anything starts.

        Raises:
            ConfigError, ModelError: what is wrong.
        """
        from saltus.effects.profile import load_profile
        from saltus.heightmap.service.network import HeightmapNetwork
        from saltus.policy.planner import make_planner
        from saltus.robots.loading import load_robot
        from saltus.terrain.curriculum import make_terrain

        robot = load_robot(self.robot)
        make_terrain(self.course)
        load_profile(self.profile, robot)
        policy, heightmap = (None if path is None else str(path) for path in (self.policy_model, self.heightmap_model))
        if policy is not None:
            make_planner(self.planner, robot, policy)
        if heightmap is not None:
            HeightmapNetwork(robot, Path(heightmap))
        config = RunConfig(
            robot=self.robot, terrain=self.course, seed=self.seed, pace=pace, camera=self.camera,
            renderer=self.renderer, profile=self.profile, planner=self.planner, policy_model=policy,
            heightmap_model=heightmap, speed=self.speed, time_limit_s=time_limit_s,
        )  # fmt: skip
        config.check()
        return config
