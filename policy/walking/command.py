"""`saltus policy walk`: trains, exports and evaluates walking policies."""

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from saltus.config import check_between, load_changes
from saltus.errors import SaltusError
from saltus.flags import shown
from saltus.folders import another_training, ask_for_room, new_folder
from saltus.policy.training.command import TRAINING
from saltus.policy.training.files import CHECKPOINT
from saltus.policy.walking.settings import WalkTrainConfig


@dataclass(frozen=True, kw_only=True)
class Train:
    """Trains a policy that follows velocity commands with joint targets, on 187 heights.

    Ctrl-C saves. A flag wins over --config, --config over the resumed training or the defaults,
    which are a GPU's.

    For example:
      saltus policy walk train --minutes 40
      saltus policy walk train --resume runs/DATE-policy-walk/checkpoint.pt
    """

    out: Annotated[Path | None, shown("PATH", "a new one, runs/DATE-policy-walk")] = None
    """Folder for checkpoint.pt, walk.onnx, config.toml, log.txt and progress.csv.

    One with another training is refused.
    """
    minutes: float = 40.0
    """Time limit, with compilation."""
    iterations: Annotated[int | None, shown("INT", "none, the time ends it")] = None
    """Stop at this iteration, counted from the very first."""
    resume: Annotated[Path | None, shown("PATH", "none, from nothing")] = None
    """Checkpoint to go on from."""
    config: Annotated[Path | None, shown("PATH", "none")] = None
    """TOML file with what is to differ from the resumed training, or from the defaults."""
    device: Literal["auto", "cpu"] = "auto"
    """auto: a GPU where there is one."""
    commit: Annotated[str | None, shown("STR", "as git says")] = None
    """Commit of the code that trains, where this machine has no repository."""
    training: Annotated[WalkTrainConfig, tyro.conf.arg(name="")]

    def defaults(self) -> "Train":
        """The same command with the settings that its flags change.

        Raises:
            SaltusError: a file cannot be used, or training is not installed.
        """
        start = self._start()
        return replace(self, training=load_changes(start, self.config) if self.config else start)

    def run(self) -> int:
        """Trains to the end of the time; saves where it is interrupted.

        Raises:
            KeyboardInterrupt: it was interrupted; what was learned is saved.
            SaltusError: something of it cannot be; the message says what.
        """
        if not 0.0 < self.minutes < math.inf:
            raise SaltusError(
                f"minutes = {self.minutes:g}: it must be more than 0, and have an end"
            )
        if self.iterations is not None:
            check_between(self, iterations=(1, 10**9))
        start, folder = self._start(), self.out or new_folder("policy-walk")
        if self.resume and self.training.learning.hidden != start.learning.hidden:
            raise SaltusError(
                f"learning.hidden = {self.training.learning.hidden}: the networks of {self.resume} "
                f"have {start.learning.hidden}"
            )
        self._check_folder(folder)
        from saltus.policy.training.train import device_of_this_process
        from saltus.policy.walking.train import train

        train(
            self.training,
            folder,
            minutes=self.minutes,
            rank=device_of_this_process(self.device),
            resume=self.resume,
            iterations=self.iterations,
            code=self.commit,
        )
        print(folder / CHECKPOINT)  # noqa: T201
        return 0

    def _start(self) -> WalkTrainConfig:
        """The settings without flags and file."""
        try:
            from saltus.policy.training.checkpoint import config_of, read_checkpoint
        except ImportError as error:
            raise SaltusError(f"training needs {error.name}: {TRAINING}") from error
        if self.resume is not None:
            return config_of(read_checkpoint(self.resume), WalkTrainConfig)
        return WalkTrainConfig(robot=self.training.robot)

    def _check_folder(self, folder: Path) -> None:
        """Refuses a folder that holds another training, or that cannot be written into."""
        from saltus.policy.training.checkpoint import config_of, read_checkpoint

        ask_for_room(folder)
        there = folder / CHECKPOINT
        if there.exists() and not (self.resume is not None and self.resume.samefile(there)):
            before = config_of(read_checkpoint(there), WalkTrainConfig)
            raise another_training(there, asdict(before), asdict(self.training))


@dataclass(frozen=True, kw_only=True)
class Export:
    """Exports a walking policy's checkpoint to ONNX; a training does so by itself.

    Example: saltus policy walk export --checkpoint runs/DATE-policy-walk/checkpoint.pt
    """

    checkpoint: Path
    """The checkpoint.pt of a training."""
    out: Annotated[Path | None, shown("PATH", "walk.onnx beside the checkpoint")] = None
    """The file to write."""

    def run(self) -> int:
        """Writes it."""
        try:
            from saltus.policy.walking.export import MODEL, export
        except ImportError as error:
            raise SaltusError(f"exporting needs {error.name}: {TRAINING}") from error
        path = self.out or self.checkpoint.with_name(MODEL)
        export(self.checkpoint, path)
        print(path)  # noqa: T201
        return 0


@dataclass(frozen=True, kw_only=True)
class Eval:
    """Measures a walking policy on the CPU engine: falls, and errors of its velocity.

    Example: saltus policy walk eval --model runs/DATE-policy-walk/walk.onnx --grounds plain rubble
    """

    model: Path
    """The ONNX file of a walking policy."""
    grounds: tuple[str, ...] = ("plain", "rubble")
    """Families of terrain."""
    level: int = 5
    """Level of the ground, see `GroundConfig.levels`."""
    robots: int = 20
    """Robots on each ground, which all begin at once."""
    seconds: float = 20.0
    seed: int = 0
    scan: Literal["drawn", "true"] = "drawn"
    """drawn: heights with the errors of the training. true: heights as they are."""

    def run(self) -> int:
        """Prints a line for each ground."""
        try:
            from saltus.policy.walking.evaluation import evaluate
        except ImportError as error:
            raise SaltusError(f"evaluating needs {error.name}: {TRAINING}") from error
        check_between(self, level=(0, 254), robots=(1, 10_000), seconds=(2.0, 1e4))
        for ground in self.grounds:
            score = evaluate(
                self.model, ground, level=self.level, robots=self.robots, seconds=self.seconds,
                seed=self.seed, exact=self.scan == "true",
            )  # fmt: skip
            print(score.line())  # noqa: T201
        return 0
