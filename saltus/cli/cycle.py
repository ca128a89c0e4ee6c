"""`saltus real2sim cycle`: from a robot's logs to models that are trained for it, and what that is worth."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from saltus.cli.heightmap_train import SettingsCommand, training_packages
from saltus.cli.output import Bar, JsonOption
from saltus.cli.run_options import mounted_camera
from saltus.flags import shown
from saltus.grid import DEFAULT_GRID
from saltus.heightmap.settings import ClosedLoop
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True, kw_only=True)
class Cycle(JsonOption, SettingsCommand):
    """Logs a robot, finds what the simulator lacks, trains with it, and measures the robot before and after.

    Goes on where it was stopped: a stage that is done is not repeated. Without a GPU the predictor alone is trained.
    The settings can also stand in a TOML file (--config). A flag wins over it, the file over the cycle that goes on.

    For example:
      saltus real2sim cycle --hidden examples/late_camera.toml --experiments heave_and_pitch --out runs/late
      saltus real2sim cycle --out runs/late --export-training to_gpu
      saltus real2sim cycle --out runs/late --take-training to_gpu
      saltus real2sim cycle --logs logs/monday runs/one --out runs/mine
    """

    out: Path = Path("runs/cycle")
    """Folder of the cycle, with report.html."""
    settings: Annotated[CycleSettings, tyro.conf.arg(name="")] = field(
        default_factory=lambda: CycleSettings(loop=ClosedLoop(robot=DEFAULT_ROBOT, grid=DEFAULT_GRID))
    )
    export_training: Annotated[Path | None, shown("PATH", "none, train here")] = None
    """Folder to write for a machine with a GPU: profile, checkpoints, settings and commands, which make the data there;
    nothing is trained here."""
    take_training: Annotated[Path | None, shown("PATH", "none, train here")] = None
    """Such a folder with the models that were trained there."""

    def last(self) -> CycleSettings | None:
        """Those of the cycle that goes on."""
        from saltus.real2sim.cycle.folder import settings_of

        return settings_of(self.out)

    def run(self) -> int:
        """Runs what is still missing, and writes the report."""
        with training_packages():
            from saltus.real2sim.cycle.cycle import CycleRun as Stages
            from saltus.real2sim.cycle.elsewhere import refuse
            from saltus.real2sim.cycle.folder import open_folder
            from saltus.real2sim.cycle.report import results

        refuse(self.export_training, self.take_training)
        mounted_camera(self.settings.loop.camera, load_robot(self.settings.loop.robot))
        folder, settings = open_folder(self.out, self.settings)
        with Bar() as bar:
            Stages(folder=folder, settings=settings, observer=bar).run(self.export_training, self.take_training)
        print(folder.report)
        self.tell_json(results(folder))
        return 0
