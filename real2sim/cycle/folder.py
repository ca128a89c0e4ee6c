"""The folder of a cycle: where each stage leaves its results.

A stage whose results are there is not repeated.
"""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from saltus.config import load_config, to_toml
from saltus.effects.heightmap_shift import refuse_shift
from saltus.effects.profile import Profile, load_profile
from saltus.errors import ConfigError
from saltus.folders import ask_for_room, setting_differences
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.used_networks import ModelKind

SETTINGS = "cycle.toml"
MODELS: tuple[ModelKind, ...] = ("heightmap", "policy")


@dataclass(frozen=True)
class CycleFolder:
    """Names of the files in a cycle's folder."""

    root: Path
    robot: Robot
    """Robot whose models are trained."""

    @property
    def settings(self) -> Path:
        """How it was begun."""
        return self.root / SETTINGS

    @property
    def hidden(self) -> Path:
        """Profile of the hidden robot; not there where none is known."""
        return self.root / "hidden.toml"

    @property
    def known(self) -> Path:
        """Profile of what was known before."""
        return self.root / "known.toml"

    @property
    def logs(self) -> Path:
        """A folder for each run log."""
        return self.root / "logs"

    @property
    def found(self) -> Path:
        """Results of the search with what was known."""
        return self.root / "found"

    @property
    def again(self) -> Path:
        """Results of the search with what was found; not there where nothing was."""
        return self.root / "again"

    @property
    def profile(self) -> Path:
        """File of the profile with what was known and found: the last that the search writes."""
        return self.root / "profile.toml"

    @property
    def dataset(self) -> Path:
        """Training data of robots with that profile."""
        return self.root / "dataset"

    @property
    def predictor(self) -> Path:
        """The new predictor's folder."""
        return self.root / "heightmap"

    @property
    def policy(self) -> Path:
        """The new policy's folder."""
        return self.root / "policy"

    @property
    def trained(self) -> Path:
        """File on what became of each model (JSON): the last that training writes."""
        return self.root / "trained.json"

    @property
    def choice(self) -> Path:
        """How simulated robots did with the trained models and with the shipped ones (JSON)."""
        return self.root / "choice.json"

    @property
    def measured(self) -> Path:
        """A file for each course and for each pair of models."""
        return self.root / "measured"

    @property
    def report(self) -> Path:
        """The story."""
        return self.root / "report.html"

    def model(self, kind: ModelKind) -> Path | None:
        """The new ONNX file; None where it was not trained."""
        path = self.root / kind / f"{kind}.onnx"
        return path if path.exists() else None

    def read(self, path: Path) -> Profile:
        """One of the folder's profiles."""
        return load_profile(str(path), self.robot)


def open_folder(root: Path, given: CycleSettings) -> tuple[CycleFolder, CycleSettings]:
    """Makes the folder of a cycle, or opens the one that goes on.

    Raises:
        ConfigError: there is neither a robot nor a log, or a profile cannot be read.
        SaltusError: the folder cannot be written into, or was begun with other settings or
            profiles.
    """
    folder = CycleFolder(root, load_robot(given.loop.robot))
    if given.hidden is None and not given.logs:
        raise ConfigError(
            "nothing to look at: name the robot's profile with --hidden, or run logs with --logs"
        )
    missing = [str(log) for log in given.logs if not log.exists()]
    if missing:
        raise ConfigError(f"logs = {missing[0]}: there is no such folder")
    begun = folder.settings.exists()
    names = {folder.known: given.profile} | (
        {folder.hidden: str(given.hidden)} if given.hidden is not None else {}
    )
    profiles = (
        {} if begun else {path: load_profile(name, folder.robot) for path, name in names.items()}
    )
    for profile in profiles.values():
        refuse_shift(profile.heightmap, "a robot that sees with a camera")
    texts = {path: profile.to_toml() for path, profile in profiles.items()}
    settings = replace(
        given,
        hidden=None if given.hidden is None else given.hidden.absolute(),
        logs=tuple(log.absolute() for log in given.logs),
    )
    if begun:
        _compare(folder, settings)
    ask_for_room(root)
    for path, text in (texts | {folder.settings: to_toml(settings)}).items():
        path.write_text(text, encoding="utf-8")
    return folder, settings


def cycle_settings(root: Path) -> CycleSettings | None:
    """How the cycle in a folder was begun; None where there is none."""
    path = root / SETTINGS
    return load_config(CycleSettings, path) if path.exists() else None


def _compare(folder: CycleFolder, settings: CycleSettings) -> None:
    """Refuses to go on with a cycle that was begun in another way."""
    before = load_config(CycleSettings, folder.settings)
    for d in setting_differences(
        asdict(before),
        asdict(replace(settings, trials=before.trials, choice_trials=before.choice_trials)),
    ):
        raise ConfigError(
            f"{folder.settings}: this cycle was begun with {d.name} = {d.before}, not {d.now}: "
            "name another with --out"
        )
