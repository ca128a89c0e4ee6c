"""Nine packages that do real work: for each a command that needs it,
the function that works, and where it is called.

Commands run as a user starts them, with all their processes; `noting/sitecustomize.py` notes who
called what.
"""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import requires
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
COMMANDS = {
    "demo": "demo --terrain flat --time-limit-s 0.3 --no-video --renderer pyrender",
    "preview": "render preview --terrain rubble --out preview",
    "train": "policy train --device cpu --robots 8 --iterations 1 "
    "--evaluate-minutes 0 --out trained",
    "collect": "heightmap collect gpu --device cpu --episodes 1 --out data",
}
LAST = {"train": "torch", "collect": "kornia.morphology"}
"""Commands that take longer end with the first call of this module."""


@dataclass(frozen=True, kw_only=True)
class Work:
    """What a package does."""

    command: str
    module: str
    function: str
    where: str
    """File of the project that calls it."""


PACKAGES = {
    "torch": Work(command="train", module="torch", function="Tensor.backward", where="learner.py"),
    "pyrender": Work(
        command="demo",
        module="pyrender",
        function="OffscreenRenderer.render",
        where="pyrender_osmesa.py",
    ),
    "trimesh": Work(
        command="demo", module="trimesh", function="Trimesh.__init__", where="pyrender_osmesa.py"
    ),
    "opencv-python-headless": Work(
        command="preview", module="cv2", function="applyColorMap", where="preview.py"
    ),
    "kornia": Work(
        command="collect", module="kornia.morphology", function="dilation", where="stereo_torch.py"
    ),
    "open3d": Work(
        command="preview",
        module="open3d",
        function="t.geometry.RaycastingScene.cast_rays",
        where="embree.py",
    ),
    "onnxruntime": Work(
        command="demo",
        module="onnxruntime",
        function="InferenceSession.run_with_iobinding",
        where="network.py",
    ),
    "mujoco": Work(command="demo", module="mujoco", function="mj_step", where="plant.py"),
    "eclipse-zenoh": Work(command="demo", module="zenoh", function="open", where="joining.py"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("notes")


def run(command: str, folder: Path) -> Path:
    """Runs a command, unless that has been done; returns the folder with its notes."""
    notes = folder / command
    if not notes.exists():
        notes.mkdir()
        noted = {
            work.module: work.function for work in PACKAGES.values() if work.command == command
        }
        path = os.pathsep.join([str(Path(__file__).parent / "noting"), str(PROJECT)])
        given = {
            "NOTED": json.dumps(noted),
            "NOTES": str(notes),
            "PROJECT": str(PROJECT),
            "PYTHONPATH": path,
        }
        done = subprocess.run(
            [sys.executable, "-P", "-m", "saltus.cli.main", *COMMANDS[command].split()],
            cwd=folder,
            env={**os.environ, **given, "LAST": LAST.get(command, "")},
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=300,
        )
        assert "Traceback" not in done.stderr
    return notes


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_package_does_real_work_in_a_command(package: str, folder: Path) -> None:
    work = PACKAGES[package]
    note = run(work.command, folder) / work.module
    assert note.exists(), (
        f"saltus {COMMANDS[work.command]} does not call {work.module}.{work.function}"
    )
    assert Path(note.read_text()).name == work.where


def test_saltus_declares_all_of_them() -> None:
    declared = " ".join(requires("saltus") or ())
    assert [
        package
        for package in PACKAGES
        if f"{package}>" not in declared and f"{package}<" not in declared
    ] == []
