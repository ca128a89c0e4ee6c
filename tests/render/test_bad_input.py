"""What no back end can render is refused in one line that names it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from samples import ROBOT

from saltus.cli.main import main
from saltus.config import TerrainConfig
from saltus.depth import MODEL_CAMERA
from saltus.errors import SaltusError
from saltus.render.backends import make_renderer
from saltus.render.camera import RobotCamera
from saltus.render.embree import EmbreeRenderer
from saltus.render.renderer import Renderer
from saltus.robots.mount import Mount
from saltus.terrain.curriculum import make_terrain

FLAT = make_terrain(TerrainConfig(terrain="flat"))
POSE = np.array([0.0, 0.0, 0.3]), np.array([1.0, 0.0, 0.0, 0.0]), ROBOT.stand_pose
BACK_ENDS = ("embree", "pyrender", "warp")


def one_line(error: pytest.ExceptionInfo[SaltusError]) -> str:
    message = str(error.value)
    assert message
    assert "\n" not in message
    return message


@pytest.mark.parametrize("back_end", BACK_ENDS)
@pytest.mark.parametrize(
    ("name", "value"),
    [("fx", 0.0), ("fy", -1.0), ("fx", np.nan), ("cx", np.inf), ("width", 0), ("height", -48)],
)
def test_camera(back_end: str, name: str, value: float) -> None:
    with pytest.raises(SaltusError) as error:
        make_renderer(back_end, FLAT, RobotCamera.on(ROBOT, replace(MODEL_CAMERA, **{name: value})))
    assert f"{name} = {value}" in one_line(error)


@pytest.mark.parametrize("position", [[0.0, 0.0, 0.0], [0.18, 0.04, -0.05]])
def test_camera_inside_the_robot(position: list[float]) -> None:
    with pytest.raises(SaltusError) as error:
        EmbreeRenderer(
            FLAT,
            replace(
                RobotCamera.on(ROBOT), mount=replace(Mount.of(ROBOT), position=np.array(position))
            ),
        )
    assert "inside the robot" in one_line(error)


@pytest.mark.parametrize(
    "mount",
    [
        replace(Mount.of(ROBOT), pitch=float("nan")),
        replace(Mount.of(ROBOT), position=np.array([np.nan, 0.0, 0.2])),
    ],
    ids=["pitch", "position"],
)
def test_mount(mount: Mount) -> None:
    with pytest.raises(SaltusError) as error:
        EmbreeRenderer(FLAT, replace(RobotCamera.on(ROBOT), mount=mount))
    assert "finite" in one_line(error)


@pytest.fixture(params=BACK_ENDS)
def renderer(request: pytest.FixtureRequest) -> Any:
    return make_renderer(request.param, FLAT, RobotCamera.on(ROBOT))


@pytest.mark.parametrize("argument", range(3))
def test_poses(renderer: Renderer, argument: int) -> None:
    broken = [array.copy() for array in POSE]
    broken[argument][1] = np.nan
    with pytest.raises(SaltusError) as error:
        renderer.render(*broken)
    assert "of pose 0" in one_line(error)
    broken[argument] = POSE[argument][1:]
    with pytest.raises(SaltusError) as error:
        renderer.render(*broken)
    assert "shape" in one_line(error)


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """What the command line says of them, in one line."""
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("saltus: ")
    assert printed.err.count("\n") == 1
    return printed.err


def bag(
    path: Path, sizes: list[tuple[int, int]], info: dict[str, float], row_bytes: int | None = None
) -> Path:
    """A RealSense recording of a wall: images of the given widths and heights,
    and the intrinsics they come with.
    """
    store = get_typestore(Stores.ROS1_NOETIC)
    time, header, region = (
        store.types[name]
        for name in (
            "builtin_interfaces/msg/Time",
            "std_msgs/msg/Header",
            "sensor_msgs/msg/RegionOfInterest",
        )
    )
    stream = "/device_0/sensor_0/Depth_0"
    k = np.array(
        [info["fx"], 0.0, info["cx"] - 0.5, 0.0, info["fx"], info["cy"] - 0.5, 0.0, 0.0, 1.0]
    )
    camera = store.types["sensor_msgs/msg/CameraInfo"](
        header(0, time(0, 0), ""), int(info["height"]), int(info["width"]), "", np.zeros(5), k,
        np.eye(3).ravel(),
        np.zeros(12), 0, 0, region(0, 0, 0, 0, False),
    )  # fmt: skip
    with Writer(path) as writer:
        connection = writer.add_connection(
            f"{stream}/info/camera_info", "sensor_msgs/msg/CameraInfo", typestore=store
        )
        writer.write(connection, 0, store.serialize_ros1(camera, "sensor_msgs/msg/CameraInfo"))
        connection = writer.add_connection(
            f"{stream}/image/data", "sensor_msgs/msg/Image", typestore=store
        )
        for index, (width, height) in enumerate(sizes):
            pixels = np.full(width * height, 1000, dtype="<u2").view(np.uint8)
            image = store.types["sensor_msgs/msg/Image"](
                header(index, time(index, 0), ""),
                height,
                width,
                "mono16",
                0,
                row_bytes or 2 * width,
                pixels,
            )
            writer.write(connection, index, store.serialize_ros1(image, "sensor_msgs/msg/Image"))
    return path


OF_424 = {"width": 424, "height": 240, "fx": 211.3, "cx": 213.5, "cy": 120.0}


@pytest.mark.parametrize(
    ("sizes", "info", "said"),
    [
        ([(640, 480)] * 2, OF_424, "640x480 do not match the intrinsics, which are for 424x240"),
        (
            [(640, 480)] * 2,
            {**OF_424, "width": 640, "height": 480},
            "taken from another resolution",
        ),
        ([(424, 240)] * 2, {**OF_424, "fx": 0.0}, "its fx is 0,"),
        ([(424, 240)] * 2, {**OF_424, "fx": np.nan}, "its fx is nan,"),
        ([(424, 240)] * 2, {**OF_424, "cy": np.inf}, "its cy is inf,"),
        ([(424, 240), (848, 480)], OF_424, "do not match the intrinsics"),
    ],
)
def test_fit_of_a_recording_that_does_not_match_itself(
    sizes: list[tuple[int, int]],
    info: dict[str, float],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = bag(tmp_path / "wall.bag", sizes, info)
    assert said in refused(["render", "fit", str(path), "--out", str(tmp_path / "fit")], capsys)
    assert not (tmp_path / "fit").exists()


def test_fit_of_images_that_are_cut_off(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = bag(tmp_path / "wall.bag", [(424, 240)], OF_424, row_bytes=1000)
    assert "1000 to a row" in refused(["render", "fit", str(path)], capsys)


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        ("camera_position = [0, 0, 0]", "inside the robot"),
        ("sensor = {width = 640, height = 480, fx = 0.0, fy = 400.0}", "fx = 0.0"),
        ("stereo.edge_holes.fraction = 2.0", "edge_holes.fraction = 2.0"),
    ],
)
def test_preview_through_a_camera_that_cannot_be(
    camera: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "camera.toml").write_text(camera)
    out = tmp_path / "preview"
    assert said in refused(
        ["render", "preview", "--camera", str(tmp_path / "camera.toml"), "--out", str(out)], capsys
    )
    assert not out.exists()
