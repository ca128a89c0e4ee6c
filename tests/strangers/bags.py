"""Bags of ROS: of both versions and all storages, with the topics,
images and calibrations that robots have.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from ros_bag import RosBag, put_joints, put_odometry, put_turns
from rosbags import rosbag1

from saltus.recordings.run_log import RunLog
from strangers.stranger import same_joints, truth

CAMERA: dict[str, Any] = truth().meta["camera"]
HEIGHT, WIDTH = 48, 64
DEPTH, INFO = "/camera/depth/image_rect_raw", "/camera/depth/camera_info"


@dataclass(frozen=True, kw_only=True)
class Images:
    """How a camera's images come."""

    topic: str = DEPTH
    info_topic: str = INFO
    encoding: str = "16UC1"
    big_endian: bool = False
    padding: int = 0
    """Bytes after each row."""
    compression: str = ""
    """Format of a CompressedImage; an Image if empty."""
    k: tuple[float, float, float, float] = (
        CAMERA["fx"],
        CAMERA["fy"],
        CAMERA["cx"] - 0.5,
        CAMERA["cy"] - 0.5,
    )
    p: tuple[float, float, float, float] | None = None
    """fx, fy, cx, cy of the projection, if it is not K."""
    binning: int = 0
    roi: tuple[int, int, int, int] = (0, 0, 0, 0)
    """x, y, width, height."""
    info_size: tuple[int, int] = (WIDTH, HEIGHT)
    unstamped: tuple[int, ...] = ()
    """Images with a stamp of 0."""
    small: tuple[int, ...] = ()
    """Images of half the size."""
    has_info: bool = True


@dataclass(frozen=True, kw_only=True)
class Bag:
    """The contents of a bag."""

    kind: str = "mcap"
    compression: str = ""
    """Compression of a bag of ROS 1: BZ2 or LZ4."""
    chunk_bytes: int = 2**20
    """Bytes of which a bag of ROS 1 makes a chunk."""
    images: tuple[Images, ...] = (Images(),)
    gripper: bool = False
    """Another program tells a joint of its own on the topic of the legs; no command names it."""
    change: Callable[[RunLog], RunLog] = lambda log: log
    start_s: float = 1_763_740_800.0
    """Start of the stamps: real robots count from 1970."""


def write(bag: Bag, folder: Path) -> Path:
    path = folder / ("run.bag" if bag.kind == "ros1" else "run")
    log = bag.change(later(truth(), bag.start_s))
    out = RosBag(path, bag.kind)
    if bag.compression:
        out.writer.set_compression(rosbag1.Writer.CompressionFormat[bag.compression])
        out.writer.chunk_threshold = bag.chunk_bytes
    with out:
        put_joints(out, log, has_commands=True)
        put_turns(out, log)
        if bag.gripper:
            for row in range(0, len(log.joints.time_s), 5):
                time_s = float(log.joints.time_s[row]) + 1e-3
                fields = {name: np.array([0.5]) for name in ("position", "velocity", "effort")}
                out.put(
                    "/joint_states",
                    "sensor_msgs/msg/JointState",
                    time_s,
                    name=["gripper"],
                    **fields,
                )
        for row in (
            zip(log.base.time_s, log.base.values, strict=True) if log.base is not None else ()
        ):
            put_odometry(out, *row)
        for images in bag.images:
            put_images(out, log, images)
    return path


def later(log: RunLog, start_s: float) -> RunLog:
    assert log.imu is not None
    assert log.base is not None
    assert log.depth is not None
    assert log.depth.capture_s is not None
    moved = {
        name: replace(getattr(log, name), time_s=getattr(log, name).time_s + start_s)
        for name in ("joints", "imu", "base")
    }
    depth = replace(
        log.depth, arrival_s=log.depth.arrival_s + start_s, capture_s=log.depth.capture_s + start_s
    )
    return replace(log, depth=depth, **moved)


def put_images(bag: RosBag, log: RunLog, images: Images) -> None:
    depth = log.depth
    assert depth is not None
    assert depth.capture_s is not None
    for number, (image, capture_s, arrival_s) in enumerate(
        zip(depth.depth_mm, depth.capture_s, depth.arrival_s, strict=True)
    ):
        times = (0.0 if number in images.unstamped else float(capture_s), float(arrival_s))
        shown = image[::2, ::2] if number in images.small else image
        if images.compression:
            bag.put(
                images.topic,
                "sensor_msgs/msg/CompressedImage",
                *times,
                format=images.compression,
                data=packed(shown, images.compression),
            )
        else:
            data = pixels(shown, images)
            bag.put(
                images.topic, "sensor_msgs/msg/Image", *times, height=shown.shape[0],
                width=shown.shape[1],
                encoding=images.encoding, is_bigendian=int(images.big_endian), step=data.shape[1],
                data=data.ravel(),
            )  # fmt: skip
        if images.has_info:
            bag.put(
                images.info_topic, "sensor_msgs/msg/CameraInfo", *times, **calibration(bag, images)
            )


def calibration(bag: RosBag, images: Images) -> dict[str, Any]:
    fx, fy, cx, cy = images.k
    px, py, pcx, pcy = images.p or images.k
    x, y, width, height = images.roi
    named = {
        "D": np.zeros(5), "K": np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]), "R": np.eye(3).ravel(),
        "P": np.array([px, 0, pcx, 0, 0, py, pcy, 0, 0, 0, 1.0, 0]),
    }  # fmt: skip
    region = bag.make(
        "sensor_msgs/msg/RegionOfInterest",
        x_offset=x,
        y_offset=y,
        width=width,
        height=height,
        do_rectify=False,
    )
    fields = named if bag.is_ros1 else {name.lower(): values for name, values in named.items()}
    return {
        "height": images.info_size[1], "width": images.info_size[0],
        "distortion_model": "plumb_bob", **fields,
        "binning_x": images.binning, "binning_y": images.binning, "roi": region,
    }  # fmt: skip


def pixels(depth_mm: np.ndarray, images: Images) -> np.ndarray:
    """Bytes of an image, shape (height, step)."""
    kinds = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4", "mono8": "u1", "rgb8": "u1"}
    values: np.ndarray = depth_mm
    if images.encoding == "32FC1":
        values = np.where(depth_mm == 0, np.nan, 1e-3 * depth_mm)
    if images.encoding == "rgb8":
        values = np.repeat(depth_mm // 16, 3, axis=1)
    if images.encoding == "mono8":
        values = depth_mm // 16
    kind = np.dtype(kinds[images.encoding]).newbyteorder(">" if images.big_endian else "<")
    rows = np.ascontiguousarray(values.astype(kind)).view(np.uint8).reshape(len(depth_mm), -1)
    return np.pad(rows, ((0, 0), (0, images.padding)), constant_values=7)


INVERSE = (5000.0, 0.25)
"""Constants that make depth [m] inverse: number = a / depth + b."""


def packed(depth_mm: np.ndarray, form: str) -> np.ndarray:
    """An image as the transports of ROS compress it."""
    if "rvl" in form or "jpeg" in form:
        return np.arange(99, dtype=np.uint8)
    whole, head = depth_mm, struct.pack("<iff", 0, 0.0, 0.0)
    if form.startswith("32FC1"):
        a, b = INVERSE
        with np.errstate(divide="ignore"):
            whole = np.where(depth_mm == 0, 0, np.clip(a / (1e-3 * depth_mm) + b, 1, 65535)).astype(
                np.uint16
            )
        head = struct.pack("<iff", 0, a, b)
    data = cv2.imencode(".png", whole)[1].tobytes()
    return np.frombuffer(data if "compressedDepth" not in form else head + data, np.uint8)


def same_log(
    log: RunLog, *, lacks: tuple[str, ...] = (), lens: tuple[float, ...] | None = None,
    kept: tuple[int, ...] | None = None, step: int = 1, atol_mm: float = 0.0,
    tables: tuple[str, ...] = ("imu", "base"),
) -> None:  # fmt: skip
    """All is that of the truth; `lens` is fx, fy, cx, cy,
    `kept` the images that are there, `lacks` what is not.
    """
    true = truth()
    same_joints(
        log,
        lacks=(
            *lacks,
            *(name for name in ("dq_des", "tau_ff") if getattr(true.joints, name) is None),
        ),
    )
    for name in ("imu", "base"):
        found, expected = getattr(log, name), getattr(true, name)
        assert (found is not None) == (name in tables and name not in lacks), name
        if found is not None:
            np.testing.assert_allclose(found.values, expected.values, rtol=0, atol=1e-9)
            np.testing.assert_allclose(found.time_s, expected.time_s, rtol=0, atol=1e-6)
    if "depth" in lacks:
        assert log.depth is None
        return
    assert log.depth is not None
    assert true.depth is not None
    assert true.depth.capture_s is not None
    rows = list(kept) if kept is not None else list(range(len(true.depth.depth_mm)))
    expected = true.depth.depth_mm[rows][:, ::step, ::step].astype(float)
    np.testing.assert_allclose(log.depth.depth_mm.astype(float), expected, rtol=0, atol=atol_mm)
    assert log.depth.capture_s is not None
    np.testing.assert_allclose(log.depth.capture_s, true.depth.capture_s[rows], rtol=0, atol=1e-6)
    np.testing.assert_allclose(log.depth.arrival_s, true.depth.arrival_s[rows], rtol=0, atol=1e-6)
    if "camera" in lacks:
        assert "fx" not in log.meta.get("camera", {})
        return
    camera = log.meta["camera"]
    own = lens or tuple(CAMERA[key] for key in ("fx", "fy", "cx", "cy"))
    np.testing.assert_allclose([camera[key] for key in ("fx", "fy", "cx", "cy")], own, rtol=1e-9)
    assert (camera["width"], camera["height"]) == (
        log.depth.depth_mm.shape[2],
        log.depth.depth_mm.shape[1],
    )
