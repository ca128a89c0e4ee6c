import json
from pathlib import Path

import numpy as np
import pytest
from realsense_bag import write_bag, write_database
from samples import ROBOT

from saltus.cli.main import main
from saltus.depth import MODEL_CAMERA, intrinsics_of, model_image
from saltus.errors import RecordingError
from saltus.heightmap.level_robot import LevelRobot
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.replay import replay_frames
from saltus.recordings.realsense import read_realsense
from saltus.resources import shipped_file
from saltus.wire.messages import DepthFrame, HeightmapStatus

RECORDINGS = Path(__file__).resolve().parents[3] / "shared" / "data"
BAG = RECORDINGS / "realsense_d435_640x480.bag"


@pytest.fixture(scope="module")
def frames() -> list[DepthFrame]:
    if not RECORDINGS.is_dir():
        pytest.skip(f"no real recordings beside the checkout: {RECORDINGS} is absent")
    return list(read_realsense(BAG))


def test_unit_intrinsics_and_invalid_pixels_are_the_recordings_own(
    frames: list[DepthFrame],
) -> None:
    assert [f.frame_id for f in frames] == [0, 1]
    assert frames[1].time_ns > frames[0].time_ns
    for frame in frames:
        assert frame.depth.shape == (480, 640)
        assert frame.depth_unit_m == 0.001
        # The file's camera_info counts from pixel centres.
        assert (frame.fx, frame.fy) == pytest.approx((390.43145752, 390.43145752))
        assert (frame.cx, frame.cy) == pytest.approx((331.38787842 + 0.5, 242.18734741 + 0.5))
        assert 0.02 < np.mean(frame.depth == 0) < 0.12
        assert 0.1 < np.median(frame.depth[frame.depth > 0]) * frame.depth_unit_m < 10.0


def test_the_crop_is_that_of_the_models_camera(frames: list[DepthFrame]) -> None:
    frame = frames[0]
    near, valid = model_image(frame.depth, intrinsics_of(frame), frame.depth_unit_m)
    for row, column in ((5, 3), (24, 8), (40, 12)):
        if not valid[row, column]:
            continue
        edges_u = (
            frame.cx + (column + np.array([0, 1]) - MODEL_CAMERA.cx) / MODEL_CAMERA.fx * frame.fx
        )
        edges_v = frame.cy + (row + np.array([0, 1]) - MODEL_CAMERA.cy) / MODEL_CAMERA.fy * frame.fy
        (left, right), (top, bottom) = np.rint(edges_u).astype(int), np.rint(edges_v).astype(int)
        patch = frame.depth[top:bottom, left:right]
        expected = np.minimum(patch[patch > 0] * 0.001 / 3.0, 1.0)
        # The same patch in whole pixels: equal but for the pixels cut by its border.
        assert expected.min() - 0.02 <= near[row, column] <= expected.max() + 0.02


def test_two_frames_without_a_robot_keep_warming(frames: list[DepthFrame]) -> None:
    network = HeightmapNetwork(ROBOT, shipped_file("models/heightmap.onnx"))
    answers = replay_frames(network, frames, LevelRobot(base_height_m=0.3))
    assert [h.status for h in answers] == [HeightmapStatus.WARMING] * 2
    assert [h.frame_id for h in answers] == [0, 1]
    assert all(np.isfinite(h.height).all() for h in answers)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("unit_m", [0.001, 0.0001, 0.00025])
def test_a_database_of_rosbag2_is_the_same_recording(
    tmp_path: Path, unit_m: float, packed: bool
) -> None:
    """As the SDK writes it since 2026; a D405 counts tenths of a millimetre, an L515 quarters."""
    mine = list(
        read_realsense(write_database(tmp_path / "desk.db3", 3, unit_m=unit_m, packed=packed))
    )
    for frame, other in zip(mine, read_realsense(write_bag(tmp_path / "desk.bag", 3)), strict=True):
        np.testing.assert_allclose(
            frame.depth * frame.depth_unit_m, other.depth * other.depth_unit_m
        )
        assert frame.depth_unit_m == unit_m
        for name in ("fx", "fy", "cx", "cy", "frame_id"):
            assert getattr(frame, name) == getattr(other, name)
    assert np.diff([frame.time_ns for frame in mine]).tolist() == [33_333_333] * 2


@pytest.mark.parametrize("name", ["desk.db3", "desk.bag"])
def test_a_camera_without_joints_is_no_run_log(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = (write_database if name.endswith("db3") else write_bag)(tmp_path / name)
    assert main(["real2sim", "import", str(path), "--out", str(tmp_path / "log")]) == 2
    assert f"`saltus render fit {path}`" in capsys.readouterr().err


@pytest.mark.parametrize("content", [b"", b"#ROSBAG V2.0\n", b"\x00" * 5000])
def test_files_that_are_no_recordings_are_refused_by_name(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "broken.bag"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"broken\.bag"):
        list(read_realsense(path))


@pytest.mark.parametrize("seed", range(12))
def test_a_damaged_recording_is_one_line_or_what_is_sound_of_it(
    tmp_path: Path, seed: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Cut off anywhere, or with some bytes changed."""
    path = write_bag(tmp_path / "desk.bag")
    data, rng = bytearray(path.read_bytes()), np.random.default_rng(seed)
    if seed % 3 == 0:
        data = data[: rng.integers(len(data))]
    else:
        for place in rng.integers(len(data), size=20):
            data[place] = rng.integers(256)
    path.write_bytes(data)
    code, told = main(["replay", str(path), "--assume-level"]), capsys.readouterr()
    assert code in (0, 2)
    assert "nan" not in told.out
    assert code == 0 or (told.err.startswith(f"saltus: {path}") or str(path) in told.err)
    assert told.err.count("\n") == (code == 2)


def test_a_short_recording_is_repeated_until_the_model_is_warm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "desk.bag", frames=2)
    command = ["replay", str(bag), "--assume-level", "--base-height-m", "0.3"]
    assert main([*command, "--json"]) == 0
    table = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert table["status"] == {"ok": 2}
    assert len(table["x"]) == len(table["height"]) == len(table["half_width_90"]) == 30
    assert table["height"][0] == pytest.approx(-0.3, abs=0.05)  # under the feet
    assert main(command) == 0
    told = capsys.readouterr().out
    assert "nan" not in told
    assert "height [m]" in told


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere\.bag"):
        list(read_realsense(tmp_path / "nowhere.bag"))
