"""Policy and predictor, trained further from the shipped checkpoints with the profile that was found."""

from dataclasses import replace
from pathlib import Path

from saltus.folders import whole_folder
from saltus.heightmap.collection import collect
from saltus.heightmap.settings import ProcessorCollection
from saltus.models import model_path
from saltus.policy.training.command import CHECKPOINT, Train
from saltus.real2sim.cycle.folder import CycleFolder
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.real2sim.progress import Progress
from saltus.resources import resource


def shipped_checkpoint(kind: str) -> Path:
    """Of the "heightmap" or the "policy" that Saltus ships."""
    return resource(f"models/checkpoints/{kind}.pt")


def collect_data(folder: CycleFolder, settings: CycleSettings, tell: Progress) -> None:
    """Runs robots with the profile on processors, the shipped predictor in the loop, as `saltus heightmap collect cpu`.

    Raises:
        KeyboardInterrupt: it was interrupted; nothing is kept.
    """
    ticks, total = 0.0, settings.batches * settings.loop.ticks

    def ran(more: float) -> None:
        nonlocal ticks
        ticks += more
        tell("collect", ticks / total)

    wanted = ProcessorCollection(
        batches=settings.batches, seed=settings.seed, profile=str(folder.profile), model=model_path("heightmap"),
        loop=settings.loop,
    )  # fmt: skip
    with whole_folder(folder.dataset) as partial_folder:
        if not collect(wanted, partial_folder, lambda _: None, listener=ran).whole:
            raise KeyboardInterrupt


def train_predictor(folder: CycleFolder, settings: CycleSettings, tell: Progress) -> None:
    """Trains the shipped predictor on these data, as `saltus heightmap train` and `export`; goes on where it was."""
    from saltus.heightmap.training.release import release
    from saltus.heightmap.training.train import train

    checkpoint = folder.predictor / "heightmap.pt"
    train(
        folder.dataset, checkpoint, settings.predictor, lambda at: tell("train the predictor", at.update / at.updates),
        start=shipped_checkpoint("heightmap"),
    )  # fmt: skip
    tell("export the predictor", 1.0)
    release(checkpoint, folder.dataset, folder.predictor / "heightmap.onnx")


def has_gpu() -> bool:
    """Whether the policy can be trained on this machine."""
    from saltus.policy.training import train

    return train.has_gpu()


def train_policy(folder: CycleFolder, settings: CycleSettings) -> None:
    """Trains the shipped policy with the profile, as `saltus policy train` and `export`; goes on where it was."""
    from saltus.policy.training.checkpoint import config_of, read_checkpoint
    from saltus.policy.training.export import export

    shipped, own = shipped_checkpoint("policy"), folder.policy / CHECKPOINT
    resume = own if own.exists() else shipped
    done_s = float(read_checkpoint(resume)["seconds"]) - float(read_checkpoint(shipped)["seconds"])
    config = config_of(read_checkpoint(shipped))
    config = replace(config, seed=settings.seed, env=replace(config.env, profile=str(folder.profile.absolute())))
    minutes = settings.policy_minutes - done_s / 60.0
    if minutes > 0.0:
        Train(out=folder.policy, minutes=minutes, resume=resume, training=config, evaluate_minutes=0.0).run()
    export(own, folder.policy / "policy.onnx")
