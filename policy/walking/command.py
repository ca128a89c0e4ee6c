"""`saltus policy walk`: trains, exports and evaluates walking policies."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from saltus.config import check_between
from saltus.extras import packages_of
from saltus.flags import flag_help
from saltus.policy.training.files import CHECKPOINT
from saltus.policy.training.training_command import TrainingCommand
from saltus.policy.walking.settings import WalkTrainSettings


@dataclass(frozen=True, kw_only=True)
class TrainWalkCommand(TrainingCommand):
    """Trains a policy that follows velocity commands with joint targets, on 187 heights.

    Ctrl-C saves. A flag wins over --config, --config over the resumed training or the defaults,
    which are a GPU's.

    For example:
      saltus policy walk train --minutes 40
      saltus policy walk train --start models/walk_go1.onnx --minutes 10
      saltus policy walk train --resume runs/DATE-policy-walk/checkpoint.pt
    """

    folder = "policy-walk"

    minutes: float = 40.0
    """Time limit, with compilation."""
    training: Annotated[WalkTrainSettings, tyro.conf.arg(name="")]

    def usual(self) -> WalkTrainSettings:
        """Settings of a GPU where nothing is given and no training goes on."""
        return WalkTrainSettings(robot=self.training.robot)

    def run(self) -> int:
        """Trains to the end of the time; saves where it is interrupted.

        Raises:
            KeyboardInterrupt: it was interrupted; what was learned is saved.
            SaltusError: something of it cannot be; the message says what.
        """
        self.check()
        folder = self.new_folder()
        self.check_folder(folder)
        from saltus.policy.training.train import device_of_this_process
        from saltus.policy.walking.train import train_walk

        train_walk(
            self.training,
            folder,
            minutes=self.minutes,
            rank=device_of_this_process(self.device),
            resume=self.resume,
            start=self.start,
            iterations=self.iterations,
            code=self.commit,
        )
        print(folder / CHECKPOINT)  # noqa: T201
        return 0


@dataclass(frozen=True, kw_only=True)
class ExportWalk:
    """Exports a walking policy's checkpoint to ONNX; a training does so by itself.

    Example: saltus policy walk export --checkpoint runs/DATE-policy-walk/checkpoint.pt
    """

    checkpoint: Path
    """The checkpoint.pt of a training."""
    out: Annotated[Path | None, flag_help("PATH", "walk.onnx beside the checkpoint")] = None
    """The file to write."""

    def run(self) -> int:
        """Writes it."""
        with packages_of("train", "exporting"):
            from saltus.policy.walking.export import MODEL, export_walk
        path = self.out or self.checkpoint.with_name(MODEL)
        export_walk(self.checkpoint, path)
        print(path)  # noqa: T201
        return 0


@dataclass(frozen=True, kw_only=True)
class EvalWalk:
    """Measures a walking policy on the CPU engine: falls, and errors of its velocity.

    Example: saltus policy walk eval --model runs/DATE-policy-walk/walk.onnx --grounds plain rubble
    """

    model: Path
    """The ONNX file of a walking policy."""
    grounds: tuple[str, ...] = ("plain", "rubble")
    """Families of terrain."""
    level: int = 5
    """Level of the ground, see `GroundSettings.levels`."""
    robots: int = 20
    """Robots on each ground, which all begin at once."""
    seconds: float = 20.0
    seed: int = 0
    scan: Literal["drawn", "true"] = "drawn"
    """drawn: heights with the errors of the training. true: heights as they are."""

    def run(self) -> int:
        """Prints a line for each ground."""
        with packages_of("train", "evaluating"):
            from saltus.policy.walking.evaluation import evaluate_walk
        check_between(self, level=(0, 254), robots=(1, 10_000), seconds=(2.0, 1e4))
        for ground in self.grounds:
            score = evaluate_walk(
                self.model, ground, level=self.level, robots=self.robots, seconds=self.seconds,
                seed=self.seed, exact=self.scan == "true",
            )  # fmt: skip
            print(score.line())  # noqa: T201
        return 0
