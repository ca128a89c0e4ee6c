"""Images from and to ROS: their units, encodings, intrinsics and compression."""

import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from memory_bus import MemoryBus
from recorded import run_messages
from ros_frames import LOCKSTEP, frame_messages
from samples import ROBOT

from saltus.errors import ConfigError
from saltus.recordings import ros_messages as ros
from saltus.recordings.ros_images import info_of
from saltus.ros2.bridge import RosReceiver
from saltus.ros2.incoming import DEPTH, RosIntake
from saltus.ros2.outgoing import RosExporter
from saltus.wire.bus import RawSample, Slot


def padded(image: Any, kind: Callable[[Any], np.ndarray], encoding: str, spare: int) -> Any:
    """The same depths in another encoding, with so many spare bytes to a row."""
    depth = image.data.view(np.uint16).reshape(image.height, image.width)
    rows = np.ascontiguousarray(kind(depth)).view(np.uint8).reshape(image.height, -1)
    data = np.concatenate([rows, np.full((image.height, spare), 77, np.uint8)], axis=1)
    return replace(image, encoding=encoding, step=data.shape[1], data=data.ravel())


def metres(depth: np.ndarray) -> np.ndarray:
    values = 1e-3 * depth.astype(np.float32)
    values[depth == 0] = np.nan
    values[depth == 65535] = np.inf
    return values.astype(np.float32)


@pytest.mark.parametrize("spare", [0, 8])
@pytest.mark.parametrize(
    ("kind", "encoding"), [(np.asarray, "16UC1"), (np.asarray, "mono16"), (metres, "32FC1")]
)
def test_depth_images_of_both_kinds_are_the_same_millimetres(
    kind: Any, encoding: str, spare: int
) -> None:
    frame, image, info = frame_messages()
    intake = RosIntake(ROBOT, LOCKSTEP)
    now_ns = frame.time_ns
    assert intake.take("depth", ros.payload_of(image), now_ns) is None
    assert dict(intake.rejected) == {"depth/no_camera_info": 1}
    intake.take("camera_info", ros.payload_of(info), now_ns)
    taken = intake.take("depth", ros.payload_of(padded(image, kind, encoding, spare)), now_ns)
    assert taken is not None
    np.testing.assert_array_equal(taken.depth, frame.depth)
    assert (taken.fx, taken.fy, taken.cx, taken.cy, taken.time_ns) == (
        frame.fx,
        frame.fy,
        frame.cx,
        frame.cy,
        frame.time_ns,
    )
    assert (taken.depth_unit_m, taken.frame_id) == (0.001, 0)


@pytest.mark.parametrize("ending", ["", "/compressedDepth"])
def test_images_of_each_camera_go_to_its_own_key_with_its_own_intrinsics(ending: str) -> None:
    """They come in turns; a second camera may be compressed where the first is not."""
    slots = dict[str, Slot]()

    class Graph:
        def subscribe(self, topic: str, kind: str, hash_: str, slot: Slot) -> None:
            assert hash_ == ros.hash_of(kind)
            slots[topic] = slot

    class Now:
        now_ns = staticmethod(lambda: frame.time_ns)

    frame, image, info = frame_messages()
    rear = f"/rear/depth/image_rect_raw{ending}"
    topics = dict.fromkeys(("imu", "odometry"), "/it")
    topics |= {"depth": DEPTH, "camera_info": info_of(DEPTH), "depth/rear": rear}
    topics["camera_info/rear"] = info_of(rear)
    assert topics["camera_info/rear"] == "/rear/depth/camera_info"
    intake = RosIntake(ROBOT, LOCKSTEP, has_joints=False, cameras={"rear": rear})
    bus = MemoryBus("robot/0")
    latests = {name: bus.latest("camera/depth", name) for name in ("", "rear")}
    receiver = RosReceiver(bus, Graph(), intake, topics, Now(), [].append)  # type: ignore[arg-type]
    longer = np.asarray(info.p) * np.where(np.arange(12) == 0, 1.5, 1.0)
    infos = {info_of(DEPTH): info, info_of(rear): replace(info, p=longer)}
    depth = np.where(frame.depth == 65535, 0, frame.depth).astype(np.uint16)
    plain = padded(image, lambda _: depth, "16UC1", 0)
    other = plain if not ending else ros.make(
        "sensor_msgs/msg/CompressedImage", header=image.header, format="16UC1; compressedDepth",
        data=packed(depth, "16UC1"),
    )  # fmt: skip

    def receive(messages: dict[str, Any]) -> None:
        for topic, message in messages.items():
            slots[topic].push(RawSample(topic, ros.payload_of(message), b"", 0))
        receiver.step()

    receive(infos)
    for number in range(3):
        receive({DEPTH: plain, rear: other})
        for name, scale in (("", 1.0), ("rear", 1.5)):
            sample = latests[name].take()
            assert sample is not None
            np.testing.assert_array_equal(sample.message.depth, depth)
            assert sample.message.fx == pytest.approx(scale * frame.fx)
            assert sample.message.frame_id == number
    assert not intake.rejected


def packed(depth_mm: np.ndarray, form: str) -> np.ndarray:
    """As the transport compressedDepth packs an image:
    a head of 12 bytes, and a PNG of depth or of its inverse.
    """
    a, b = 2000.0, 0.5
    whole = depth_mm
    if form.startswith("32FC1"):
        with np.errstate(divide="ignore"):
            whole = np.where(depth_mm == 0, 0, np.clip(1e3 * a / depth_mm + b, 1, 65535)).astype(
                np.uint16
            )
    return np.frombuffer(
        struct.pack("<iff", 0, a, b) + cv2.imencode(".png", whole)[1].tobytes(), np.uint8
    )


def big_endian(image: Any) -> Any:
    kind = np.dtype("f4" if image.encoding == "32FC1" else "u2")
    return replace(image, is_bigendian=1, data=image.data.view(kind).byteswap().view(np.uint8))


@pytest.mark.parametrize(
    ("kind", "encoding"), [(np.asarray, "16UC1"), (np.asarray, "mono16"), (metres, "32FC1")]
)
def test_images_of_big_endian_computers_are_the_same(kind: Any, encoding: str) -> None:
    frame, image, info = frame_messages()
    intake = RosIntake(ROBOT, LOCKSTEP)
    intake.take("camera_info", ros.payload_of(info), frame.time_ns)
    taken = intake.take(
        "depth", ros.payload_of(big_endian(padded(image, kind, encoding, 0))), frame.time_ns
    )
    assert taken is not None
    np.testing.assert_array_equal(taken.depth, frame.depth)


@pytest.mark.parametrize(
    ("form", "tolerance_mm"), [("16UC1; compressedDepth", 0), ("32FC1; compressedDepth png", 5)]
)
def test_compressed_images_are_the_same(form: str, tolerance_mm: int) -> None:
    frame, image, info = frame_messages()
    depth = image.data.view(np.uint16).reshape(image.height, image.width)
    # An inverse has no sign for it
    depth = np.where((depth == 65535) | (depth < 100), 0, depth).astype(np.uint16)
    topic = "/camera/depth/image_rect_raw/compressedDepth"
    intake = RosIntake(ROBOT, LOCKSTEP, depth=topic)
    assert intake.type_of("depth") == "sensor_msgs/msg/CompressedImage"
    intake.take("camera_info", ros.payload_of(info), frame.time_ns)
    sent = ros.make(
        "sensor_msgs/msg/CompressedImage",
        header=image.header,
        format=form,
        data=packed(depth, form),
    )
    taken = intake.take("depth", ros.payload_of(sent), frame.time_ns)
    assert taken is not None
    np.testing.assert_allclose(taken.depth.astype(float), depth, rtol=0, atol=tolerance_mm)
    for bad in (
        replace(sent, data=sent.data[: len(sent.data) // 2]), replace(sent, data=sent.data[:20]),
        replace(sent, format="16UC1; compressedDepth rvl", data=np.arange(99, dtype=np.uint8)),
    ):  # fmt: skip
        assert intake.take("depth", ros.payload_of(bad), frame.time_ns) is None
    assert sum(intake.rejected.values()) == 3


@pytest.mark.parametrize(
    ("name", "of_p"), [("image_rect_raw", True), ("image_rect", True), ("image_raw", False)]
)
def test_rectified_images_have_the_projection_and_raw_ones_the_matrix(
    name: str, of_p: bool
) -> None:
    frame, image, info = frame_messages()
    p = np.array([44.0, 0, 31, 0, 0, 45, 23, 0, 0, 0, 1, 0])
    intake = RosIntake(ROBOT, LOCKSTEP, depth=f"/camera/depth/{name}")
    intake.take("camera_info", ros.payload_of(replace(info, p=p)), frame.time_ns)
    taken = intake.take("depth", ros.payload_of(image), frame.time_ns)
    assert taken is not None
    expected = (44.0, 45.0, 31.5, 23.5) if of_p else (frame.fx, frame.fy, frame.cx, frame.cy)
    assert (taken.fx, taken.fy, taken.cx, taken.cy) == pytest.approx(expected)


def test_binning_and_the_region_of_interest_count() -> None:
    frame, image, info = frame_messages()
    region = replace(
        info.roi, x_offset=20, y_offset=10, width=2 * image.width, height=2 * image.height
    )
    large = replace(
        info, width=info.width + 200, height=info.height + 100, binning_x=2, binning_y=2, roi=region
    )
    large = replace(large, width=2 * large.width, height=2 * large.height)
    intake = RosIntake(ROBOT, LOCKSTEP)
    intake.take("camera_info", ros.payload_of(large), frame.time_ns)
    taken = intake.take("depth", ros.payload_of(image), frame.time_ns)
    assert taken is not None
    assert (taken.fx, taken.cx, taken.cy) == pytest.approx(
        (frame.fx / 2, (frame.cx - 20) / 2, (frame.cy - 10) / 2)
    )


@pytest.mark.parametrize("unit_m", [1e-4, 2.5e-4])
def test_a_stated_unit_of_depth_images_goes_along_and_keeps_its_steps(unit_m: float) -> None:
    frame, image, info = frame_messages()
    intake = RosIntake(ROBOT, LOCKSTEP, depth_unit_m=unit_m)
    intake.take("camera_info", ros.payload_of(info), frame.time_ns)
    taken = intake.take("depth", ros.payload_of(image), frame.time_ns)
    assert taken is not None
    np.testing.assert_array_equal(taken.depth, frame.depth)
    assert taken.depth_unit_m == unit_m
    with pytest.raises(ConfigError, match="depth_unit_m = 10: 1e-06 to 1 m"):
        RosIntake(ROBOT, LOCKSTEP, depth_unit_m=10.0)


def test_images_of_32_bit_in_millimetres_are_refused_until_their_unit_is_stated() -> None:
    """They would all be cut to 65.5 m."""
    frame, image, info = frame_messages()
    wrong = padded(image, lambda pixels: 1e3 * metres(pixels), "32FC1", 0)
    for unit_m in (None, 0.001):
        intake = RosIntake(ROBOT, LOCKSTEP, depth_unit_m=unit_m)
        intake.take("camera_info", ros.payload_of(info), frame.time_ns)
        taken = intake.take("depth", ros.payload_of(wrong), frame.time_ns)
        assert (taken is None) == (unit_m is None)
        assert dict(intake.rejected) == ({"depth/depth_unit": 1} if unit_m is None else {})
        if taken is not None:
            np.testing.assert_array_equal(taken.depth, frame.depth)
            assert taken.depth_unit_m == 0.001


@pytest.mark.parametrize("unit_m", [1e-4, 1e-3, 2.5e-3])
def test_depth_for_ros_is_in_millimetres_and_0_where_there_is_none(unit_m: float) -> None:
    frame: Any = replace(dict(run_messages(2))["camera/depth"], depth_unit_m=unit_m)  # type: ignore[arg-type]
    (image, _) = (out.message for out in RosExporter(ROBOT, LOCKSTEP).of_frame(frame))
    pixels = image.data.view(np.uint16).reshape(frame.depth.shape).astype(float)
    nothing = (frame.depth == 0) | (frame.depth == 65535)
    assert nothing.any()
    assert (pixels[nothing] == 0).all()
    np.testing.assert_allclose(pixels[~nothing], 1e3 * unit_m * frame.depth[~nothing], atol=0.5)
