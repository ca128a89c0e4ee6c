"""Worth of pyrender's images in the training of the heightmap network, beside Embree's.

Both render the images of the same motion, from the same cameras, which make the same errors of
them. Networks are trained from nothing on either, one a seed, and then shown the images of both on
motion that none was trained on, as is the shipped network: mean absolute errors in millimetres,
over all seeds and of each.

The folder keeps data and checkpoints, and a run that was stopped goes on; runs with different seeds
may go on side by side once the data are there.

    OMP_NUM_THREADS=1 saltus bench renderers -- --out runs/renderers
"""

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks._command import Command, progress, tell
from benchmarks.realism import LEARNED, ROBOT, check_twins, exported
from saltus.heightmap.collection import closed_loop_batches, round_table
from saltus.heightmap.data.delivery import TRAINING
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.shards import read_dataset, read_manifest, write_shard
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.settings import BackEndName, ClosedLoop, ModelSettings, PredictorTraining
from saltus.heightmap.training.train import train_heightmap
from saltus.heightmap.training.validate import height_accuracy
from saltus.resources import shipped_file

RENDERERS: tuple[BackEndName, ...] = ("embree", "pyrender")
DATA_SEEDS = {"fitted": 4031, "held-out": 4032}
SIZES = {
    "small": ModelSettings(channels=(4, 8, 8), hidden=64, head=(64,)),
    "shipped": ModelSettings(),
}
HELD_OUT_SHARE = 0.25  # as many batches of what is held out for each that is trained on


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    out: Path = Path("runs/renderers")
    """Folder of data and networks."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds of weights and windows: two networks each."""
    size: Literal["small", "shipped"] = "small"
    """Size of the networks: a third of the work of the shipped one, or all of it."""
    updates: int = 500
    """Updates of `batch` windows."""
    batch: int = 16
    """Robots in an update."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Device that trains."""
    batches: int = 8
    """To train on, each of 32 robots for 6 s."""

    def measure(self) -> dict[str, Any]:
        """Collects, trains, measures."""
        for use, seed in DATA_SEEDS.items():
            for renderer in RENDERERS:
                self._collect(renderer, use, seed)
        shown = {renderer: read_dataset(self._data(renderer, "held-out")) for renderer in RENDERERS}
        check_twins(shown["embree"], shown["pyrender"])
        errors = {
            trained_on: [self._errors_mm(trained_on, seed, shown) for seed in self.seeds]
            for trained_on in RENDERERS
        }
        mean = {
            name: float(np.mean([list(found.values()) for found in each]))
            for name, each in errors.items()
        }
        return {
            "size": self.size,
            "updates": self.updates,
            "batch": self.batch,
            "trained on": errors,
            "mean_mm": mean,
            "shipped": errors_mm(shipped_file("models/heightmap.onnx"), shown),
            "pyrender over embree": mean["pyrender"] / mean["embree"],
        }

    def _data(self, renderer: str, use: str) -> Path:
        return self.out / f"{use}-{renderer}"

    def _collect(self, renderer: BackEndName, use: str, seed: int) -> None:
        """Makes a dataset unless it is there."""
        if read_manifest(self._data(renderer, use)):
            return
        batches = self.batches if use == "fitted" else max(1, round(HELD_OUT_SHARE * self.batches))
        loop = ClosedLoop(robot="go1", grid="line", learned=LEARNED, renderer=renderer)
        keys = [(seed, 0, batch) for batch in range(batches)]
        with closing(closed_loop_batches(loop, None, keys)) as made:
            episodes = (
                episode
                for batch in progress(made, f"{use}, {renderer}", batches)
                for episode in batch
            )
            write_shard(
                self._data(renderer, use),
                episodes,
                seed=seed,
                config=round_table(loop, batches, 0, None),
            )

    def _errors_mm(
        self, trained_on: BackEndName, seed: int, shown: dict[BackEndName, list[Episode]]
    ) -> dict[str, float]:
        """Trains a network unless it is there; its errors with the images of each renderer."""
        folder = self.out / f"{trained_on}-{self.size}-{seed}"
        size = SIZES[self.size]
        config = PredictorTraining(
            updates=self.updates,
            batch=self.batch,
            forgets=0.0,
            seed=seed,
            device=self.device,
            model=size,
        )
        model = train_heightmap(
            self._data(trained_on, "fitted"), folder / "heightmap.pt", config,
            lambda at: tell(f"{trained_on}, seed {seed}: {at.update}/{at.updates}, {1e3 * at.mae_m:.1f} mm"),
        )  # fmt: skip
        return errors_mm(exported(model, folder / "heightmap.onnx"), shown)


def errors_mm(model: Path, shown: dict[BackEndName, list[Episode]]) -> dict[str, float]:
    """Mean absolute errors of a model file with the images of each renderer."""
    network = HeightmapNetwork(ROBOT, model)
    return {
        name: 1e3 * height_accuracy(network, episodes, TRAINING).mae_m
        for name, episodes in progress(shown.items(), model.parent.name)
    }
