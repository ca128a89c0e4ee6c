"""A camera, a course, a predictor and a policy of one's own in one run,
from files alone, by the docs' commands.
"""

import contextlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from saltus.cli.main import main
from saltus.depth_camera import load_camera
from saltus.heightmap.data.shards import read_dataset
from saltus.model_file import ModelFile
from saltus.recordings.recording import read_recording
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus, RobotState

EXAMPLES = Path(__file__).parents[2] / "examples"
CAMERA, COURSE = str(EXAMPLES / "camera.toml"), str(EXAMPLES / "course.toml")
ROBOTS = 12  # a run each, one of which is held out
LOOP = (
    f"--loop.camera {CAMERA} --loop.robots {ROBOTS} --loop.courses 1 --loop.ticks 120 "
    "--loop.hardest 0.2"
)
NETWORK = (
    "--updates 3 --batch 4 --window 40 --device cpu --model.channels 2 2 2 --model.hidden "
    "16 --model.head 16"
)
POLICY = "--device cpu --robots 8 --learning.hidden 8 --learning.horizon 2 --iterations 1"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, short_calibration: None) -> Path:
    """Small trainings: of a predictor on images of this camera, and of a policy."""
    root = tmp_path_factory.mktemp("own")
    for words in (
        f"heightmap collect cpu --batches 1 --processes 1 --out {root}/data {LOOP}",
        f"heightmap train --data {root}/data --out {root} {NETWORK}",
        f"heightmap export --data {root}/data --checkpoint {root}/heightmap.pt --out {root}",
        f"policy train {POLICY} --out {root}/policy",
        f"policy export --checkpoint {root}/policy/checkpoint.pt --out {root}",
    ):
        assert main(words.split()) == 0, words
    return root


@pytest.fixture(scope="module")
def run(folder: Path) -> tuple[Path, dict[str, Any]]:
    """The folder of a run with what they made, and the table that it printed."""
    models = f"--heightmap-model {folder}/heightmap.onnx --policy-model {folder}/policy.onnx"
    command = (
        f"demo --camera {CAMERA} --terrain {COURSE} {models} --no-video --json --time-limit-s 1.2"
    )
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main([*command.split(), "--out", f"{folder}/run"]) in (0, 1)
    return folder / "run", json.loads(printed.getvalue().splitlines()[-1])


@pytest.mark.slow
def test_the_data_are_those_of_the_camera_and_the_model_says_so(folder: Path) -> None:
    camera, model = load_camera(CAMERA), ModelFile(folder / "heightmap.onnx")
    for episode in read_dataset(folder / "data"):
        np.testing.assert_array_equal(episode.frame_tick, camera.exposures(len(episode.height)))
        assert not episode.depth[
            :, [0, -1]
        ].any()  # the camera looks 58 degrees up and down, the network 59
        assert episode.depth[:, 1:-1].all(-1).mean() > 0.9
    assert model.field("camera")["position_m"] == list(camera.camera_position or ())
    assert model.field("camera")["pitch_rad"] == camera.camera_pitch
    assert model.field("depth_camera") == camera.record
    assert model.field("nominal_delay_s") == camera.latency_s


@pytest.mark.slow
def test_all_of_it_runs_together_to_a_verdict_and_report_and_recording_say_what_it_was(
    folder: Path, run: tuple[Path, dict[str, Any]]
) -> None:
    out, table = run
    camera, recording = load_camera(CAMERA), read_recording(out / "recording.mcap")
    assert table["success"] or table["cause"] in ("time_limit", "not_upright", "trunk_contact")
    assert table["models"] == {
        kind: ModelFile(folder / f"{kind}.onnx").model_id for kind in ("heightmap", "policy")
    }
    assert table["camera"] == f"camera {camera.fingerprint}"
    assert table["terrain"] == recording.terrain.kind
    report = (out / "report.html").read_text()
    assert recording.models == table["models"]
    models_named = [f"{kind} model = {name}" for kind, name in table["models"].items()]
    for said in (*models_named, table["camera"], CAMERA, COURSE):
        assert said in report
    assert recording.camera == camera
    assert recording.robot.camera_position.tolist() == list(camera.camera_position or ())
    frames = recording.of(DepthFrame)
    times_ns = [state.time_ns for state in recording.of(RobotState)]
    ran_s = 1e-9 * (times_ns[-1] - times_ns[0])
    assert ran_s > 1.2
    # Less those under way at the end
    assert len(frames) == pytest.approx(camera.rate_hz * ran_s, abs=7)
    assert {(*frame.depth.shape, frame.fx, frame.cy) for frame in frames} == {
        (480, 640, camera.image.fx, camera.image.cy)
    }
    assert HeightmapStatus.OK in {heightmap.status for heightmap in recording.of(Heightmap)}


@pytest.mark.slow
def test_it_is_measured_and_replayed_with_the_same_camera(
    folder: Path, run: tuple[Path, dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    model, (out, _) = folder / "heightmap.onnx", run
    assert main(["replay", f"{out}/recording.mcap", "--model", str(model), "--json"]) == 0
    table = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert table["first_difference"] is None
    evaluation = (
        f"policy eval --terrain flat --trials 1 --heightmap predicted --heightmap-model {model}"
    )
    assert main([*evaluation.split(), "--camera", CAMERA, "--no-report", "--json"]) in (0, 1)
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["camera"] == CAMERA


@pytest.mark.slow
def test_images_are_as_late_as_the_profile_says_and_not_lost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # 160 ms, where others are lost after 170 ms
    profile, out = (
        EXAMPLES / "late_camera.toml",
        tmp_path / "run",
    )
    assert main(
        f"demo --profile {profile} --terrain flat --no-video --out {out} --time-limit-s 1.5".split()
    ) in (0, 1)
    answers = read_recording(out / "recording.mcap").of(Heightmap)[100:]
    assert min(answer.depth_age_s for answer in answers) > 0.13
    assert {answer.status for answer in answers} == {HeightmapStatus.OK}
    assert main(["replay", f"{out}/recording.mcap", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["first_difference"] is None
