"""A training that is carried to another machine, and what comes back."""

import shutil
from dataclasses import replace
from pathlib import Path

import tomli_w

from saltus.config import to_toml
from saltus.depth_camera import load_camera
from saltus.errors import ConfigError
from saltus.files import whole_folder
from saltus.grid import load_grid
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.model_file import checksum_path
from saltus.policy.planner import make_planner
from saltus.policy.training.files import CHECKPOINT
from saltus.real2sim.cycle.folder import MODELS, CycleFolder
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.real2sim.cycle.training import (
    device_collection,
    differs_beyond_camera,
    policy_changes,
    shipped_checkpoint,
)
from saltus.used_networks import ModelKind

PROFILE, CAMERA = "profile.toml", "camera.toml"
_BEGIN = """#!/usr/bin/env bash
# Trains with profile.toml. It needs a GPU. After an interruption it goes on.
set -euo pipefail
cd "$(dirname "$0")"
"""
_POLICY = """# The policy, further
if [ ! -e policy/policy.onnx ]; then
  begin=policy/checkpoint.pt
  [ -e "$begin" ] || begin=policy.pt
  saltus policy train --resume "$begin" --config policy.toml --minutes {minutes:g} --out policy
  saltus policy export --checkpoint policy/checkpoint.pt --out policy
fi
"""
_PREDICTOR = """# The predictor, with what robots of that profile see while the policy drives them
if [ ! -e dataset ]; then
  rm -rf partial
  saltus heightmap collect gpu --config collection.toml --out partial
  mv partial dataset
fi
saltus heightmap train --data dataset --start heightmap.onnx --config predictor.toml --seed {seed} --out heightmap
saltus heightmap export --data dataset --checkpoint heightmap/heightmap.pt --out heightmap
"""
_README = """# Training of a cycle

Profile and checkpoints of `saltus real2sim cycle`, to be trained on a machine with a GPU:

    pip install -e '.[train]'   # in a checkout of Saltus, with a torch for that GPU
    bash train.sh

| file | what it is |
|---|---|
| profile.toml | the robot as it was found |
| policy.pt, heightmap.onnx | networks to begin with |
| policy.toml, predictor.toml | settings of their trainings; the first only if more than the camera differs |
| collection.toml | how the policy drives robots of this profile, for the predictor to learn from |

train.sh writes policy/policy.onnx, if the policy is trained, and heightmap/heightmap.onnx. Bring these folders back
beside profile.toml and go on with

    saltus real2sim cycle --out FOLDER_OF_THE_CYCLE --take-training THIS_FOLDER

One of the two models is enough: the other then stays as shipped.
"""


def refuse_export(export: Path | None, take: Path | None) -> None:
    """Says before the work that a training cannot be exported there,
    or taken from there: `ConfigError`.
    """
    if export is not None and take is not None:
        raise ConfigError(f"--export-training {export}: not together with --take-training")
    if export is not None and export.exists():
        raise ConfigError(
            f"--export-training {export}: there is a file or folder of this name already"
        )
    if take is not None and not (take / PROFILE).is_file():
        raise ConfigError(
            f"--take-training {take}: {PROFILE} is missing: no folder that --export-training wrote"
        )
    if take is not None and not _models(take):
        raise ConfigError(
            f"--take-training {take}: there is no policy.onnx and no heightmap.onnx: run its "
            "train.sh"
        )


def export_training(folder: CycleFolder, settings: CycleSettings, out: Path) -> None:
    """Writes a folder to carry away, of which `refuse_export` says nothing."""
    with whole_folder(out) as made:
        shutil.copyfile(folder.profile, made / PROFILE)
        for kind in MODELS:
            shutil.copyfile(shipped_checkpoint(kind), made / shipped_checkpoint(kind).name)
        if Path(settings.loop.camera).is_file():
            shutil.copyfile(settings.loop.camera, made / CAMERA)
            settings = replace(settings, loop=replace(settings.loop, camera=CAMERA))
        script, driver = _BEGIN, Path("policy.pt")
        if differs_beyond_camera(folder):
            script, driver = script + _POLICY, Path("policy") / CHECKPOINT
            (made / "policy.toml").write_text(
                tomli_w.dumps(policy_changes(settings, Path(PROFILE))), encoding="utf-8"
            )
        collection = device_collection(settings, driver, Path("heightmap.onnx"), Path(PROFILE))
        (made / "collection.toml").write_text(to_toml(collection), encoding="utf-8")
        (made / "predictor.toml").write_text(to_toml(settings.predictor), encoding="utf-8")
        script = (script + _PREDICTOR).format(seed=settings.seed, minutes=settings.policy_minutes)
        (made / "train.sh").write_text(script, encoding="utf-8")
        (made / "README.md").write_text(_README, encoding="utf-8")


def take_training(
    folder: CycleFolder, settings: CycleSettings, given: Path
) -> tuple[ModelKind, ...]:
    """Checks the models that another machine has trained, and takes them; returns their kinds.

    Raises:
        ConfigError: they were trained for another profile.
        ModelError: one is damaged, or not for this robot and camera.
    """
    if folder.read(given / PROFILE) != folder.read(folder.profile):
        raise ConfigError(f"--take-training {given}: its {PROFILE} is not that of {folder.profile}")
    models = _models(given)
    robot = load_camera(settings.loop.camera).mounted_on(folder.robot)
    if "heightmap" in models:
        HeightmapNetwork(robot, models["heightmap"])
    if "policy" in models:
        make_planner("learned", robot, load_grid(settings.loop.grid), models["policy"])
    for kind, model in models.items():
        target = folder.root / kind
        shutil.rmtree(target, ignore_errors=True)
        with whole_folder(target) as made:
            for file in (model, checksum_path(model)):
                shutil.copyfile(file, made / file.name)
    return tuple(models)


def _models(given: Path) -> dict[ModelKind, Path]:
    """Files of the models that were trained."""
    paths: dict[ModelKind, Path] = {kind: given / kind / f"{kind}.onnx" for kind in MODELS}
    return {kind: path for kind, path in paths.items() if path.exists()}
