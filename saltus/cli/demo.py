"""`saltus demo`: the whole stack on one terrain, with recording, report and video."""

import sys
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from saltus.cli.output import JsonOption, poll_until_done, print_json, run_directory
from saltus.cli.run_options import RunOptions
from saltus.cli.watch import ask_for_viser, watching
from saltus.config import Pace, RunConfig
from saltus.errors import ConfigError
from saltus.flags import Flag
from saltus.wire.messages import GroundTruth, Heightmap

if TYPE_CHECKING:
    from saltus.recordings.recording import Recording
    from saltus.recordings.report import ScanSection
    from saltus.runtime.replay import ReplayedMessage

BAR = "{desc}: {percentage:3.0f} % |{bar}| {n:.1f} of {total:.1f} m"


@dataclass(frozen=True, kw_only=True)
class Demo(JsonOption, RunOptions):
    """Runs the whole stack on one terrain; leaves a recording, a report and a video.

    For example:
      saltus demo
      saltus demo --terrain stairs --scan
      saltus demo --terrain gap --gap-m 0.6 --camera d435i --seed 3
      saltus demo --pace realtime --speed 0.5 --out runs/one --json
    """

    pace: Pace = "lockstep"
    time_limit_s: float = 20.0
    """The run ends after this much simulated time."""
    video: bool = True
    """Make an MP4 of the robot with the predicted heightmap on the terrain."""
    scan: Flag = False
    """Also show in the report the 187 heights around the robot, by the network of any grid, and how
    far they are off."""
    watch: Flag = False
    """Show the run on a page in the browser, and then its recording until Ctrl-C.

    See saltus watch.
    """

    def run(self) -> int:
        """Runs it; 0 where the robot crossed the terrain, else 1."""
        config = self.config(self.time_limit_s)
        if config.planner == "walking" and config.pace == "lockstep" and not config.commands:
            raise ConfigError(
                "a robot that walks stands until it is told: --commands FILE (docs/walking.md), or "
                "saltus up --planner walking and saltus drive beside it"
            )
        if self.watch:
            ask_for_viser()
        directory = run_directory("demo", self.out)
        if not self.watch:
            return self._run(config, directory)
        with watching(directory) as page:
            code = self._run(config, directory)
            print("the page shows the recording until Ctrl-C", file=sys.stderr, flush=True)
            page.wait()
        return code

    def _run(self, config: RunConfig, directory: Path) -> int:
        from saltus.recordings.recording import read_recording
        from saltus.recordings.report import write_run_report
        from saltus.recordings.summary import run_sentence, summarise_run

        run_stack(config, directory)
        recording = read_recording(directory / "recording.mcap")
        summary = summarise_run(recording)
        report = directory / "report.html"
        video = directory / "video.mp4" if self.video else None
        scan = self._scan(recording, directory / "scan.png") if self.scan else None
        write_run_report(recording, summary, report, video, scan)
        if video is not None:
            from saltus.cli.video import write_run_video

            write_run_video(recording, video)
        table = asdict(summary) | {
            "recording": str(directory / "recording.mcap"),
            "report": str(report),
            "video": str(video) if video else None,
        }
        if self.json:
            print_json(table)
        else:
            print(run_sentence(summary))
            for name in ("recording", "report", "video"):
                if table[name]:
                    print(f"{name:9} {table[name]}")
        return 0 if summary.success else 1

    def _scan(self, recording: "Recording", picture: Path) -> "ScanSection":
        """The scan of this run: the heightmap process hears the recording once more."""
        from saltus.grid import SCAN
        from saltus.heightmap.evaluation.scan_replay import draw_scan, scan_errors
        from saltus.heightmap.service.scan_fleet import ScanChoice
        from saltus.recordings.report import ScanSection
        from saltus.runtime.replay import body_of, replay_process

        answers = list[Heightmap]()

        def said(answer: "ReplayedMessage") -> None:
            if isinstance(answer.message, Heightmap):
                answers.append(answer.message)

        body = partial(body_of("heightmap"), scan=ScanChoice(grid=SCAN))
        replay_process("heightmap", recording, said, body=body)
        draw_scan(picture, recording, SCAN, answers)
        return ScanSection.of_figures(scan_errors(recording, SCAN, answers), picture)


def run_stack(config: RunConfig, directory: Path) -> None:
    """Runs the processes until the robot has finished,
    with a progress bar over the course on a terminal.
    """
    from tqdm import tqdm

    from saltus.runtime.stack import Stack

    shown = 0.0
    with (
        Stack(config, directory) as stack,
        tqdm(
            total=stack.setup.terrain.finish_x,
            desc=stack.setup.terrain.kind,
            bar_format=BAR,
            disable=None,
            leave=False,
        ) as bar,
    ):
        truths = stack.latest("plant/truth")
        for _ in poll_until_done(stack):
            sample = truths.take()
            if sample is not None and isinstance(sample.message, GroundTruth):
                x = min(
                    max(float(sample.message.position_base_in_world[0]), shown),
                    stack.setup.terrain.finish_x,
                )
                bar.update(x - shown)
                shown = x
