"""A training of a policy as it is asked for:
from where it starts, where it writes, how long it takes.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import tyro

from saltus.config import check_between, load_changes
from saltus.errors import SaltusError
from saltus.extras import packages_of
from saltus.flags import flag_help
from saltus.folders import another_training, ask_for_room, new_folder
from saltus.policy.training.files import CHECKPOINT

STARTED = {"first_std": 0.2, "critic_iterations": 20}
"""Learning where an actor comes from a file: the shipped walking policies ended at standard
deviations of 0.10 and 0.16, and a new critic misleads an actor."""


@dataclass(frozen=True, kw_only=True)
class TrainingCommand(ABC):
    """A training for a time or a number of iterations, from nothing, a policy or a checkpoint.

    A flag wins over --config, --config over the resumed training or the defaults.
    """

    folder: ClassVar[str]
    """Name of the new folders under runs/, after the date."""

    out: Annotated[Path | None, flag_help("PATH", "a new one under runs/")] = None
    """Folder for checkpoint.pt, config.toml, log.txt and tables.

    One with another training is refused.
    """
    minutes: float = 15.0
    """Time limit, with compilation."""
    iterations: Annotated[int | None, flag_help("INT", "none, the time ends it")] = None
    """Stop at this iteration, counted from the very first."""
    resume: Annotated[Path | None, flag_help("PATH", "none, from nothing")] = None
    """Checkpoint to go on from, in its own folder or in another, which then gets its log and tables
    as well."""
    start: Annotated[Path | None, flag_help("PATH", "none, from nothing")] = None
    """ONNX file of a policy to begin with, as those in models/; critic and levels are new."""
    config: Annotated[Path | None, flag_help("PATH", "none")] = None
    """TOML file with what is to differ from the resumed training, or from the defaults."""
    device: Literal["auto", "cpu"] = "auto"
    """auto: a GPU where there is one."""
    commit: Annotated[str | None, flag_help("STR", "as git says")] = None
    """Commit of the code that trains, where this machine has no repository."""
    training: Annotated[Any, tyro.conf.arg(name="")]

    @abstractmethod
    def usual(self) -> Any:
        """Settings where nothing is given and no training goes on."""

    def basis(self) -> Any:
        """Settings without flags and file: those of the resumed training, else the usual ones.

        Raises:
            SaltusError: the checkpoint cannot be used, or training is not installed.
        """
        with packages_of("train", "training"):
            from saltus.policy.training.checkpoint import read_policy_checkpoint, training_config
        if self.resume is not None:
            return training_config(read_policy_checkpoint(self.resume), type(self.training))
        usual = self.usual()
        return replace(usual, learning=replace(usual.learning, **STARTED)) if self.start else usual

    def defaults(self) -> Self:
        """A copy of this command whose settings are those that its flags then change:
        `basis`, and those of --config.

        Raises:
            SaltusError: a file cannot be used, or training is not installed.
        """
        basis = self.basis()
        return replace(self, training=load_changes(basis, self.config) if self.config else basis)

    def check(self) -> Any:
        """Refuses limits out of their range and networks of another size; returns `basis`.

        Raises:
            SaltusError: it is one of these.
        """
        if not 0.0 < self.minutes < math.inf:
            raise SaltusError(
                f"minutes = {self.minutes:g}: it must be more than 0, and have an end"
            )
        if self.iterations is not None:
            check_between(self, iterations=(1, 10**9))
        if self.resume is not None and self.start is not None:
            raise SaltusError("--start is for new trainings: --resume goes on with its own policy")
        basis, hidden = self.basis(), self.training.learning.hidden
        if self.resume is not None and hidden != basis.learning.hidden:
            raise SaltusError(
                f"learning.hidden = {hidden}: the networks of {self.resume} have "
                f"{basis.learning.hidden}"
            )
        return basis

    def new_folder(self) -> Path:
        """Folder of the results; a new one, not made here, unless --out names it."""
        return self.out or new_folder(self.folder)

    def check_folder(self, folder: Path) -> None:
        """Refuses a folder that holds another training, or that cannot be written into.

        Raises:
            SaltusError: it is one of these.
        """
        from saltus.policy.training.checkpoint import read_policy_checkpoint, training_config

        ask_for_room(folder)
        there = folder / CHECKPOINT
        if not there.exists() or (self.resume is not None and _is_same_file(self.resume, there)):
            return
        before = training_config(read_policy_checkpoint(there), type(self.training))
        raise another_training(there, asdict(before), asdict(self.training))


def _is_same_file(one: Path, other: Path) -> bool:
    return one.samefile(other) or one.read_bytes() == other.read_bytes()
