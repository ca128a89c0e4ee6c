"""`saltus up`: the processes, until Ctrl-C."""

from dataclasses import dataclass, field
from pathlib import Path

import tyro

from saltus.cli.output import follow, run_directory
from saltus.config import DEFAULT_ROBOT, Camera, Pace, PlannerName, Renderer, RunConfig, TerrainConfig

FOREVER_S = 1e6


@dataclass(frozen=True, kw_only=True)
class Up:
    """Starts the processes and keeps them running until Ctrl-C or until the robot has finished."""

    course: tyro.conf.OmitArgPrefixes[TerrainConfig] = field(default_factory=TerrainConfig)
    seed: int = 0
    """Seed of everything that is drawn."""
    pace: Pace = "realtime"
    """realtime: by the clock, times speed. lockstep: bit-repeatable, as fast as it goes."""
    speed: float = 1.0
    """With realtime: seconds of the run for each second of this computer; less than 1 where it cannot keep up."""
    camera: Camera = "ideal"
    """ideal: true depth. d435i: with the errors of a stereo camera."""
    renderer: Renderer = "auto"
    """Back end of the ideal camera."""
    planner: PlannerName = "learned"
    """scripted: rules that read the heightmap. learned: the shipped policy."""
    profile: str = "shipped"
    """Effects of the hardware: shipped (those of the robot), ideal, one of your own, or a TOML file."""
    out: Path | None = None
    """Folder for logs and recording; a new one under runs/ where it is not given."""

    def run(self) -> int:
        """Runs until the end; 0 then, 130 after Ctrl-C (the recording is closed either way)."""
        from saltus.effects.profile import load_profile
        from saltus.robots.loading import load_robot
        from saltus.runtime.stack import Stack
        from saltus.terrain.curriculum import make_terrain

        make_terrain(self.course)
        load_profile(self.profile, load_robot(DEFAULT_ROBOT))
        config = RunConfig(
            terrain=self.course, seed=self.seed, pace=self.pace, camera=self.camera, renderer=self.renderer,
            profile=self.profile, planner=self.planner, speed=self.speed, time_limit_s=FOREVER_S,
        )  # fmt: skip
        config.check()
        directory = run_directory("up", self.out)
        with Stack(config, directory) as stack:
            print(f"running at {stack.endpoint}, keys under {config.prefix}; Ctrl-C ends it; logs in {directory}/logs")
            for _ in follow(stack):
                pass
        return 0
