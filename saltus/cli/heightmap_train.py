"""`saltus heightmap train` and `saltus heightmap export`: from a dataset to a model file."""

import sys
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import tyro

from saltus.config import load_changes
from saltus.errors import SaltusError
from saltus.extras import packages_of
from saltus.flags import flag_help
from saltus.folders import setting_differences
from saltus.heightmap.settings import FIRST_RATE, FURTHER_RATE, PredictorTraining

if TYPE_CHECKING:
    from saltus.heightmap.training.train import TrainingProgress

FOLDER = Path("runs/heightmap")
CHECKPOINT, MODEL = "heightmap.pt", "heightmap.onnx"
QUIET_S = 0.2
"""Before a progress bar is shown: what is wrong with an input is said by then, in one line."""


@dataclass(frozen=True, kw_only=True)
class SettingsCommand:
    """A command with `settings`, from flags, a TOML file,
    the run that goes on, and defaults, the former first.
    """

    settings: Any
    config: Annotated[Path | None, flag_help("PATH", "none")] = None
    """TOML file with the settings that are to be other ones."""

    def last(self) -> Any:
        """Settings of the run that goes on; None where none does."""
        return None

    def usual(self) -> Any:
        """Settings where nothing is given and no run goes on."""
        usual: Any = next(f.default_factory for f in fields(self) if f.name == "settings")
        return usual()

    def defaults(self) -> Self:
        """A copy of this command whose settings are those that its flags then change:
        of the run that goes on or the usual ones, and those of the file `config`.
        """
        before = self.last() or self.usual()
        return replace(self, settings=load_changes(before, self.config) if self.config else before)

    def print_differences(self) -> None:
        """Prints which settings are not those of the run that goes on, or not as by default."""
        last = self.last()
        what = "by default" if last is None else "of the run that goes on"
        pairs = setting_differences(asdict(last or self.usual()), asdict(self.settings))
        found = [f"{d.name} = {d.now} ({d.before})" for d in pairs]
        print(
            f"settings other than {what}: {', '.join(found)}" if found else f"settings as {what}",
            file=sys.stderr,
        )


@dataclass(frozen=True, kw_only=True)
class TrainHeightmap(SettingsCommand):
    """Trains the heightmap network on a dataset; the same command resumes it after an interruption.

    The settings can also stand in a TOML file (--config), those of the network as model.hidden =
    128. A flag wins over the file, the file over the training that goes on, or over the defaults.

    For example:
      saltus heightmap train --data runs/dataset
      saltus heightmap train --data runs/all --start models/heightmap.onnx --updates 9000 --batch 128
    """

    data: Path = Path("runs/dataset")
    """Folder of the dataset."""
    out: Path = FOLDER
    """Folder for heightmap.pt, written about once a minute and on Ctrl-C.

    One with another training is refused.
    """
    start: Annotated[Path | None, flag_help("PATH", "none: from nothing")] = None
    """Begin with the network of another checkpoint, at half the rate."""
    settings: Annotated[PredictorTraining, tyro.conf.arg(name="")] = field(
        default_factory=PredictorTraining
    )

    def last(self) -> PredictorTraining | None:
        """Settings of the training in `out`, which goes on; None if there is none."""
        if not (self.out / CHECKPOINT).exists():
            return None
        with packages_of("train"):
            from saltus.heightmap.training.train import checkpoint_settings

        return checkpoint_settings(self.out / CHECKPOINT)

    def usual(self) -> PredictorTraining:
        """A lower rate for a network that already predicts."""
        return PredictorTraining(learning_rate=FURTHER_RATE if self.start else FIRST_RATE)

    def run(self) -> int:
        """Trains, with a progress bar."""
        from tqdm import tqdm

        with packages_of("train"):
            from saltus.heightmap.training.train import train_heightmap

        checkpoint, announce = self.out / CHECKPOINT, cache(self.print_differences)
        with tqdm(total=self.settings.updates, unit="update", desc="train", delay=QUIET_S) as bar:

            def show(progress: "TrainingProgress") -> None:
                announce()
                bar.update(progress.update - bar.n)
                bar.set_postfix(loss=f"{progress.loss:.3f}", mae_cm=f"{100 * progress.mae_m:.2f}")
                if progress.calibrates:
                    bar.set_description("calibrate")

            written = _written_ns(checkpoint)
            try:
                train_heightmap(self.data, checkpoint, self.settings, show, start=self.start)
            except KeyboardInterrupt:
                bar.close()
                kept = (
                    "what was learned is"
                    if _written_ns(checkpoint) != written
                    else "nothing new is"
                )
                print(f"interrupted: {kept} in {checkpoint}", file=sys.stderr)
                raise
            announce()  # where all was done before
            bar.update(self.settings.updates - bar.n)
        print(checkpoint)
        return 0


def _written_ns(path: Path) -> int | None:
    """When a file was written; None where there is none."""
    return path.stat().st_mtime_ns if path.exists() else None


@dataclass(frozen=True, kw_only=True)
class ExportHeightmap:
    """Exports a checkpoint to ONNX, measures the file on held-out episodes, and writes its card.

    Example: saltus heightmap export --data runs/all --checkpoint runs/heightmap/heightmap.pt
    """

    data: Path = Path("runs/dataset")
    """Folder of the dataset that the checkpoint was trained on."""
    checkpoint: Path = FOLDER / CHECKPOINT
    """The checkpoint to export."""
    out: Path = FOLDER
    """Folder for heightmap.onnx, its checksum and its card."""
    unseen: Annotated[
        Path | None,
        flag_help("PATH", "of the tenth of --data that training held out up to 300 episodes"),
    ] = None
    """Dataset to measure on, of which nothing was trained on.

    Of --data only manifest.json is needed then.
    """

    def run(self) -> int:
        """Writes the files and prints what was measured."""
        with packages_of("train"):
            from saltus.heightmap.training.release import card_path, release_model

        if self.out.suffix:
            raise SaltusError(f"--out {self.out}: name a folder; {MODEL} is written into it")
        model = self.out / MODEL
        begun = partial(
            print, "exporting and measuring; a minute for 100 episodes", file=sys.stderr
        )
        result = release_model(self.checkpoint, self.data, model, self.unseen, begun)
        print(f"{model}  model {result.model_id}, warm after {result.warmup_frames} images")
        clean = result.clean
        print(
            f"    measured on {clean.ticks} ticks (10 ms each) of held-out runs; robots came to an "
            "edge in "
            f"{clean.uneven} of {clean.courses} off flat ground"
        )
        if clean.warning:
            print(f"    WARNING: {clean.warning}")
        for images, found in (
            ("images on time", result.clean),
            ("with jitter and losses", result.faulty),
        ):
            print(
                f"    {images}: {1e3 * found.mae_m:.1f} mm off, {100 * found.coverage90:.0f} % "
                "within the 90 % interval"
            )
        print(card_path(model))
        return 0
