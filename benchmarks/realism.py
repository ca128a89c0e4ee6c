"""Worth of each part of the camera's realism in the training of the heightmap network.

Networks are trained from nothing on the same motion, seed and number of updates, and differ in
their images:

    A  stereo errors, late with jitter, losses and pauses, noise: as in any training
    B  true depth, as late as those of A
    C  true depth, 50 ms late, none lost
    D  true depth, neither late nor lost
    E  stereo errors and noise, neither late nor lost

All then drive robots that have the realistic camera, in the held-out runs of `saltus heightmap
eval`, and those with an ideal camera, whose images are as late. Beside that, episodes that no
network was fitted to are shown to each network with the images that A, C and D were trained on, so
that all get the same ones.

The age of the image is an input, and a network that only saw one age may err at others for no
better reason. Those whose images were always as late are therefore measured a second time, "age
held": with an age that tells them nothing new. On the images that they know this changes nothing.
Cameras do not sit where they should in any of the data.

The folder keeps data, checkpoints and results, and a run that was stopped goes on. Data that are
there already, in `stereo` and `clean`, are taken. Errors are in millimetres, shares in percent.

    OMP_NUM_THREADS=1 saltus bench realism -- --networks A D --out runs/realism
"""

import copy
import json
import logging
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from benchmarks._command import Command
from saltus.arrays import Reals
from saltus.depth_camera import SHIPPED
from saltus.grid import LINE
from saltus.heightmap.data.closed_loop import closed_loop_episodes
from saltus.heightmap.data.delivery import DELIVERIES, TICK_S
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.shards import DatasetError, read_dataset, read_manifest, write_shard
from saltus.heightmap.evaluation.held_out import HeldOutRuns
from saltus.heightmap.evaluation.scores import score_table
from saltus.heightmap.model import MAX_IMAGE_AGE_S, HeightmapModel
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.heightmap.settings import ClosedLoop, DeliveryName, PredictorTraining
from saltus.heightmap.training.export import ModelOrigin, export_heightmap
from saltus.heightmap.training.train import load_checkpoint, split_episodes, train_heightmap
from saltus.heightmap.training.validate import MIN_WARMUP, height_accuracy
from saltus.resources import shipped_file
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT

DATA_SEED, EVAL_SEED, SEED = 2031, 5, 1
ROUNDS, BATCHES = 3, 6  # of 32 robots for 6 s: a little over 100,000 steps a round
ROBOT = load_robot(DEFAULT_ROBOT)
# Share of robots that the learned policy drives, as in the GPU rollouts of the shipped network
LEARNED = 0.75
SHOWN = 40  # held-out episodes
STEREO, CLEAN = "stereo", "clean"
_SAME = 1e-6  # metres, radians: what another order of the same sums may differ by
_CAMERAS = {STEREO: "d435i", CLEAN: "ideal"}
_PERCENT = ("coverage90", "edges_found")
_LENGTHS = ("mae_m", "mae_visible_m", "mae_remembered_m", "mae_unseen_m", "edge_error_m")


@dataclass(frozen=True, kw_only=True)
class Images:
    """Images that a network is trained on."""

    data: str
    """`STEREO` or `CLEAN`."""
    delivery: DeliveryName


NETWORKS = {
    "A": Images(data=STEREO, delivery="training"),
    "B": Images(data=CLEAN, delivery="training"),
    "C": Images(data=CLEAN, delivery="nominal"),
    "D": Images(data=CLEAN, delivery="at-once"),
    "E": Images(data=STEREO, delivery="at-once"),
}
SHOWN_AS = ("A", "C", "D")
"""Networks whose images the held-out episodes are shown with."""


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    out: Path = Path("runs/realism")
    """Folder of data, networks and results."""
    networks: tuple[Literal["A", "B", "C", "D", "E"], ...] = ("A", "B", "C", "D", "E")
    """Which of them."""
    updates: int = 4000
    """Updates of 16 windows."""
    runs: int = 60
    """Held-out ones."""

    def measure(self) -> dict[str, Any]:
        """Collects, trains, measures."""
        logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
        for name in _CAMERAS:
            collect(self.out / name, name)
        episodes = {name: read_dataset(self.out / name) for name in _CAMERAS}
        check_twins(episodes[STEREO], episodes[CLEAN])
        held_out = {name: split_episodes(found)[1][:SHOWN] for name, found in episodes.items()}
        del episodes  # the training reads them again
        table = {name: self._network(name, held_out) for name in self.networks}
        return {"updates": self.updates, "runs": self.runs, "networks": table}

    def _network(self, name: str, held_out: dict[str, list[Episode]]) -> dict[str, Any]:
        """Trains one network, measures it, and leaves its figures in the folder."""
        model, _ = load_checkpoint(trained(self.out, name, self.updates))
        logging.info("%s is trained", name)
        figures = asdict(NETWORKS[name])
        figures |= measured(
            exported(model, self.out / name / "heightmap.onnx"), self.runs, held_out
        )
        latency_s = DELIVERIES[NETWORKS[name].delivery].latency_s
        if latency_s[0] == latency_s[1]:
            held = exported(with_age_held(model, latency_s[0]), self.out / name / "age_held.onnx")
            figures["age held"] = measured(held, self.runs, held_out)
        (self.out / f"{name}.json").write_text(
            json.dumps(figures, indent=1) + "\n", encoding="utf-8"
        )
        return figures


def collect(data: Path, name: str) -> None:
    """Adds the rounds that are missing; those of both cameras show the same motion."""
    loop = ClosedLoop(robot="go1", grid="line", learned=LEARNED, camera=_CAMERAS[name])
    model = shipped_file("models/heightmap.onnx")
    for index in range(len(read_manifest(data)), ROUNDS):
        logging.info("collecting round %d, %s", index, name)
        config = {
            "source": "dagger",
            "round": index,
            "heights": HeightmapNetwork(ROBOT, model).model_id,
            **asdict(loop),
        }
        made = (
            e
            for batch in range(BATCHES)
            for e in closed_loop_episodes(loop, model, (DATA_SEED, index, batch))
        )
        write_shard(data, made, seed=DATA_SEED, config=config)


def check_twins(left: list[Episode], right: list[Episode]) -> None:
    """Refuses two datasets that do not show the same motion.

    Raises:
        DatasetError: their episodes differ in proprioception or heights.
    """
    if len(left) != len(right):
        raise DatasetError(
            f"{STEREO} has {len(left)} episodes, {CLEAN} has {len(right)}: they must be of one "
            "motion"
        )
    for i, (a, b) in enumerate(zip(left, right, strict=True)):
        if not (_same(a.proprioception, b.proprioception) and _same(a.height, b.height)):
            raise DatasetError(
                f"episode {i} of {STEREO} and of {CLEAN} differ: they must be of one motion"
            )


def _same(left: Reals, right: Reals) -> bool:
    return left.shape == right.shape and np.allclose(left, right, rtol=0.0, atol=_SAME)


def trained(out: Path, name: str, updates: int) -> Path:
    """The checkpoint of one network, trained unless it is there."""
    images, checkpoint = NETWORKS[name], out / name / "heightmap.pt"
    config = PredictorTraining(
        updates=updates, batch=16, noise=images.data == STEREO, delivery=images.delivery,
        forgets=0.0, seed=SEED,
        device="cpu",
    )  # fmt: skip
    train_heightmap(out / images.data, checkpoint, config)
    return checkpoint


def exported(model: HeightmapModel, path: Path) -> Path:
    """The network as a file."""
    # Its warm-up is the service's business: nothing reads it here, so it is not measured.
    export_heightmap(
        model,
        path,
        ModelOrigin(
            robot="go1",
            grid=LINE,
            camera=SHIPPED["d435i"],
            warmup_frames=MIN_WARMUP,
            dataset="",
            seed=SEED,
        ),
    )
    return path


def with_age_held(model: HeightmapModel, latency_s: float) -> HeightmapModel:
    """A network that takes every image to be `latency_s` old when it comes,
    and a tick older at the tick after that.

    Where this is so, as in its training, outputs do not change: the age then follows from whether
    the image is new.
    """
    held = copy.deepcopy(model)
    weight, bias = (held.gru.get_parameter(f"{name}_ih_l0") for name in ("weight", "bias"))
    # After the features of the image; then whether it is new
    age = held.gru.input_size - len(PROPRIOCEPTION) - 2
    first, later = latency_s / MAX_IMAGE_AGE_S, (latency_s + TICK_S) / MAX_IMAGE_AGE_S
    with torch.no_grad():
        bias.add_(later * weight[:, age])
        weight[:, age + 1] += (first - later) * weight[:, age]
        weight[:, age] = 0.0
    return held


def measured(model: Path, runs: int, held_out: dict[str, list[Episode]]) -> dict[str, Any]:
    """Scores of a network in the loop, with the realistic and an ideal camera,
    and on shown images.
    """
    table: dict[str, Any] = {
        camera: in_the_loop(model, runs, camera) for camera in _CAMERAS.values()
    }
    return {**table, "shown": shown(model, held_out)}


def in_the_loop(model: Path, runs: int, camera: str) -> dict[str, Any]:
    """Errors in the held-out runs, with the network in the loop."""
    config = HeldOutRuns(
        robot="go1", grid="line", runs=runs, seed=EVAL_SEED, camera=camera, baselines=()
    )
    found = score_table([run for batch in config.batches for run in config.measure(model, batch)])
    table: dict[str, Any] = {key: round(1e3 * found[key], 2) for key in _LENGTHS}
    table |= {key: round(1e2 * found[key], 1) for key in _PERCENT}
    terrains = {kind: round(1e3 * row["mae_m"], 2) for kind, row in found["by_terrain"].items()}
    return {
        **table,
        "nll": round(found["nll"], 2),
        "terrains": terrains,
        "steps": found["points"] // 30,
    }


def shown(model: Path, held_out: dict[str, list[Episode]]) -> dict[str, dict[str, float]]:
    """Errors on episodes that it was not fitted to, with the images that others were trained on."""
    table = {}
    for name in SHOWN_AS:
        images = NETWORKS[name]
        found = height_accuracy(
            HeightmapNetwork(ROBOT, model), held_out[images.data], DELIVERIES[images.delivery]
        )
        table[f"as {name}"] = {
            "mae_m": round(1e3 * found.mae_m, 2),
            "ahead_m": round(1e3 * found.ahead_m, 2),
            "coverage90": round(1e2 * found.coverage90, 1),
        }
    return table
