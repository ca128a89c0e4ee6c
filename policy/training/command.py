"""A training of the motion policy as it is asked for: from where it starts, where it writes, how long it takes."""

import math
import os
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from saltus.config import check_between, load_changes
from saltus.effects.profile import load_profile
from saltus.errors import SaltusError
from saltus.flags import shown
from saltus.folders import another_training, ask_for_room, differences, new_folder
from saltus.gpu import has_gpu
from saltus.policy.env.settings import LARGEST, TrainConfig, for_cpu, for_gpu
from saltus.policy.training.files import CHECKPOINT
from saltus.robots.loading import load_robot
from saltus.terrain.curriculum import find_family

TRAINING = "pip install 'saltus[train]'"
GPU_EVALUATE_MINUTES = 3.0


@dataclass(frozen=True, kw_only=True)
class Train:
    """Trains the motion policy: on a CPU to bound on flat ground, on a GPU on the paper's terrains.

    Ctrl-C saves.

    A flag wins over --config, --config over the resumed training or the defaults; the defaults
    below are a GPU's. A TOML file names what it changes as the flags do: learning.desired_kl =
    0.003.

    For example:
      saltus policy train --device cpu --minutes 15
      saltus policy train --resume runs/DATE-policy-train/checkpoint.pt --learning.desired-kl 0.003
    """

    out: Annotated[Path | None, shown("PATH", "a new one, runs/DATE-policy-train")] = None
    """Folder for checkpoint.pt, config.toml, log.txt, tables and curves.

    One with another training is refused.
    """
    minutes: float = 15.0
    """Time limit, with compilation."""
    iterations: Annotated[int | None, shown("INT", "none, the time ends it")] = None
    """Stop at this iteration, counted from the very first."""
    resume: Annotated[Path | None, shown("PATH", "none, from nothing")] = None
    """Checkpoint to go on from, in its own folder or in another, which then gets its log and tables
    as well."""
    config: Annotated[Path | None, shown("PATH", "none")] = None
    """TOML file with what is to differ from the resumed training, or from the defaults."""
    device: Literal["auto", "cpu"] = "auto"
    """auto: a GPU where there is one.

    Several GPUs: torchrun --nproc_per_node N -m saltus.cli.policy_train.
    """
    evaluate_minutes: Annotated[float | None, shown("FLOAT", "3 beside a GPU, 0 on a CPU")] = None
    """Time between evaluations with the deployed stack, which run beside the training; 0: none."""
    commit: Annotated[str | None, shown("STR", "as git says")] = None
    """Which code trains, where this machine has no repository."""
    training: Annotated[TrainConfig, tyro.conf.arg(name="")]

    def defaults(self) -> "Train":
        """The same command with what its flags go on from: resumed training or the device's defaults, and --config.

        Raises:
            SaltusError: a file cannot be used, or training is not installed.
        """
        start = self._start()
        return replace(self, training=load_changes(start, self.config) if self.config else start)

    def run(self) -> int:
        """Trains to the end of the time, with one line every ten seconds.

        Saves where it is interrupted.

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
        if self.evaluate_minutes is not None:
            check_between(self, evaluate_minutes=(0.0, LARGEST))
        load_profile(self.training.env.profile, load_robot(self.training.robot))
        for kind in self.training.env.curriculum.own:
            find_family(kind)  # before there is a folder
        start, folder = self._start(), self.out or new_folder("policy-train")
        self._check_networks(start)
        if (
            os.environ.get("RANK", "0") != "0"
        ):  # one of several that learn together: the first one writes
            self._train(folder, "")
            return 0
        self._check_folder(folder)
        self._train(
            folder,
            _note(start, self.training, "the resumed training" if self.resume else "the defaults"),
        )
        print(folder / CHECKPOINT)  # noqa: T201
        return 0

    def _train(self, folder: Path, note: str) -> None:
        from saltus.policy.training.train import device_of_this_process, train

        rank = device_of_this_process(self.device)
        given = GPU_EVALUATE_MINUTES if rank.device != "cpu" else 0.0
        try:
            train(
                self.training,
                folder,
                minutes=self.minutes,
                rank=rank,
                resume=self.resume,
                iterations=self.iterations,
                evaluate_minutes=given if self.evaluate_minutes is None else self.evaluate_minutes,
                code=self.commit,
                note=note,
            )
        except MemoryError as error:
            raise SaltusError(
                f"robots = {self.training.robots}: too many for the memory of this computer"
            ) from error
        except KeyboardInterrupt:
            if note and not (folder / CHECKPOINT).exists():
                print("interrupted before anything was learned", file=sys.stderr)  # noqa: T201
            raise

    def _start(self) -> TrainConfig:
        """The settings without flags and file: those of the resumed training, or of the device."""
        try:
            from saltus.policy.training.checkpoint import config_of, read_checkpoint
        except ImportError as error:
            raise SaltusError(f"training needs {error.name}: {TRAINING}") from error
        if self.resume is not None:
            return config_of(read_checkpoint(self.resume))
        usual = for_cpu if self.device == "cpu" or not has_gpu() else for_gpu
        return usual(self.training.robot, self.training.grid)

    def _check_networks(self, start: TrainConfig) -> None:
        if self.resume is not None and self.training.learning.hidden != start.learning.hidden:
            raise SaltusError(
                f"learning.hidden = {self.training.learning.hidden}: the networks of {self.resume} "
                "have "
                f"{start.learning.hidden}"
            )

    def _check_folder(self, folder: Path) -> None:
        """Refuses a folder that holds another training, or that cannot be written into."""
        from saltus.policy.training.checkpoint import config_of, read_checkpoint

        ask_for_room(folder)
        there = folder / CHECKPOINT
        if not there.exists() or (self.resume is not None and _is_same_file(self.resume, there)):
            return
        raise another_training(
            there, asdict(config_of(read_checkpoint(there))), asdict(self.training)
        )


def _note(start: TrainConfig, now: TrainConfig, what: str) -> str:
    found = [
        f"{d.name} = {d.now} (there {d.before})" for d in differences(asdict(start), asdict(now))
    ]
    return f"differs from {what}: {', '.join(found)}" if found else f"as {what}"


def _is_same_file(one: Path, other: Path) -> bool:
    return one.samefile(other) or one.read_bytes() == other.read_bytes()
