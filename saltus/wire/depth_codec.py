"""The codec of depth images: a `sensor_msgs/Image`
and the `sensor_msgs/CameraInfo` that goes with it.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import AnyArray, Floats
from saltus.errors import MessageError
from saltus.wire import schemas
from saltus.wire.cdr import STORE, check_bounded, make_ros_header, time_of
from saltus.wire.message_templates import TemplateHole
from saltus.wire.messages import DepthFrame
from saltus.wire.ros_types import RosCameraInfo, RosImage, RosRegionOfInterest, StampedRosMessage

WIDTH_MAX, HEIGHT_MAX = 1280, 720  # D435i datasheet: the largest depth image
DEPTH_UNIT_MAX_M = 0.1
FOCAL_MIN_PX, FOCAL_MAX_PX = 1.0, 3400.0
"""With a longer lens the widest image sees less than the heightmap model does, 21.4 degrees
across."""
CENTRE_MAX_PX = 1e5
ENCODING = "16UC1"
_IMAGE: Callable[..., RosImage] = STORE.types["sensor_msgs/msg/Image"]
_CAMERA_INFO: Callable[..., RosCameraInfo] = STORE.types["sensor_msgs/msg/CameraInfo"]
_REGION: Callable[..., RosRegionOfInterest] = STORE.types["sensor_msgs/msg/RegionOfInterest"]


class Lens(RosCameraInfo, Protocol):
    """The calibration as ROS 2 names it."""

    k: Floats


class DepthOnTheWire(StampedRosMessage, Protocol):
    """A depth image as it travels."""

    image: RosImage
    camera_info: Lens
    depth_unit_m: float
    frame_id: int


def _pixels_of(depth: AnyArray) -> NDArray[np.uint16]:
    if depth.dtype != np.uint16 or depth.ndim != 2:
        raise MessageError("shape", f"depth is {depth.dtype} of shape {depth.shape}")
    return np.ascontiguousarray(depth)


DEPTH_HOLES = (
    TemplateHole("frame_id", "i8", False, False, int, 0, schemas.INDEX_MAX),
    TemplateHole("depth", "u2", True, True, _pixels_of),
)
"""Fields that change from image to image."""
DEPTH_FIXED = ("depth_unit_m", "fx", "fy", "cx", "cy")
"""Fields that stay as long as the camera does."""


def depth_on_the_wire(message: DepthFrame) -> DepthOnTheWire:
    """A depth image as it travels: with a `sensor_msgs/Image`
    and the `sensor_msgs/CameraInfo` that goes with it.
    """
    depth = _pixels_of(message.depth)
    height, width = depth.shape
    head = make_ros_header(message.time_ns, schemas.FRAME[DepthFrame])
    pixels = depth.view(np.uint8).reshape(-1)
    image = _IMAGE(head, height, width, ENCODING, 0, 2 * width, pixels)
    lens = _calibration(
        *(float(value) for value in (message.fx, message.fy, message.cx, message.cy))
    )
    info = _CAMERA_INFO(head, height, width, "plumb_bob", *lens, 0, 0, _REGION(0, 0, 0, 0, False))
    wire_type: Callable[..., DepthOnTheWire] = STORE.types[schemas.DEPTH_TYPE]
    return wire_type(head, image, info, float(message.depth_unit_m), int(message.frame_id))


@lru_cache(maxsize=16)
def _calibration(fx: float, fy: float, cx: float, cy: float) -> tuple[Floats, ...]:
    """Distortion, intrinsics, rotation and projection of a `sensor_msgs/msg/CameraInfo`."""
    u, v = cx - 0.5, cy - 0.5  # ROS counts pixel centres at integers, this project at halves
    intrinsics = np.array([fx, 0, u, 0, fy, v, 0, 0, 1], np.float64)
    projection = np.array([fx, 0, u, 0, 0, fy, v, 0, 0, 0, 1, 0], np.float64)
    return np.zeros(5), intrinsics, np.eye(3).reshape(-1), projection


def decode_depth(wire: DepthOnTheWire) -> DepthFrame:
    """The depth image of what travels; `MessageError` where it is not plausible."""
    image, info = wire.image, wire.camera_info
    if image.encoding != ENCODING or image.is_bigendian:
        raise MessageError(
            "encoding",
            f"{image.encoding!r}, big-endian {image.is_bigendian}: only {ENCODING} travels",
        )
    if not (1 <= image.height <= HEIGHT_MAX and 1 <= image.width <= WIDTH_MAX):
        raise MessageError(
            "shape", f"{image.width}x{image.height}, at most {WIDTH_MAX}x{HEIGHT_MAX}"
        )
    if image.step != 2 * image.width or image.data.size != image.step * image.height:
        raise MessageError("shape", f"{image.data.size} bytes for {image.width}x{image.height}")
    if (info.height, info.width) != (image.height, image.width):
        raise MessageError("shape", f"intrinsics are for {info.width}x{info.height}")
    fx, cx, fy, cy = (float(info.k[i]) for i in (0, 2, 4, 5))
    for name, value in (("fx", fx), ("fy", fy)):
        check_bounded(name, value, FOCAL_MIN_PX, FOCAL_MAX_PX)
    for name, value in (("cx", cx), ("cy", cy)):
        check_bounded(name, value, -CENTRE_MAX_PX, CENTRE_MAX_PX)
    check_bounded("depth_unit_m", wire.depth_unit_m, 1e-6, DEPTH_UNIT_MAX_M)
    check_bounded("frame_id", wire.frame_id, 0, schemas.INDEX_MAX)
    return DepthFrame(
        time_ns=time_of(wire.header.stamp),
        frame_id=wire.frame_id,
        depth=image.data.view(np.uint16).reshape(image.height, image.width),
        depth_unit_m=wire.depth_unit_m,
        fx=fx,
        fy=fy,
        cx=cx + 0.5,
        cy=cy + 0.5,
    )
