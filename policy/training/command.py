"""`saltus policy train`: the training of the motion policy as it is asked for."""

import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from saltus.config import check_between
from saltus.effects.profile import load_profile
from saltus.errors import SaltusError
from saltus.flags import flag_help
from saltus.folders import setting_differences
from saltus.gpu import has_gpu
from saltus.policy.env.settings import LARGEST, JumpTrainSettings, for_cpu, for_gpu
from saltus.policy.training.files import CHECKPOINT
from saltus.policy.training.training_command import TrainingCommand
from saltus.robots.loading import load_robot
from saltus.terrain.curriculum import find_family

GPU_EVALUATE_MINUTES = 3.0


@dataclass(frozen=True, kw_only=True)
class TrainPolicyCommand(TrainingCommand):
    """Trains the motion policy: on a CPU to bound on flat ground, on a GPU on the paper's terrains.

    Ctrl-C saves.

    A flag wins over --config, --config over the resumed training or the defaults; the defaults
    below are a GPU's. A TOML file names what it changes as the flags do: learning.desired_kl =
    0.003. Several GPUs: torchrun --nproc_per_node N -m saltus.cli.policy_train.

    For example:
      saltus policy train --device cpu --minutes 15
      saltus policy train --resume runs/DATE-policy-train/checkpoint.pt --learning.desired-kl 0.003
    """

    folder = "policy-train"

    evaluate_minutes: Annotated[float | None, flag_help("FLOAT", "3 beside a GPU, 0 on a CPU")] = (
        None
    )
    """Time between evaluations with the deployed stack, which run beside the training; 0: none."""
    training: Annotated[JumpTrainSettings, tyro.conf.arg(name="")]

    def usual(self) -> JumpTrainSettings:
        """Settings of the device where nothing is given and no training goes on."""
        usual = for_cpu if self.device == "cpu" or not has_gpu() else for_gpu
        return usual(self.training.robot, self.training.grid)

    def run(self) -> int:
        """Trains to the end of the time, with one line every ten seconds.

        Saves where it is interrupted.

        Raises:
            KeyboardInterrupt: it was interrupted; what was learned is saved.
            SaltusError: something of it cannot be; the message says what.
        """
        if self.evaluate_minutes is not None:
            check_between(self, evaluate_minutes=(0.0, LARGEST))
        load_profile(self.training.env.profile, load_robot(self.training.robot))
        for kind in self.training.env.curriculum.own:
            find_family(kind)  # before there is a folder
        basis, folder = self.check(), self.new_folder()
        if (
            os.environ.get("RANK", "0") != "0"
        ):  # one of several that learn together: the first one writes
            self._train(folder, "")
            return 0
        self.check_folder(folder)
        self._train(
            folder,
            _note(basis, self.training, "the resumed training" if self.resume else "the defaults"),
        )
        print(folder / CHECKPOINT)  # noqa: T201
        return 0

    def _train(self, folder: Path, note: str) -> None:
        from saltus.policy.training.train import device_of_this_process, train_policy

        rank = device_of_this_process(self.device)
        given = GPU_EVALUATE_MINUTES if rank.device != "cpu" else 0.0
        try:
            train_policy(
                self.training,
                folder,
                minutes=self.minutes,
                rank=rank,
                resume=self.resume,
                start=self.start,
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


def _note(basis: JumpTrainSettings, now: JumpTrainSettings, what: str) -> str:
    found = [
        f"{d.name} = {d.now} (there {d.before})"
        for d in setting_differences(asdict(basis), asdict(now))
    ]
    return f"differs from {what}: {', '.join(found)}" if found else f"as {what}"
