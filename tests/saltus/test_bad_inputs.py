"""Bad inputs to all commands: one line that names the value and what is allowed,
code 2, nothing written, nothing lost.

The heightmap's datasets and full disks are in tests/heightmap/test_bad_files.py, run logs in
tests/real2sim/test_bad_logs.py, benchmarks in tests/benchmarks/test_bench.py.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest
from bad_models import OF_MODELS
from bad_runs import OF_RUNS
from samples import put_run

from saltus.cli.main import main
from saltus.config import RunConfig, to_toml
from saltus.robots.shipped import SUPPLEMENT_FILE, shipped_folder

CAMERAS = {
    "ratehz": "ratehz = 30.0",
    "slow": "rate_hz = 5",
    "height": "camera_height = 0.142",
    "degrees": "camera_pitch = 25.0",
    "half": "[image]\nwidth = 640\nheight = 480",
    "wide": "[image]\nwidth = 640\nheight = 480\nfov_deg = [200, 50]",
    "huge": "[image]\nwidth = 640000\nheight = 480\nfov_deg = [80, 50]",
    "inside": "camera_position = [0.0, 0.0, 0.0]",
    "noise": "[stereo.disparity_nois]\nsigma = 0.1",
    "sigma": "[stereo.disparity_noise]\nsigma = 'much'",
    "high": "camera_position = [0.272, 0.0075, 0.15]",
}
BAD = OF_RUNS | OF_MODELS


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all that is named above; what is named missing is."""
    root = tmp_path_factory.mktemp("place")
    junk = np.random.default_rng(0).bytes(3000)
    for suffix in ("mcap", "bag", "onnx", "pt", "toml", "xml"):
        (root / f"empty.{suffix}").touch()
        (root / f"junk.{suffix}").write_bytes(junk)
        (root / f"folder.{suffix}").mkdir()
    (root / "file").write_text("kept")
    (root / "unknown.toml").write_text("[learning]\ndesired_klm = 1.0\n")
    (root / "table.csv").write_text("t,angle\n0.0,0.1\n0.1,spam\n")
    (root / "torque.toml").write_text('[columns]\nq = "angle"\ntorque = "load"\n')
    (root / "columns.toml").write_text('[columns]\ntime = "t"\nq = "angle"\njoints = ["FR_hip"]\n')
    contents = {
        "junk": junk,
        "mistyped": b"sed = 3",
        "half": b"",
        "run": to_toml(RunConfig(robot="go1", grid="line")).encode(),
    }
    for name, content in contents.items():
        (root / name).mkdir()
        (root / name / "run.toml").write_bytes(content)
    put_run(root / "run", RunConfig(robot="go1", grid="line"))
    for name, content in CAMERAS.items():
        (root / f"camera_{name}.toml").write_text(content)
    (root / "folder").mkdir()
    (root / "modelled").mkdir()
    body, free = '<body name="{}"><geom size="0.1"/>{}</body>', "<freejoint/>"
    for name, bodies in {
        "modelled/one": body.format("a", free), "held": body.format("a", ""),
        "two": body.format("a", free) + body.format("b", free),
    }.items():  # fmt: skip
        (root / f"{name}.xml").write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    for robot, ours, theirs in (
        ("other", 'name = "go1"', 'name = "other"'),
        ("moved", "[0.272,", "[0.3,"),
    ):
        supplement = Path(shutil.copytree(shipped_folder("go1"), root / robot)) / SUPPLEMENT_FILE
        supplement.write_text(supplement.read_text().replace(ours, theirs))
    return root


def files(place: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in place.rglob("*")}


@pytest.mark.sample(65)
@pytest.mark.parametrize("words", BAD, ids=str)
def test_bad_input(
    words: str, place: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    monkeypatch.delenv("SALTUS_PROFILES", raising=False)
    before = files(place)
    assert main(words.split()) == 2
    said = capfd.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert said.err.startswith("saltus: ")
    assert BAD[words] in said.err
    assert files(place) == before
