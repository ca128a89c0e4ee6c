"""`saltus heightmap dagger` and `saltus heightmap dataset`: the data that predictors learn from."""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tqdm import tqdm
from tyro.conf import subcommand

from saltus.cli.output import print_json
from saltus.config import Camera, check_at_least

if TYPE_CHECKING:
    from saltus.heightmap.training.dagger import CollectionProgress
    from saltus.heightmap.training.train import Progress


@dataclass(frozen=True, kw_only=True)
class Dagger:
    """Rounds of: the predictor leads robots, and is trained on all that was collected. Goes on where it was stopped."""

    rounds: int = 3
    """In all; a run may go on for more."""
    out: Path = Path("runs/dagger")
    """Folder of the run: dataset, and a predictor for each round."""
    start: Path | None = None
    """Checkpoint of the predictor to begin with; without it round 0 sees true heights and trains from nothing."""
    base: Path | None = None
    """Dataset to train on as well."""
    episodes: int = 256
    """Robots that are led in a round, for 6 s each, a multiple of 32: falls and finishes make more episodes of them."""
    updates: int = 1500
    """Gradient steps in a round."""
    batch: int = 32
    """Windows in a gradient step."""
    hardest: float = 0.8
    """Courses go up to this difficulty."""
    learned: float = 0.5
    """Share of robots that the learned policy leads; the others are led by the scripted planner."""
    camera: Camera = "d435i"
    """Takes the images that are learned from. d435i: with the errors of a stereo camera. ideal: true depth."""
    seed: int = 0
    """Of all that is drawn."""
    processes: int | None = None
    """That collect; one for each core where it is not given. The data do not depend on it."""
    ray: str | None = None
    """Collect on a Ray cluster: its address, e.g. 10.0.0.1:6379, or "local" for one of this machine's cores."""

    def run(self) -> int:
        """Runs to the end, with a progress bar for each half of a round."""
        from saltus.heightmap.data.closed_loop import ClosedLoop
        from saltus.heightmap.training.dagger import DaggerConfig, Observer, dagger

        check_at_least(self, episodes=1)
        loop = ClosedLoop(hardest=self.hardest, learned=self.learned, camera=self.camera)
        config = DaggerConfig(
            rounds=self.rounds,
            batches=-(-self.episodes // loop.robots),
            updates=self.updates,
            batch=self.batch,
            seed=self.seed,
            loop=loop,
        )
        with _Bars(config.batches, self.updates) as bars:
            observer = Observer(collected=bars.collected, trained=bars.trained)
            model = dagger(
                self.out,
                config,
                observer,
                start=self.start,
                base=self.base,
                processes=self.processes,
                cluster=self.ray,
            )
        print(model)
        return 0


class _Bars:
    """One progress bar at a time: of a round's collection, then of its training."""

    def __init__(self, batches: int, updates: int) -> None:
        self._totals = {"collect": batches, "train": updates}
        self._bar: tqdm[None] | None = None
        self._name = ""

    def __enter__(self) -> "_Bars":
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def collected(self, progress: "CollectionProgress") -> None:
        """One more batch."""
        bar = self._at(progress.round, "collect", progress.batches)
        bar.set_postfix(steps=progress.ticks)

    def trained(self, index: int, progress: "Progress") -> None:
        """Some more updates."""
        bar = self._at(index, "train", progress.update)
        if progress.calibrates:
            bar.set_description(f"round {index} calibrate, export, measure")
        bar.set_postfix(loss=f"{progress.loss:.3f}", mae_cm=f"{100 * progress.mae_m:.2f}")

    def _at(self, index: int, half: str, done: int) -> "tqdm[None]":
        name = f"round {index} {half}"
        if self._bar is None or self._name != name:
            self.__exit__()
            self._bar, self._name = tqdm(total=self._totals[half], desc=name, file=sys.stderr), name
        self._bar.update(done - self._bar.n)
        return self._bar


@dataclass(frozen=True, kw_only=True)
class Info:
    """Says what a dataset holds."""

    data: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object on the last line."""

    def run(self) -> int:
        """Prints a line for each shard."""
        from saltus.heightmap.data.inventory import info

        found = info(self.data)
        if self.json:
            print_json(asdict(found))
            return 0
        for shard in found.shards:
            record = shard.record
            kinds = ", ".join(f"{count} {kind}" for kind, count in shard.terrains.items())
            print(f"{record.file}  {record.config.get('source', '?')}, seed {record.seed}, sha256 {record.sha256[:16]}")
            print(f"    {record.episodes} episodes, {record.ticks} ticks, {record.frames} images; {kinds}")
        episodes, ticks = (sum(getattr(s.record, name) for s in found.shards) for name in ("episodes", "ticks"))
        print(f"dataset {found.dataset}: {len(found.shards)} shards, {episodes} episodes, {ticks} ticks")
        return 0


@dataclass(frozen=True, kw_only=True)
class Validate:
    """Checks every shard of a dataset: its sha256, and shapes and values of its arrays."""

    data: tyro.conf.Positional[Path]
    """Folder of the dataset."""

    def run(self) -> int:
        """0 where all is sound, else 1."""
        from saltus.heightmap.data.inventory import validate

        damages = validate(self.data)
        for damage in damages:
            print(damage)
        print(f"{self.data}: " + (f"{len(damages)} damaged" if damages else "sound"))
        return 1 if damages else 0


@dataclass(frozen=True, kw_only=True)
class Merge:
    """Joins datasets into a new one."""

    data: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of the datasets."""
    out: Path
    """Folder to make."""

    def run(self) -> int:
        """Copies all shards."""
        from saltus.heightmap.data.inventory import merge

        records = merge(self.data, self.out)
        print(f"{self.out}: {len(records)} shards, {sum(record.ticks for record in records)} ticks")
        return 0


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """Datasets on disk: info, validate, merge."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[Info, subcommand("info")]
            | Annotated[Validate, subcommand("validate")]
            | Annotated[Merge, subcommand("merge")]
        ]
    ]

    def run(self) -> int:
        """Runs the chosen command."""
        return self.command.run()
