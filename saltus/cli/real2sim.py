"""`saltus real2sim`: what the simulator lacks, found in run logs, added to a profile, and shown to be gone."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import subcommand

from saltus.cli.output import print_json, run_directory
from saltus.errors import ConfigError

if TYPE_CHECKING:
    from real2sim.menu import Experiment

Json = Annotated[bool, tyro.conf.FlagCreatePairsOff]


@dataclass(frozen=True, kw_only=True)
class Apply:
    """Adds the effects of a patch to a profile of your own, which every command then takes with --profile."""

    patch: tyro.conf.Positional[Path]
    """patch.toml, as `saltus real2sim find` writes it."""
    profile: str
    """Name of the profile; where there is one of this name, the patch is added to it."""
    base: str = "ideal"
    """Profile to begin with where there is none of this name: ideal, go1, or one of your own."""
    json: Json = False
    """Print one JSON object on the last line."""

    def run(self) -> int:
        """Writes profiles/NAME.toml."""
        from real2sim.patch import load_patch
        from saltus.effects.profile import load_profile, profiles_folder, save_profile

        patch = load_patch(self.patch)
        exists = (profiles_folder() / f"{self.profile}.toml").is_file()
        before = load_profile(self.profile if exists else self.base)
        path = save_profile(self.profile, patch.applied_to(before))
        names = [effect.name for effect in patch.effects]
        if self.json:
            print_json({"profile": self.profile, "file": str(path), "added": names})
            return 0
        print(f"{path}: {', '.join(names) or 'nothing'} added to {self.profile if exists else self.base}")
        print(f"run it with: saltus up --profile {self.profile}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Experiments:
    """Lists motions that make effects visible, or runs one on the simulated robot and writes a run log."""

    list: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Say what there is; so does the command without anything."""
    run_: Annotated[str | None, tyro.conf.arg(name="run")] = None
    """Name of an experiment to run."""
    profile: str = "go1"
    """Effects of the robot's hardware: ideal, go1, one of your own, or a TOML file."""
    camera_latency: float = 0.05
    """Latency that is claimed of the camera [s]."""
    seed: int = 0
    """Of the sensors' noise."""
    out: Path | None = None
    """Folder of the run log; a new one under runs/ where it is not given."""
    json: Json = False
    """Print one JSON object on the last line."""

    def run(self) -> int:
        """Runs the experiment; without one, prints the table."""
        from real2sim.menu import EXPERIMENTS, experiment_named

        if self.run_ is not None and self.list:
            raise ConfigError("--list and --run exclude each other")
        if self.run_ is None:
            return self._table(tuple(EXPERIMENTS.values()))
        return self._run(experiment_named(self.run_))

    def _table(self, experiments: "tuple[Experiment, ...]") -> int:
        if self.json:
            print_json({"experiments": [_described(experiment) for experiment in experiments]})
            return 0
        for experiment in experiments:
            base = "held in the air" if experiment.base == "fixed" else "on the ground"
            print(f"{experiment.name:20} {experiment.duration_s:4.0f} s, {base}: {experiment.how}")
            print(f"{'':20} shows {', '.join(experiment.shows)}")
            print(f"{'':20} {experiment.limits.in_words()}")
        return 0

    def _run(self, experiment: "Experiment") -> int:
        from real2sim.experiments import run
        from real2sim.footage import Camera
        from saltus.effects.profile import load_profile
        from saltus.run_log import write_run_log

        profile = load_profile(self.profile)
        directory = run_directory(experiment.name, self.out)
        log = run(experiment, profile, seed=self.seed, camera=Camera(latency_s=self.camera_latency))
        write_run_log(log, directory)
        seconds = float(log.joints.time_s[-1] - log.joints.time_s[0])
        if self.json:
            print_json({"log": str(directory), "experiment": experiment.name, "seconds": seconds})
        else:
            print(f"{directory}: {seconds:.0f} s of {experiment.name}")
        return 0


def _described(experiment: "Experiment") -> dict[str, object]:
    return {
        "name": experiment.name,
        "how": experiment.how,
        "shows": list(experiment.shows),
        "base": experiment.base,
        "camera": experiment.camera,
        "payload_kg": experiment.payload_kg,
        "duration_s": experiment.duration_s,
        "limits": vars(experiment.limits),
    }


@dataclass(frozen=True, kw_only=True)
class Real2sim:
    """What the simulator lacks: find it in logs, apply it, run experiments that show it."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[Apply, subcommand("apply")] | Annotated[Experiments, subcommand("experiments")]
        ]
    ]

    def run(self) -> int:
        """Runs the chosen command."""
        return self.command.run()
