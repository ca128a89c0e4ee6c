"""Depth images and calibrations as ROS carries them, raw or compressed:
pixels, and the camera that took them.

A recording and a live robot are read by the same lines. Whatever a message claims is checked before
it is believed.
"""

import re
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from saltus.arrays import AnyArray
from saltus.depth import MILLIMETRE, NOTHING
from saltus.errors import MessageError
from saltus.wire.ros_types import AnyRosImage, RosCameraInfo, RosCompressedImage, RosImage

if TYPE_CHECKING:
    from typing_extensions import TypeIs

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
ENCODINGS = {"mono16": "u2", "16UC1": "u2", "32FC1": "f4"}
"""Encodings of depth images. Whole numbers count a unit, which is a millimetre (REP 118) unless
somebody says otherwise; others are metres."""
# A camera_info's principal point counts from the centre of the first pixel, ours from its corner
PIXEL_CENTRE = 0.5
PIXELS_MAX = 2**24  # of a compressed image: its few bytes could claim any size
TRANSPORTS = ("/compressedDepth", "/compressed")
"""Endings of topics whose images are those of the topic without."""
PNG = b"\x89PNG\r\n\x1a\n"
# Before a compressedDepth image: a number that means nothing, and two of the inverse
INVERSE = struct.Struct("<iff")


def base_topic(topic: str) -> str:
    """The topic of the raw images, of one that may carry them compressed."""
    for ending in TRANSPORTS:
        topic = topic.removesuffix(ending)
    return topic


def info_of(topic: str) -> str:
    """The topic of the CameraInfo of images, where cameras of ROS have it: beside them."""
    return base_topic(topic).rpartition("/")[0] + "/camera_info"


def is_rectified(topic: str) -> bool:
    """True for a topic of rectified images by its name.

    Depth that says neither "rect" nor "raw" mostly is.
    """
    words = re.split(r"[\W_]+", base_topic(topic).rpartition("/")[2].lower())
    return "rect" in words or "rectified" in words or "raw" not in words


def is_raw(image: AnyRosImage) -> "TypeIs[RosImage]":
    """True for an Image, false for a CompressedImage."""
    return hasattr(image, "encoding")


def encoding_text(image: AnyRosImage) -> str:
    """Text that says how an image's pixels are encoded: `16UC1`, or `16UC1 by rvl`
    for a CompressedImage that RVL compresses.
    """
    if is_raw(image):
        return str(image.encoding)
    encoding, _, form = str(image.format).partition(";")
    return (
        f"{encoding.strip()} by {form.split()[-1]}" if "rvl" in form.lower() else encoding.strip()
    )


def is_depth(image: AnyRosImage) -> bool:
    """True for an Image or a CompressedImage whose pixels are depth."""
    if is_raw(image):
        return image.encoding in ENCODINGS
    return "compressedDepth" in image.format or encoding_text(image) in ENCODINGS


def pixels_of(image: AnyRosImage) -> AnyArray:
    """Pixels of an Image or a CompressedImage, shape (height, width): uint16, or float32 in metres.

    Raises:
        MessageError: it is no depth image, or has another size than it says.
    """
    if not is_raw(image):
        return _unpacked(image)
    if image.encoding not in ENCODINGS:
        raise MessageError("encoding", f"'{image.encoding}', not one of {', '.join(ENCODINGS)}")
    kind = np.dtype(ENCODINGS[image.encoding]).newbyteorder(">" if image.is_bigendian else "<")
    used = kind.itemsize * image.width
    if (
        not image.width
        or not image.height
        or image.step < used
        or len(image.data) != image.step * image.height
    ):
        raise MessageError(
            "size",
            f"{len(image.data)} bytes, {image.step} to a row, for {image.width}x{image.height}",
        )
    rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)[:, :used]
    return np.ascontiguousarray(rows).view(kind).astype(kind.newbyteorder("="), copy=False)


def pixels_in_millimetres(pixels: AnyArray, unit_m: float | None = None) -> NDArray[np.uint16]:
    """Whole millimetres of pixels: 0 where there is no depth,
    `NOTHING` where nothing is within range (REP 118).

    Args:
        pixels: As `pixels_of` gives them.
        unit_m: Metres that one step is; None for those of ROS, 0.001 of whole numbers and 1 of
            others (REP 118).

    Raises:
        MessageError: most of an image of 32 bits is farther than the 65.5 m that whole millimetres
            hold, so that it cannot be in metres.
    """
    is_whole = pixels.dtype.kind == "u"
    if is_whole and unit_m in (None, MILLIMETRE):
        return pixels.astype(np.uint16)
    seen = pixels[np.isfinite(pixels) & (pixels > 0.0)]
    if unit_m is None and len(seen) and (middle := float(np.median(seen))) > MILLIMETRE * NOTHING:
        raise MessageError(
            "depth_unit",
            f"32 bit images read {middle:.4g} in the middle, too far in metres; depth_unit_m = "
            "0.001 "
            "takes them as millimetres"
        )  # fmt: skip
    metres = pixels * np.float64((MILLIMETRE if is_whole else 1.0) if unit_m is None else unit_m)
    metres = np.where(np.isnan(metres) | (metres < 0.0), 0.0, metres)
    whole = np.minimum(np.rint(np.where(np.isinf(metres), 0.0, metres) / MILLIMETRE), NOTHING - 1)
    return np.where(np.isinf(metres), NOTHING, whole).astype(np.uint16)


def _unpacked(image: RosCompressedImage) -> AnyArray:
    """Pixels of a CompressedImage of the transports `compressedDepth` and, as PNG, `compressed`."""
    data, encoding = bytes(image.data), encoding_text(image)
    at = data.find(PNG, 0, INVERSE.size + len(PNG))
    if at < 0:
        raise MessageError(
            "encoding", f"'{image.format}', of which only PNG is read: have the publisher write PNG"
        )
    width, height = struct.unpack(">II", data[at + 16 : at + 24].ljust(8, b"\0"))
    if not 0 < width * height <= PIXELS_MAX:
        raise MessageError("size", f"{width}x{height} claimed by {len(data)} bytes")
    whole = cv2.imdecode(np.frombuffer(data[at:], np.uint8), cv2.IMREAD_UNCHANGED)
    if whole is None or whole.dtype != np.uint16 or whole.ndim != 2:
        raise MessageError("encoding", f"'{image.format}': no PNG of 16 bits, or a damaged one")
    if encoding != "32FC1":
        return np.asarray(whole)
    if at != INVERSE.size:
        raise MessageError(
            "encoding", f"'{image.format}' without the head that says how depth was made inverse"
        )
    _, scale, offset = INVERSE.unpack_from(data)
    with np.errstate(divide="ignore", invalid="ignore"):
        metres = np.float32(scale) / (whole.astype(np.float32) - np.float32(offset))
    return np.where(whole == 0, np.float32(np.nan), metres)


@dataclass(frozen=True)
class PixelIntrinsics:
    """A pin-hole camera [px]; the centre counts from the corner of the first pixel."""

    fx: float
    fy: float
    cx: float
    cy: float


def ros_intrinsics(
    info: RosCameraInfo, width: int, height: int, *, rectified: bool
) -> PixelIntrinsics:
    """The camera of images of a size, out of a `sensor_msgs/msg/CameraInfo` of ROS 1 or 2.

    Rectified images have the projection P, others the matrix K. Both are of the whole sensor;
    binning and the region of interest are taken into account where the images are of the size that
    they make of it.

    Raises:
        MessageError: it is for images of another size, or its focal lengths are zero.
    """
    k, p = (
        np.asarray(getattr(info, name, getattr(info, name.upper(), ())), np.float64)
        for name in "kp"
    )
    of_k, of_p = (k[0], k[4], k[2], k[5]), (p[0], p[5], p[2], p[6])
    matrices = (of_p, of_k) if rectified else (of_k, of_p)
    chosen = next((m for m in matrices if m[0] > 0.0 and m[1] > 0.0), None)
    if chosen is None:
        fx, fy = matrices[0][:2]
        raise MessageError(
            "camera_info", f"its fx is {fx:g}, its fy {fy:g}: the camera is not calibrated"
        )
    fx, fy, cx, cy = (float(value) for value in chosen)
    cx, cy = cx + PIXEL_CENTRE, cy + PIXEL_CENTRE
    roi = info.roi
    bins = max(1, int(info.binning_x)), max(1, int(info.binning_y))
    region = (int(roi.width) or int(info.width), int(roi.height) or int(info.height))
    if (width, height) == (region[0] // bins[0], region[1] // bins[1]):
        if roi.width and roi.height:
            cx, cy = cx - roi.x_offset, cy - roi.y_offset
        return PixelIntrinsics(fx / bins[0], fy / bins[1], cx / bins[0], cy / bins[1])
    if (width, height) != (info.width, info.height):
        raise MessageError(
            "camera_info", f"for {info.width}x{info.height}, the images are {width}x{height}"
        )
    return PixelIntrinsics(fx, fy, cx, cy)


def matrices_differ(info: RosCameraInfo) -> bool:
    """True for a CameraInfo whose K and P, both set, are two cameras: its lens distorts."""
    k, p = (
        np.asarray(getattr(info, name, getattr(info, name.upper(), ())), np.float64)
        for name in "kp"
    )
    both = k[0] > 0.0 and p[0] > 0.0
    return both and not np.allclose([k[0], k[4], k[2], k[5]], [p[0], p[5], p[2], p[6]], rtol=1e-3)
