"""`saltus demo`: the whole stack on one terrain, with recording, report and video."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tqdm import tqdm

from saltus.cli.output import follow, print_json, run_directory
from saltus.config import DEFAULT_ROBOT, Camera, Pace, PlannerName, Renderer, RunConfig, TerrainConfig
from saltus.wire.messages import GroundTruth

if TYPE_CHECKING:
    from saltus.recordings.summary import RunSummary

BAR = "{desc}: {percentage:3.0f} % |{bar}| {n:.1f} of {total:.1f} m"


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Runs the whole stack on one terrain; leaves a recording, a report and a video."""

    course: tyro.conf.OmitArgPrefixes[TerrainConfig] = field(default_factory=TerrainConfig)
    seed: int = 0
    """Seed of everything that is drawn."""
    pace: Pace = "lockstep"
    """lockstep: bit-repeatable, as fast as it goes. realtime: by the clock, times speed."""
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
        from saltus.recordings.recording import read_recording
        from saltus.recordings.report import write_report
        from saltus.recordings.summary import summarise
        from saltus.robots.loading import load_robot
        from saltus.terrain.curriculum import make_terrain

        terrain = make_terrain(self.course)
        load_profile(self.profile, load_robot(DEFAULT_ROBOT))
        config = RunConfig(
            terrain=self.course, seed=self.seed, pace=self.pace, camera=self.camera, renderer=self.renderer,
            profile=self.profile, planner=self.planner, speed=self.speed, time_limit_s=self.time_limit_s,
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
    from saltus.recordings.summary import shown

    verdict = "crossed" if summary.success else f"did not cross ({summary.explanation})"
    way = f"{shown(summary.distance_m, 2, 'm')} in {shown(summary.time_s, 2, 's')}"
    speed, error = shown(summary.mean_speed_mps, 2, "m/s"), shown(100 * summary.heightmap_mae_m, 1, "cm")
    return f"{verdict} {summary.terrain}: {way}, {speed}, heightmap error {error}"


def run_stack(config: RunConfig, directory: Path, finish_x: float) -> None:
    """Runs the processes until the robot has finished, with a progress bar over the course on a terminal."""
    from saltus.runtime.stack import Stack

    shown = 0.0
    with (
        Stack(config, directory) as stack,
        tqdm(total=finish_x, desc=stack.terrain.kind, bar_format=BAR, disable=None, leave=False) as bar,
    ):
        truths = stack.latest("plant/truth")
        for _ in follow(stack):
            sample = truths.take()
            if sample is not None and isinstance(sample.message, GroundTruth):
                x = min(max(float(sample.message.position_base_in_world[0]), shown), finish_x)
                bar.update(x - shown)
                shown = x
