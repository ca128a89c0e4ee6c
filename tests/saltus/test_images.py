"""Depth images of any encoding and unit are whole millimetres."""

from types import SimpleNamespace

import numpy as np
import pytest

from saltus.depth import NOTHING
from saltus.errors import MessageError
from saltus.recordings.ros_images import pixels_in_millimetres, pixels_of


@pytest.mark.parametrize(
    ("encoding", "steps", "unit_m", "expected_mm"),
    [
        ("16UC1", [0, 4000, 65535], 0.00025, [0, 1000, 16384]),
        ("mono16", [0, 12344, 60000], 0.0001, [0, 1234, 6000]),
        ("16UC1", [0, 1234, 65535], None, [0, 1234, NOTHING]),
        ("32FC1", [0.0, 1.234, 3.0], None, [0, 1234, 3000]),
        ("32FC1", [0.0, 1234.0, 3000.0], 0.001, [0, 1234, 3000]),
        ("32FC1", [np.nan, np.inf, 123.4], 0.01, [0, NOTHING, 1234]),
    ],
)
def test_depth_of_a_bag_in_any_stated_unit_becomes_millimetres(
    encoding: str, steps: list[float], unit_m: float | None, expected_mm: list[int]
) -> None:
    assert pixels_in_millimetres(pixels_of(image_message(encoding, steps)), unit_m).tolist() == [
        expected_mm
    ]


def test_images_of_32_bit_in_millimetres_are_refused_with_the_cure() -> None:
    with pytest.raises(MessageError, match=r"too far in metres; depth_unit_m = 0\.001 takes them"):
        pixels_in_millimetres(pixels_of(image_message("32FC1", [0.0, 300.0, 2500.0])))


def image_message(encoding: str, steps: list[float]) -> SimpleNamespace:
    """A row of pixels."""
    row = np.array(steps, "<f4" if encoding == "32FC1" else "<u2")
    return SimpleNamespace(
        encoding=encoding,
        is_bigendian=0,
        width=len(row),
        height=1,
        step=row.nbytes,
        data=row.view(np.uint8),
    )
