"""`saltus demo`: the whole stack on one terrain, with recording, report and video."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tqdm import tqdm

from saltus.cli.output import print_json, run_directory
from saltus.config import Camera, Pace, PlannerName, Renderer, RunConfig, TerrainConfig
from saltus.messages import GroundTruth

if TYPE_CHECKING:
    from saltus.summary import RunSummary

PROGRESS_PERIOD_S = 0.2
BAR = "{desc}: {percentage:3.0f} % |{bar}| {n:.1f} of {total:.1f} m"


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Runs the whole stack on one terrain; leaves a recording, a report and a video."""

    course: tyro.conf.OmitArgPrefixes[TerrainConfig] = field(default_factory=TerrainConfig)
    seed: int = 0
    """Seed of everything that is drawn."""
    pace: Pace = "lockstep"
    """lockstep: bit-repeatable, as fast as it goes. realtime: on the wall clock."""
    camera: Camera = "ideal"
    """ideal: true depth. d435i: with the errors of a stereo camera."""
    renderer: Renderer = "auto"
    """Back end of the ideal camera."""
    planner: PlannerName = "learned"
    """scripted: rules that read the heightmap. learned: the shipped policy."""
    profile: str = "go1"
    """Effects of the hardware: ideal, go1, one of your own, or a TOML file."""
    time_limit_s: float = 20.0
    """The run ends after this much simulated time."""
    video: bool = True
    """Make an MP4 of the robot with the predicted heightmap on the terrain."""
    out: Path | None = None
    """Folder for everything, in place of what an earlier run left there; a new one under runs/ where not given."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print the result as one JSON object on the last line."""

    def run(self) -> int:
        """Runs it; 0 where the robot crossed the terrain, else 1."""
        from saltus.effects.profile import load_profile
        from saltus.recording import read_recording
        from saltus.report import write_report
        from saltus.summary import summarise
        from saltus.terrain.curriculum import make_terrain

        terrain = make_terrain(self.course)
        load_profile(self.profile)
        config = RunConfig(
            terrain=self.course, seed=self.seed, pace=self.pace, camera=self.camera, renderer=self.renderer,
            profile=self.profile, planner=self.planner, time_limit_s=self.time_limit_s,
        )  # fmt: skip
        config.check()
        directory = run_directory("demo", self.out)
        run_stack(config, directory, terrain.finish_x)
        recording = read_recording(directory / "recording.mcap")
        summary = summarise(recording)
        report = directory / "report.html"
        write_report(recording, summary, report)
        video = directory / "video.mp4" if self.video else None
        if video is not None:
            from saltus.cli.video import write_video

            write_video(recording, terrain, video)
        table = asdict(summary) | {
            "recording": str(directory / "recording.mcap"),
            "report": str(report),
            "video": str(video) if video else None,
        }
        if self.json:
            print_json(table)
        else:
            print(_sentence(summary))
            for name in ("recording", "report", "video"):
                if table[name]:
                    print(f"{name:9} {table[name]}")
        return 0 if summary.success else 1


def _sentence(summary: "RunSummary") -> str:
    verdict = "crossed" if summary.success else f"did not cross ({summary.cause})"
    way = f"{summary.distance_m:.2f} m in {summary.time_s:.2f} s, {summary.mean_speed_mps:.2f} m/s"
    return f"{verdict} {summary.terrain}: {way}, heightmap off by {100 * summary.heightmap_mae_m:.1f} cm"


def run_stack(config: RunConfig, directory: Path, finish_x: float) -> None:
    """Runs the processes until the robot has finished, with a progress bar over the course on a terminal."""
    from saltus.stack import Stack

    shown = 0.0
    with (
        Stack(config, directory) as stack,
        tqdm(total=finish_x, desc=config.terrain.terrain, bar_format=BAR, disable=None, leave=False) as bar,
    ):
        truths = stack.latest("plant/truth")
        while not stack.wait(PROGRESS_PERIOD_S):
            sample = truths.take()
            if sample is not None and isinstance(sample.message, GroundTruth):
                x = min(max(float(sample.message.position_base_in_world[0]), shown), finish_x)
                bar.update(x - shown)
                shown = x
