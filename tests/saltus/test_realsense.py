from pathlib import Path

import numpy as np
import pytest

from saltus.depth import MODEL_CAMERA, model_image
from saltus.errors import RecordingError
from saltus.heightmap.level_robot import LevelRobot
from saltus.heightmap.service.replay import replay_frames
from saltus.recordings.realsense import read_realsense
from saltus.resources import resource
from saltus.wire.messages import DepthFrame, HeightmapStatus

RECORDINGS = Path(__file__).resolve().parents[3] / "shared" / "data"
BAG = RECORDINGS / "realsense_d435_640x480.bag"


@pytest.fixture(scope="module")
def frames() -> list[DepthFrame]:
    if not RECORDINGS.is_dir():
        pytest.skip(f"no real recordings beside the checkout: {RECORDINGS} is absent")
    return list(read_realsense(BAG))


def test_unit_intrinsics_and_invalid_pixels_are_the_recordings_own(frames: list[DepthFrame]) -> None:
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
    image = model_image(frame)
    for row, column in ((5, 3), (24, 8), (40, 12)):
        if not image.valid[row, column]:
            continue
        edges_u = frame.cx + (column + np.array([0, 1]) - MODEL_CAMERA.cx) / MODEL_CAMERA.fx * frame.fx
        edges_v = frame.cy + (row + np.array([0, 1]) - MODEL_CAMERA.cy) / MODEL_CAMERA.fy * frame.fy
        (left, right), (top, bottom) = np.rint(edges_u).astype(int), np.rint(edges_v).astype(int)
        patch = frame.depth[top:bottom, left:right]
        expected = np.minimum(patch[patch > 0] * 0.001 / 3.0, 1.0)
        # The same patch in whole pixels: equal but for the pixels cut by its border.
        assert expected.min() - 0.02 <= image.depth[row, column] <= expected.max() + 0.02


def test_two_frames_without_a_robot_keep_warming(frames: list[DepthFrame]) -> None:
    answers = replay_frames(resource("models/heightmap.onnx"), frames, LevelRobot(base_height_m=0.3))
    assert [h.status for h in answers] == [HeightmapStatus.WARMING] * 2
    assert [h.frame_id for h in answers] == [0, 1]
    assert all(np.isfinite(h.height).all() for h in answers)


@pytest.mark.parametrize("content", [b"", b"#ROSBAG V2.0\n", b"\x00" * 5000])
def test_files_that_are_no_recordings_are_refused_by_name(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "broken.bag"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"broken\.bag"):
        list(read_realsense(path))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere\.bag"):
        list(read_realsense(tmp_path / "nowhere.bag"))
