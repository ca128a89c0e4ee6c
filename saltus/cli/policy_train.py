"""`saltus policy train` and `saltus policy export`: the learned policy from nothing to the file that plans."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from saltus.errors import SaltusError

MAX_DIFFERENCE = 1e-5  # of an action's range, between torch and the exported file
TRAINING = "pip install 'saltus[train]'"


@dataclass(frozen=True, kw_only=True)
class Train:
    """Trains the motion policy: on a CPU to bound on flat ground, on a GPU on all terrains."""

    out: Path = Path("runs/policy")
    """Folder for checkpoint.pt, config.toml, progress.csv and tensorboard's curves."""
    minutes: float = 15.0
    """Time limit, with compilation."""
    iterations: int | None = None
    """Stop at this iteration, counted from the very first."""
    resume: Path | None = None
    """Checkpoint to go on from."""
    config: Path | None = None
    """TOML file; that of the checkpoint, or the device's own, where it is not given."""
    robots: int | None = None
    """Number of robots."""
    seed: int | None = None
    """Of everything that is drawn."""
    profile: str | None = None
    """Effects of the drives: ideal, go1, one of your own, or a TOML file; that of the config where it is not given."""
    evaluate_minutes: float | None = None
    """Time between evaluations with the deployed stack, which run beside the training; 0: none. By default 3 beside a
    GPU, and none on a CPU."""
    device: Literal["auto", "cpu"] = "auto"
    """auto: a GPU where there is one. Several GPUs: torchrun --nproc_per_node N -m saltus.policy.training.train."""

    def run(self) -> int:
        """Trains to the end of the time, with one line every ten seconds."""
        try:
            from saltus.policy.training.train import main
        except ImportError as error:
            raise SaltusError(f"training needs {error.name}: {TRAINING}") from error
        given = {name: value for name, value in vars(self).items() if value is not None}
        main([part for name, value in given.items() for part in (f"--{name.replace('_', '-')}", str(value))])
        print(self.out / "checkpoint.pt")
        return 0


@dataclass(frozen=True, kw_only=True)
class Export:
    """Exports a checkpoint to the ONNX file that the planner runs."""

    checkpoint: Path = Path("runs/policy/checkpoint.pt")
    """What to export."""
    out: Path = Path("runs/policy/policy.onnx")
    """The file to write."""

    def run(self) -> int:
        """Writes the file; 0 where it equals the checkpoint's network, else 1."""
        try:
            from saltus.policy.training.export import export
        except ImportError as error:
            raise SaltusError(f"exporting needs {error.name}: {TRAINING}") from error
        difference = export(self.checkpoint, self.out)
        print(f"{self.out}: differs from torch by at most {difference:.1e} of an action's range")
        return 0 if difference <= MAX_DIFFERENCE else 1
