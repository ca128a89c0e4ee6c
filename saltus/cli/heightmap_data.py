"""`saltus heightmap collect`, `dagger` and `dataset`: the data that predictors learn from."""

import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

import tyro
from tyro.conf import subcommand

from saltus.cli.heightmap_train import QUIET_S, SettingsCommand
from saltus.cli.output import Bar, JsonOption, print_json
from saltus.cli.run_options import mounted_camera
from saltus.effects.heightmap_shift import refuse_shift
from saltus.effects.profile import SHIPPED, load_profile
from saltus.extras import packages_of
from saltus.flags import AT_LEAST_ONE, CommandGroup, Subcommands, flag_help
from saltus.grid import DEFAULT_GRID
from saltus.heightmap.settings import (
    ClosedLoop,
    DaggerSettings,
    DeviceCollection,
    DeviceLoop,
    ProcessorCollection,
)
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.workers import check_processes

if TYPE_CHECKING:
    from saltus.heightmap.data.collecting import CollectionResult
    from saltus.heightmap.device_collection import DeviceSpeed
    from saltus.heightmap.training.train import TrainingProgress

DATASET = Path("runs/dataset")


@dataclass(frozen=True, kw_only=True)
class WorkersOption:
    """Flags of a command that collects on processors."""

    processes: Annotated[int | None, flag_help("INT", "one for each core")] = None
    """Number of processes that collect. The data do not depend on it."""


@dataclass(frozen=True, kw_only=True)
class OnProcessors(WorkersOption, SettingsCommand):
    """Episodes of both planners in MuJoCo on this computer's processors.

    The settings can also stand in a TOML file (--config), those of the loop as loop.hardest = 0.5.
    A flag wins over it.

    For example:
      saltus heightmap collect cpu --batches 4 --out runs/dataset
      saltus heightmap collect cpu --model models/heightmap.onnx --loop.learned 1 --seed 1
    """

    out: Path = DATASET
    """Folder of the dataset; it is made, or a shard is added to it."""
    settings: Annotated[ProcessorCollection, tyro.conf.arg(name="")] = field(
        default_factory=lambda: ProcessorCollection(
            loop=ClosedLoop(robot=DEFAULT_ROBOT, grid=DEFAULT_GRID)
        )
    )

    def run(self) -> int:
        """Writes the shard; of one that is interrupted the batches that are whole."""
        with packages_of("train"):
            from saltus.heightmap.collection import collect_shard

        profile = load_profile(self.settings.profile, load_robot(self.settings.loop.robot))
        if self.settings.model is not None:
            refuse_shift(profile.heightmap, "a predictor")
        mounted_camera(self.settings.loop.camera, load_robot(self.settings.loop.robot))
        check_processes(self.processes)
        total = self.settings.batches * self.settings.loop.ticks
        with _CollectionBar(self, total) as progress:

            def done(steps: int) -> None:
                progress.bar.set_postfix(steps=steps)

            found = collect_shard(
                self.settings,
                self.out,
                done,
                processes=self.processes,
                listener=progress.tick,
            )
        return _tell([self.out], found)


@dataclass(frozen=True, kw_only=True)
class OnDevice(JsonOption, SettingsCommand):
    """Episodes of thousands of robots at once on a GPU; falls and finishes make more of them.

    The settings can also stand in a TOML file (--config), those of the loop as loop.ticks = 300. A
    flag wins over it.

    For example:
      saltus heightmap collect gpu --episodes 16384 --predictor models/heightmap.onnx
      saltus heightmap collect gpu --loop.learned 0.75 --loop.cameras d435i ideal
    """

    out: Path = DATASET
    """Folder of the dataset; it is made, or a shard is added to it.

    A second camera's images go to OUT-ideal.
    """
    settings: Annotated[DeviceCollection, tyro.conf.arg(name="")] = field(
        default_factory=lambda: DeviceCollection(
            loop=DeviceLoop(robot=DEFAULT_ROBOT, grid=DEFAULT_GRID)
        )
    )
    commit: Annotated[str | None, flag_help("STR", "as git says")] = None
    """Which code collects, where this machine has no repository."""

    def run(self) -> int:
        """Writes the shards; of those that are interrupted the batches that are whole."""
        with packages_of("train"):
            from saltus.heightmap.device_collection import collect_shards_on_device

        loop, speeds, robot = (
            self.settings.loop,
            list["DeviceSpeed"](),
            load_robot(self.settings.loop.robot),
        )
        load_profile(self.settings.profile or SHIPPED, robot)
        names = [mounted_camera(camera, robot)[0].name for camera in loop.cameras]
        outputs = {
            camera: self.out.with_name(f"{self.out.name}-{names[number]}") if number else self.out
            for number, camera in enumerate(loop.cameras)
        }
        with _CollectionBar(self, self.settings.batches * loop.ticks) as progress:

            def done(speed: "DeviceSpeed", crowded: float) -> None:
                speeds.append(speed)
                progress.bar.set_postfix(speed.table, crowded=f"{100 * crowded:.2f} %")

            found = collect_shards_on_device(
                self.settings, outputs, progress.tick, done, self.commit
            )
        _tell(outputs.values(), found)
        self.tell_json(speeds[-1].table)
        return 0


@dataclass(frozen=True, kw_only=True)
class CollectCommands(CommandGroup):
    """Adds a shard of labelled episodes to a dataset, made on processors or on a GPU.

    Ctrl-C keeps what was collected by then.
    """

    command: Subcommands[
        Annotated[OnProcessors, subcommand("cpu")] | Annotated[OnDevice, subcommand("gpu")]
    ]


class _CollectionBar:
    """Progress of a collection in ticks; before it begins it says what is not as by default."""

    def __init__(self, command: SettingsCommand, ticks: int) -> None:
        from tqdm import tqdm

        self.bar = tqdm(total=ticks, unit="tick", desc="collect", delay=QUIET_S)
        self._begin = cache(command.print_differences)

    def tick(self, ticks: float = 1) -> None:
        """So many more."""
        self._begin()
        self.bar.update(ticks)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.bar.close()
        if kind is KeyboardInterrupt:
            print("interrupted: no batch was whole yet, nothing is kept", file=sys.stderr)


def _tell(folders: "Iterable[Path]", found: "CollectionResult") -> int:
    """Names the shards; raises `KeyboardInterrupt` for an interrupted collection."""
    for folder, record in zip(folders, found.records, strict=True):
        print(
            f"{folder / record.file}: {record.episodes} episodes, {record.ticks} steps, sha256 "
            f"{record.sha256[:16]}"
        )
    if not found.whole:
        print(
            "interrupted: what was collected is kept; collect the rest with another --seed",
            file=sys.stderr,
        )
        raise KeyboardInterrupt
    return 0


@dataclass(frozen=True, kw_only=True)
class Dagger(WorkersOption, SettingsCommand):
    """Rounds of: the predictor drives robots, and is trained on all that was collected.

    Goes on where it was stopped.

    The settings can also stand in a TOML file (--config), those of the loop as loop.hardest = 0.5.
    A flag wins over the file, the file over the run that goes on, or over the defaults.

    For example:
      saltus heightmap dagger --rounds 3 --out runs/dagger
      saltus heightmap dagger --start models/heightmap.onnx --base runs/dataset --out runs/further
    """

    out: Path = Path("runs/dagger")
    """Folder of the run: dataset, and a predictor for each round."""
    start: Annotated[
        Path | None, flag_help("PATH", "none: round 0 sees true heights and trains from nothing")
    ] = None
    """Checkpoint of the predictor to begin with."""
    base: Annotated[Path | None, flag_help("PATH", "none")] = None
    """Dataset to train on as well."""
    settings: Annotated[DaggerSettings, tyro.conf.arg(name="")] = field(
        default_factory=lambda: DaggerSettings(
            loop=ClosedLoop(robot=DEFAULT_ROBOT, grid=DEFAULT_GRID)
        )
    )

    def run(self) -> int:
        """Runs to the end, with a progress bar for each half of a round."""
        with packages_of("train"):
            from saltus.heightmap.training.dagger import Observer, run_dagger

        check_processes(self.processes)
        mounted_camera(self.settings.loop.camera, load_robot(self.settings.loop.robot))
        refuse_shift(
            load_profile(self.settings.profile, load_robot(self.settings.loop.robot)).heightmap,
            "a predictor",
        )
        begin = cache(self.print_differences)
        with Bar() as bar:

            def collected(index: int, batches: int, ticks: int) -> None:
                begin()
                bar.at(f"round {index} collect, {ticks} steps", batches / self.settings.batches)

            def trained(index: int, progress: "TrainingProgress") -> None:
                begin()
                half = "calibrate" if progress.calibrates else f"train, loss {progress.loss:.3f}"
                bar.at(f"round {index} {half}", progress.update / self.settings.updates)

            model = run_dagger(
                self.out, self.settings, Observer(collected=collected, trained=trained),
                start=self.start,
                base=self.base, processes=self.processes,
            )  # fmt: skip
        print(model)
        return 0

    def last(self) -> DaggerSettings | None:
        """Settings of the run in `out`, which goes on; None if there is none."""
        if not (self.out / "dagger.json").exists():
            return None
        with packages_of("train"):
            from saltus.heightmap.training.dagger import begun_settings

        return begun_settings(self.out)


@dataclass(frozen=True, kw_only=True)
class Info(JsonOption):
    """Says what a dataset holds.

    Example: saltus heightmap dataset info runs/dataset
    """

    data: tyro.conf.Positional[Path]
    """Folder of the dataset."""

    def run(self) -> int:
        """Prints a line for each shard."""
        from saltus.heightmap.data.inventory import dataset_info

        found = dataset_info(self.data)
        if self.json:
            print_json(asdict(found))
            return 0
        for shard in found.shards:
            record = shard.record
            kinds = ", ".join(f"{count} {kind}" for kind, count in shard.terrains.items())
            print(
                f"{record.file}  {record.config.get('source', '?')}, seed {record.seed}, sha256 "
                f"{record.sha256[:16]}"
            )
            print(
                f"    {record.episodes} episodes, {record.ticks} ticks, {record.frames} images; "
                f"{kinds}"
            )
            print(f"    camera {shard.camera}")
        episodes, ticks = (
            sum(getattr(s.record, name) for s in found.shards) for name in ("episodes", "ticks")
        )
        print(
            f"dataset {found.dataset}: {len(found.shards)} shards, {episodes} episodes, {ticks} "
            "ticks"
        )
        return 0


@dataclass(frozen=True, kw_only=True)
class Validate:
    """Checks every shard of a dataset: its sha256, and shapes and values of its arrays.

    Example: saltus heightmap dataset validate runs/dataset
    """

    data: tyro.conf.Positional[Path]
    """Folder of the dataset."""

    def run(self) -> int:
        """0 where all is sound, else 1."""
        from saltus.heightmap.data.inventory import validate_dataset

        damages = validate_dataset(self.data)
        for damage in damages:
            print(damage)
        print(f"{self.data}: " + (f"{len(damages)} damaged" if damages else "sound"))
        return 1 if damages else 0


@dataclass(frozen=True, kw_only=True)
class Merge:
    """Joins datasets into a new one.

    Example: saltus heightmap dataset merge runs/first runs/second --out runs/all
    """

    data: Annotated[tyro.conf.Positional[tuple[Path, ...]], AT_LEAST_ONE]
    """Folders of the datasets."""
    out: Path
    """Folder to make."""

    def run(self) -> int:
        """Copies all shards."""
        from saltus.heightmap.data.inventory import merge_datasets

        records = merge_datasets(self.data, self.out)
        print(f"{self.out}: {len(records)} shards, {sum(record.ticks for record in records)} ticks")
        return 0


@dataclass(frozen=True, kw_only=True)
class ExportDataset:
    """Writes a dataset in a form that others read:
    a LeRobot dataset (v3.0) of plain Parquet, described in Croissant.

    Example: saltus heightmap dataset export runs/dataset --out runs/exported
    """

    data: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    out: Path
    """Folder to make: data/ (Parquet), meta/ (LeRobot) and croissant.json."""

    def run(self) -> int:
        """Writes all of it."""
        from tqdm import tqdm

        from saltus.heightmap.data.export import export_dataset
        from saltus.heightmap.data.shards import read_records

        total = sum(record.ticks for record in read_records(self.data))
        with tqdm(total=total, unit="tick", desc="export", delay=QUIET_S) as bar:
            found = export_dataset(self.data, self.out, bar.update)
        print(
            f"{self.out}: {found.episodes} episodes, {found.ticks} ticks on "
            f"{', '.join(found.terrains)}"
        )
        return 0


@dataclass(frozen=True, kw_only=True)
class DatasetCommands(CommandGroup):
    """Datasets on disk: info, validate, merge, export."""

    command: Subcommands[Info | Validate | Merge | Annotated[ExportDataset, subcommand("export")]]
