"""`saltus real2sim`: what the simulator lacks, found in run logs,
added to a profile, and shown to be gone.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from saltus.cli.heightmap_train import SettingsCommand
from saltus.cli.output import Bar, JsonOption, print_json, run_directory
from saltus.cli.run_options import RobotOption, mounted_camera
from saltus.config import load_config
from saltus.errors import ConfigError, RecordingError
from saltus.extras import packages_of
from saltus.flags import AT_LEAST_ONE, CommandGroup, Subcommands, flag_help
from saltus.folders import ask_for_room, new_folder
from saltus.grid import DEFAULT_GRID
from saltus.heightmap.settings import ClosedLoop
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.recordings.recording_description import BagTopics, RecordingDescription
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True, kw_only=True)
class Cycle(JsonOption, SettingsCommand):
    """Logs a robot, finds what the simulator lacks, trains with it,
    and measures the robot before and after.

    Goes on where it was stopped: a stage that is done is not repeated. Without a GPU the predictor
    alone is trained. The settings can also stand in a TOML file (--config). A flag wins over it,
    the file over the cycle that goes on.

    For example:
      saltus real2sim cycle --hidden examples/late_camera.toml --experiments heave_and_pitch --out runs/late
      saltus real2sim cycle --out runs/late --export-training to_gpu
      saltus real2sim cycle --out runs/late --take-training to_gpu
      saltus real2sim cycle --logs logs/monday runs/one --out runs/mine
    """

    out: Path = Path("runs/cycle")
    """Folder of the cycle, with report.html."""
    settings: Annotated[CycleSettings, tyro.conf.arg(name="")] = field(
        default_factory=lambda: CycleSettings(
            loop=ClosedLoop(robot=DEFAULT_ROBOT, grid=DEFAULT_GRID)
        )
    )
    export_training: Annotated[Path | None, flag_help("PATH", "none, train here")] = None
    """Folder to write for a machine with a GPU: profile, checkpoints,
    settings and commands, which make the data there; nothing is trained here."""
    take_training: Annotated[Path | None, flag_help("PATH", "none, train here")] = None
    """Such a folder with the models that were trained there."""

    def last(self) -> CycleSettings | None:
        """Settings of the cycle in `out`, which goes on; None if there is none."""
        from saltus.real2sim.cycle.folder import cycle_settings

        return cycle_settings(self.out)

    def run(self) -> int:
        """Runs what is still missing, and writes the report."""
        with packages_of("train"):
            from saltus.real2sim.cycle.cycle import CycleRun as Stages
            from saltus.real2sim.cycle.folder import open_folder
            from saltus.real2sim.cycle.remote_training import refuse_export
            from saltus.real2sim.cycle.report import cycle_results

        refuse_export(self.export_training, self.take_training)
        mounted_camera(self.settings.loop.camera, load_robot(self.settings.loop.robot))
        folder, settings = open_folder(self.out, self.settings)
        with Bar() as bar:
            Stages(folder=folder, settings=settings, observer=bar).run(
                self.export_training, self.take_training
            )
        print(folder.report)
        self.tell_json(cycle_results(folder))
        return 0


if TYPE_CHECKING:
    from saltus.real2sim.experiments.menu import Experiment
    from saltus.robots.robot import Robot

NEW_FOLDER = flag_help("PATH", "a new one under runs/")
LARGEST_LATENCY_S = 1.0


@dataclass(frozen=True, kw_only=True)
class Find(JsonOption):
    """Finds which effects the simulator lacks to explain run logs.

    Writes verdict.json, patch.toml and report.html.

    For example:
      saltus real2sim find logs/monday logs/tuesday
      saltus real2sim find logs/monday --profile mine --out runs/again
      saltus real2sim find logs/monday --no-report --json
      saltus real2sim find runs/one
    """

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], AT_LEAST_ONE]
    """Folders of run logs, or of runs of Saltus,
    whose logs are written into OUT/logs. Logs that claim the same rig are read as one."""
    out: Annotated[Path | None, NEW_FOLDER] = None
    """Folder for the results."""
    profile: str = "ideal"
    """Effects that the simulator has already: shipped (the robot's), ideal, one of your own, or a
    TOML file."""
    seed: int = 0
    """Seed of the bootstrap, which gives the intervals of the compared models."""
    report: bool = True
    """Write report.html, which takes two seconds more."""

    def run(self) -> int:
        """Prints what was found; 0, or 1 where a log contradicts itself,
        so that nothing could be looked for.
        """
        from saltus.api import find_effects
        from saltus.real2sim.reporting.verdict_text import verdict_lines

        directory = self.out or new_folder("real2sim")
        with Bar() as bar:
            judgement = find_effects(
                self.runs,
                directory,
                profile=self.profile,
                seed=self.seed,
                report=self.report,
                progress=bar.at,
            )
        for line in verdict_lines(judgement, directory):
            print(line)
        print(f"{directory}: verdict.json, patch.toml{', report.html' if self.report else ''}")
        self.tell_json(judgement.verdict.to_dict())
        return 1 if judgement.verdict.verdict == "bad_log" else 0


@dataclass(frozen=True, kw_only=True)
class Import:
    """Makes run logs of recordings of other forms.

    For example:
      saltus real2sim import runs/one --out logs/one
      saltus real2sim import bag --robot robots/mine --description mine.toml
      saltus real2sim import bag --topics.joints /joint_states --topics.commands /joint_commands
      saltus real2sim import mine.csv --description mine.toml --out logs/mine
    """

    recording: tyro.conf.Positional[Path]
    """Folder or recording.mcap of a run of Saltus; folder or file of a rosbag2;
    a ROS 1 bag; or a table of joints: text with any separator, Parquet or npz."""
    description: Annotated[Path | None, flag_help("PATH", "none")] = None
    """TOML that says what a bag or a table does not say of itself (docs/tutorials/log.md)."""
    robot: str = DEFAULT_ROBOT
    """Robot of a bag or a table: name, or path of an MJCF or of a folder with a robot.toml."""
    topics: BagTopics = field(default_factory=BagTopics)
    """Topics of a bag. One that is named here takes the place of the description's."""
    out: Annotated[Path | None, NEW_FOLDER] = None
    """Folder of the log; or of several, one for each leg or for each log in an archive."""

    def run(self) -> int:
        """Writes the logs and says where they are, and what is not in them."""
        from saltus.real2sim.importers.importing import import_recording
        from saltus.recordings.run_log_export import as_run_log, is_run

        if not self.recording.exists():
            raise RecordingError(f"cannot read {self.recording}: there is no such file")
        directory = self.out or new_folder("real2sim-import")
        if is_run(self.recording):
            print(as_run_log(self.recording, directory))
            return 0
        description = (
            load_config(RecordingDescription, self.description)
            if self.description is not None
            else RecordingDescription()
        )
        given = {part: topic for part, topic in vars(self.topics).items() if topic is not None}
        description = replace(description, topics=replace(description.topics, **given))
        imported = import_recording(self.recording, directory, description, load_robot(self.robot))
        if self.robot == DEFAULT_ROBOT:
            print(f"note: read as a log of a {self.robot}; --robot names another")
        for note in imported.notes:
            print(f"note: {note}")
        for log in imported.logs:
            print(log)
        return 0


@dataclass(frozen=True, kw_only=True)
class Apply(RobotOption, JsonOption):
    """Adds the effects of a patch to a profile of your own,
    which other commands then take with --profile.

    For example:
      saltus real2sim apply runs/found/patch.toml --profile mine
      saltus real2sim apply runs/found/patch.toml --profile mine --base shipped
    """

    patch: tyro.conf.Positional[Path]
    """File patch.toml, as `saltus real2sim find` writes it."""
    profile: Annotated[str, tyro.conf.arg(metavar="NAME")]
    """Name of the profile, written to profiles/NAME.toml.

    If there is one of this name, the patch is put into it.
    """
    base: str = "ideal"
    """Profile to begin with if there is none of this name yet: shipped (the robot's), ideal,
    one of your own, or a TOML file. Shipped keeps the effects that your logs cannot show."""

    def run(self) -> int:
        """Writes profiles/NAME.toml."""
        from saltus.effects.profile import SHIPPED, load_profile, profiles_folder, save_profile
        from saltus.real2sim.patch import load_patch

        patch, robot = load_patch(self.patch), load_robot(self.robot)
        exists = (profiles_folder() / f"{self.profile}.toml").is_file()
        before = load_profile(self.profile if exists else self.base, robot)
        after = patch.applied_to(before, robot)
        path = save_profile(self.profile, after)
        # One may be found at several joints
        names = dict.fromkeys(effect.name for effect in patch.effects)
        updated = [name for name in names if name in before.effects]
        added = [name for name in names if name not in updated]
        lacks = [name for name in load_profile(SHIPPED, robot).effects if name not in after.effects]
        if self.json:
            print_json(
                {
                    "profile": self.profile,
                    "file": str(path),
                    "added": added,
                    "updated": updated,
                    "lacks": lacks,
                }
            )
            return 0
        done = [
            f"{', '.join(some)} {word}"
            for some, word in ((added, "added"), (updated, "updated"))
            if some
        ]
        became = "; ".join(done) or "nothing added: the patch names no effect"
        print(f"{path}: {self.profile if exists else self.base} with {became}")
        if lacks:
            print(f"not in it, of the robot's shipped profile: {', '.join(lacks)}")
            print("a new profile that you begin with --base shipped keeps them")
        print(f"run it with: saltus demo --profile {self.profile}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Experiments(RobotOption, JsonOption):
    """Lists motions that make effects visible,
    or runs one on the simulated robot and writes a run log.

    For example:
      saltus real2sim experiments
      saltus real2sim experiments --run joint_tour --profile mine --out runs/tour
      saltus real2sim experiments --run squat --robot robots/mine --profile ideal
    """

    run_: Annotated[
        str | None,
        tyro.conf.arg(
            name="run", metavar="NAME", help_behavior_hint="(default: none, print the list)"
        ),
    ] = None
    """Name of an experiment to run."""
    profile: str = "shipped"
    """Effects of the robot's hardware: shipped (the robot's), ideal, one of your own, or a TOML
    file."""
    camera_latency: float = 0.05
    """Latency that the log claims of the camera [s], 0 to 1; for experiments with a camera."""
    seed: int = 0
    """Seed of the sensors' noise and of what effects draw."""
    out: Annotated[Path | None, NEW_FOLDER] = None
    """Folder of the run log; one that holds a log already is refused."""

    def run(self) -> int:
        """Runs the experiment; without one, prints the table."""
        from saltus.real2sim.experiments.menu import EXPERIMENTS, experiment_named

        if self.run_ is None:
            return self._table(load_robot(self.robot), tuple(EXPERIMENTS.values()))
        return self._run(experiment_named(self.run_))

    def _table(self, robot: "Robot", experiments: "tuple[Experiment, ...]") -> int:
        if self.json:
            print_json(
                {"experiments": [_described(experiment, robot) for experiment in experiments]}
            )
            return 0
        for experiment in experiments:
            base = "held in the air" if experiment.base == "fixed" else "on the ground"
            print(
                f"{experiment.name:20} {experiment.duration_s(robot):4.0f} s, {base}: "
                f"{experiment.how}"
            )
            print(f"{'':20} shows {', '.join(experiment.shows)}")
            print(f"{'':20} {experiment.limits.in_words()}")
        return 0

    def _run(self, experiment: "Experiment") -> int:
        from saltus.effects.profile import load_profile
        from saltus.real2sim.experiments.footage import FootageCamera
        from saltus.real2sim.experiments.run import run_experiment
        from saltus.recordings.run_log import refuse_run_log, write_run_log

        if not 0.0 <= self.camera_latency <= LARGEST_LATENCY_S:
            raise ConfigError(
                f"--camera-latency {self.camera_latency}: allowed is 0 to {LARGEST_LATENCY_S:g} s"
            )
        robot = load_robot(self.robot)
        profile = load_profile(self.profile, robot)
        directory = self.out or new_folder(experiment.name)
        refuse_run_log(directory)
        ask_for_room(directory)
        log = run_experiment(
            experiment,
            robot,
            profile,
            seed=self.seed,
            camera=FootageCamera.on(robot, self.camera_latency),
        )
        write_run_log(log, directory, robot)
        seconds = float(log.joints.time_s[-1] - log.joints.time_s[0])
        if self.json:
            print_json({"log": str(directory), "experiment": experiment.name, "seconds": seconds})
        else:
            print(f"{directory}: {seconds:.0f} s of {experiment.name}")
        return 0


def _described(experiment: "Experiment", robot: "Robot") -> dict[str, object]:
    return {
        "name": experiment.name,
        "how": experiment.how,
        "shows": list(experiment.shows),
        "base": experiment.base,
        "camera": experiment.camera,
        "payload_kg": experiment.payload_kg,
        "duration_s": experiment.duration_s(robot),
        "limits": vars(experiment.limits),
    }


@dataclass(frozen=True, kw_only=True)
class Real2simDemo(RobotOption, JsonOption):
    """Hides an effect in a simulated robot, finds it in a log,
    adds it to the simulator and looks again.

    Example: saltus real2sim demo --seed 3
    """

    seed: int = 0
    """Decides which effect is hidden, where and how large it is."""
    out: Annotated[Path | None, NEW_FOLDER] = None
    """Folder for logs, verdicts, patch and profile."""

    def run(self) -> int:
        """0 where what was hidden was found and the second look finds no gap, else 1."""
        from saltus.real2sim.demonstration import demonstrate
        from saltus.real2sim.reporting.verdict_text import verdict_sentence

        directory = run_directory("real2sim-demo", self.out)
        with Bar() as bar:
            shown = demonstrate(load_robot(self.robot), directory, seed=self.seed, progress=bar.at)
        print(f"hidden:\n{shown.hidden.to_toml()}")
        print(f"found: {verdict_sentence(shown.found.verdict)}")
        print(f"with the patch: {verdict_sentence(shown.again.verdict, shown.profile)}")
        print(f"{directory}: logs, found, again (each with report.html), profile.toml")
        self.tell_json(
            {
                "hidden": [effect.name for effect in shown.hidden.actuator],
                "found": shown.found.verdict.to_dict(),
                "again": shown.again.verdict.to_dict(),
                "profile": str(directory / "profile.toml"),
            }
        )
        names = {effect.name for effect in shown.found.verdict.effects}
        is_found = names == {effect.name for effect in shown.hidden.actuator}
        return 0 if is_found and shown.again.verdict.verdict == "no_gap" else 1


@dataclass(frozen=True, kw_only=True)
class Real2simCommands(CommandGroup):
    """The effects that a simulator lacks: find and apply them, run experiments, train with them."""

    command: Subcommands[
        Find
        | Import
        | Apply
        | Experiments
        | Annotated[Real2simDemo, tyro.conf.subcommand("demo")]
        | Cycle
    ]
