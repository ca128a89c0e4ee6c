"""Policy and predictor, trained further from the shipped checkpoints
with the profile that was found.
"""

from dataclasses import replace
from pathlib import Path

from saltus import gpu
from saltus.config import with_changes
from saltus.effects.profile import SHIPPED, load_profile
from saltus.files import whole_folder
from saltus.heightmap.collection import collect_shard
from saltus.heightmap.settings import DeviceCollection, DeviceLoop, ProcessorCollection
from saltus.policy.env.settings import LearningSettings
from saltus.policy.training.command import TrainPolicyCommand
from saltus.policy.training.files import CHECKPOINT
from saltus.real2sim.cycle.folder import CycleFolder
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.real2sim.progress import ProgressListener
from saltus.resources import shipped_file
from saltus.used_networks import model_path

FURTHER_KL = 0.01
"""Step of a policy that is trained further: `LearningSettings.desired_kl`, with which trainings
begin."""
FURTHER_STD = 0.15
"""Least standard deviation of the actions of such a policy, `LearningSettings.std_range`; that of
the shipped one came to 0.08."""
FURTHER_WIDE = 0.001
"""Share of wide draws for such a policy, `WideSettings.share`, 0.3 for the shipped one. What logs
told of a robot need not be drawn; with 0 the critic would not have all inputs of its checkpoint.
docs/cycle.md says what that gains and costs."""
FURTHER_HARDEST = 0.8
"""Difficulty of the hardest courses of such a policy, `CurriculumSettings.hardest`. Those that a
cycle measures have 0.5 to 0.72."""
LEARNED = 0.75
"""Share of robots that the policy drives in the predictor's data, as in those of the shipped one:
rules see to it that motions are not all alike."""


SHIPPED_FILES = {"policy": "checkpoints/policy.pt", "heightmap": "heightmap.onnx"}
"""Files of models/ with which further training begins: the predictor's ends with no state of an
optimiser."""


def shipped_checkpoint(kind: str) -> Path:
    """File of the "heightmap" or the "policy" that Saltus ships, to train it further."""
    return shipped_file(f"models/{SHIPPED_FILES[kind]}")


def collect_data(folder: CycleFolder, settings: CycleSettings, tell: ProgressListener) -> None:
    """Runs robots with the profile, the shipped predictor in the loop.

    Where a policy was trained it drives them, else the shipped one. With a GPU they run there, as
    with `saltus heightmap collect gpu`, without one on processors, as with `saltus heightmap
    collect cpu`.

    Raises:
        KeyboardInterrupt: it was interrupted; nothing is kept.
    """
    own, gpu_is_there, ticks = folder.policy / CHECKPOINT, gpu.has_gpu(), 0.0
    policy = own if own.exists() else shipped_checkpoint("policy")
    on_gpu = device_collection(settings, policy, shipped_checkpoint("heightmap"), folder.profile)
    total = settings.loop.ticks * (on_gpu.batches if gpu_is_there else settings.batches)

    def ran(more: float = 1.0) -> None:
        nonlocal ticks
        ticks += more
        tell("collect", ticks / total)

    with whole_folder(folder.dataset) as partial_folder:
        if gpu_is_there:
            from saltus.heightmap.device_collection import (
                collect_shards_on_device as collect_on_gpu,
            )

            cameras = dict.fromkeys(on_gpu.loop.cameras, partial_folder)
            made = collect_on_gpu(on_gpu, cameras, ran, lambda *_: None)
        else:
            on_processors = ProcessorCollection(
                batches=settings.batches, seed=settings.seed, profile=str(folder.profile),
                model=model_path("heightmap"), loop=settings.loop,
            )  # fmt: skip
            made = collect_shard(on_processors, partial_folder, lambda _: None, listener=ran)
        if not made.whole:
            raise KeyboardInterrupt


def device_collection(
    settings: CycleSettings, policy: Path, predictor: Path, profile: Path
) -> DeviceCollection:
    """Returns what `saltus heightmap collect gpu` is told:
    these files, and the courses and the camera of the cycle.
    """
    loop = DeviceLoop(
        robot=settings.loop.robot,
        grid=settings.loop.grid,
        ticks=settings.loop.ticks,
        learned=LEARNED,
        terrains=settings.loop.terrains,
        cameras=(settings.loop.camera,),
    )
    return DeviceCollection(
        episodes=settings.episodes, seed=settings.seed, policy=policy, predictor=predictor,
        profile=str(profile),
        loop=loop,
    )  # fmt: skip


def train_predictor(folder: CycleFolder, settings: CycleSettings, tell: ProgressListener) -> None:
    """Trains the shipped predictor on these data, as `saltus heightmap train` and `export`.

    Goes on where it was.
    """
    from saltus.heightmap.training.release import release_model
    from saltus.heightmap.training.train import train_heightmap

    checkpoint = folder.predictor / "heightmap.pt"
    train_heightmap(
        folder.dataset, checkpoint, settings.predictor,
        lambda at: tell("train the predictor", at.update / at.updates),
        start=shipped_checkpoint("heightmap"),
    )  # fmt: skip
    tell("export the predictor", 1.0)
    release_model(checkpoint, folder.dataset, folder.predictor / "heightmap.onnx")


def differs_beyond_camera(folder: CycleFolder) -> bool:
    """True where drives, body or IMU of the found profile differ
    from those that the shipped policy was trained with.

    If only the camera does there is nothing for the policy to learn: its inputs are heights, not
    images.
    """
    profiles = folder.read(folder.profile), load_profile(SHIPPED, folder.robot)
    found, learned = (replace(profile, camera=()) for profile in profiles)
    return found != learned


def policy_changes(settings: CycleSettings, profile: Path) -> dict[str, object]:
    """Returns what the policy's training has otherwise than that of the shipped one,
    as tables of its TOML file.

    The shipped one ended with small steps and sure of its actions; a robot that is another needs
    the steps of the beginning, and trials of other actions, on courses of all levels: what it
    mastered it may not master any more.
    """
    std_range = [FURTHER_STD, LearningSettings.std_range[1]]
    learning = {"desired_kl": FURTHER_KL, "last_kl": FURTHER_KL, "std_range": std_range}
    env = {
        "profile": str(profile),
        "curriculum": {"any_level": 1.0, "hardest": FURTHER_HARDEST},
        "randomisation": {"wide": {"share": FURTHER_WIDE}},
    }
    return {"seed": settings.seed, "env": env, "learning": learning}


def train_policy(folder: CycleFolder, settings: CycleSettings) -> None:
    """Trains the shipped policy with the profile, as `saltus policy train` and `export`.

    Goes on where it was.
    """
    from saltus.policy.training.checkpoint import read_policy_checkpoint, training_config
    from saltus.policy.training.export import export_policy

    shipped, own = shipped_checkpoint("policy"), folder.policy / CHECKPOINT
    resume = own if own.exists() else shipped
    done_s = float(read_policy_checkpoint(resume)["seconds"]) - float(
        read_policy_checkpoint(shipped)["seconds"]
    )
    config = with_changes(
        training_config(read_policy_checkpoint(shipped)),
        policy_changes(settings, folder.profile.absolute()),
    )
    minutes = settings.policy_minutes - done_s / 60.0
    if minutes > 0.0:
        TrainPolicyCommand(
            out=folder.policy, minutes=minutes, resume=resume, training=config, evaluate_minutes=0.0
        ).run()
    export_policy(own, folder.policy / "policy.onnx")
