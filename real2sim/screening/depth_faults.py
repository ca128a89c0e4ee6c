"""Faults of depth images: units, clocks, images upside down.

They are compared with the claimed terrain.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from saltus.real2sim.problem.camera.rays import expected_depth
from saltus.real2sim.screening.channel_scales import LogFault
from saltus.recordings.run_log import DepthTable, LogTable, RunLog

FRAMES = 12  # images that are compared, spread over the log
PIXELS = 400  # smallest number of valid pixels in them
# Times the expected depth; a scale off by 5 %, a bias of 5 cm or a clipped range stay below 1.2
UNIT_OFF = 1.7
STEPS_M = (1e-6, 1e-5, 1e-4, 1.25e-4, 2e-4, 2.5e-4, 5e-4, 1e-2, 0.0254, 1.0)
"""Steps of depth images that are in use [m] beside 0.001: micrometres, 0.01, 0.1 (D405), 0.125, 0.2
(TUM's files), 0.25 (L515) and 0.5 mm, cm, inches, metres."""
NEAR_STEP = (
    0.2  # share by which the measured step may differ: errors of depth and of the claimed mount
)
COARSE_M = 0.5  # steps that are as far as what legs stand on
FULL = 65534  # largest distance of 16 bits: larger ones are cut to it
FULL_SHARE = 0.5  # of valid pixels: nothing that a robot's camera sees is so far
SEEN_SHARE = 0.02  # smallest share of valid pixels
# Correlation with the expected image: below this upright, above this upside down
UPSIDE_DOWN = (
    -0.3,
    0.6,
)
MAX_AGE_S = 2.0  # older images have time stamps of another clock
MOVES_M = 0.02


def depth_faults(log: RunLog) -> list[LogFault]:
    """Faults of `depth.npz`."""
    if log.depth is None or not len(log.depth.arrival_s):
        return []
    if not isinstance(camera := log.meta.get("camera"), dict):
        return [
            LogFault(
                name="no_camera",
                text="depth: meta.json claims no camera: images cannot be compared",
                is_fatal=False,
            )
        ]
    height, width = log.depth.depth_mm.shape[1:]
    if (camera.get("height"), camera.get("width")) != (height, width):
        text = (
            f"depth: images are {width} x {height}, meta.json claims {camera.get('width')} x "
            f"{camera.get('height')}"
        )
        return [LogFault(name="image_size", text=text)]
    reach = float(camera.get("range_max", np.inf))
    geometry = [*_geometry(log, log.depth, reach)]
    units = [fault for fault in geometry if fault.name == "depth_unit"] or [
        *_beyond(log.depth, reach)
    ]
    return units or [*_clocks(log.depth), *_contents(log.depth, log.base), *geometry]


def _beyond(depth: DepthTable, reach: float) -> Iterator[LogFault]:
    """Images that are farther than the claimed range, whatever they show."""
    seen = depth.depth_mm[depth.depth_mm > 0]
    ratio = 1e-3 * float(np.median(seen)) / reach if len(seen) >= PIXELS else 0.0
    if ratio > UNIT_OFF:
        text = (
            f"depth: images read {ratio:.3g} times range_max in the middle: "
            f"{_step(ratio, seen, is_known=False)}"
        )
        yield LogFault(name="depth_unit", text=text)


def _step(ratio: float, seen: NDArray[np.uint16], is_known: bool = True) -> str:
    """Returns what a ratio of depth to what it should be says of the images' steps."""
    step = min(STEPS_M, key=lambda each: abs(np.log(ratio * each / 1e-3)))
    if np.mean(seen >= FULL) > FULL_SHARE:
        return (
            "most pixels are at the end of 16 bits, as steps of 1e-06 m (1000) would be: "
            "write whole millimetres"
        )
    near = NEAR_STEP if step < COARSE_M else 0.5  # whole metres round what they tell
    if not is_known or abs(ratio * step / 1e-3 - 1.0) > near:
        known = f" = {1e-3 / ratio:.3g}" if is_known else ""
        return f"another unit? Then say depth_unit_m{known} in [units] (meta.json: units)"
    return (
        f"in steps of {step:g} m ({1e-3 / step:g})? Then say depth_unit_m = {step:g} in [units] "
        "(meta.json: units)"
    )


def _clocks(depth: DepthTable) -> Iterator[LogFault]:
    if np.any(np.diff(depth.frame_id) < 0):
        yield LogFault(
            name="frames_backwards", text="depth: frame_id runs backwards: images are out of order"
        )
    if depth.capture_s is None:
        return
    age = float(np.median(depth.arrival_s - depth.capture_s))
    if not 0 <= age < MAX_AGE_S:
        yield LogFault(
            name="two_clocks",
            text=f"depth: images are {age:.4g} s old at arrival: two clocks that do not agree",
        )


def _contents(depth: DepthTable, base: LogTable | None) -> Iterator[LogFault]:
    valid = float(np.mean(depth.depth_mm > 0))
    if valid < SEEN_SHARE:
        yield LogFault(name="blind", text=f"depth: {valid:.1%} of the pixels are valid")
    if base is None or len(depth.depth_mm) < 2:
        return
    moved = float(np.ptp(base.values[:, :3], axis=0).max())
    if moved > MOVES_M and not np.any(depth.depth_mm[1:] != depth.depth_mm[0]):
        yield LogFault(
            name="dead_channel",
            text=f"depth: all images are the same although the base moves {moved:.2f} m",
        )


def _geometry(log: RunLog, depth: DepthTable, reach: float) -> Iterator[LogFault]:
    """Compares some pixels with the claimed floor and boxes."""
    if log.base is None:
        return
    rows = np.unique(np.linspace(0, len(depth.arrival_s) - 1, FRAMES).astype(int))
    when = depth.arrival_s[rows] - float(log.meta["camera"].get("latency", 0.0))  # as claimed
    nearest = np.clip(np.searchsorted(log.base.time_s, when), 0, len(log.base.time_s) - 1)
    pixels = [np.arange(size) for size in depth.depth_mm.shape[1:]]
    expected = expected_depth(log.base.values[nearest, :7], log, *pixels)
    measured = 1e-3 * depth.depth_mm[rows].astype(np.float64)
    seen = (measured > 0) & np.isfinite(expected) & (expected < reach)
    if seen.sum() < PIXELS:
        return
    ratio = float(np.median(measured[seen] / expected[seen]))
    if not 1 / UNIT_OFF < ratio < UNIT_OFF:
        step = _step(ratio, depth.depth_mm[rows][seen])
        text = f"depth: images read {ratio:.3g} times what pose and terrain imply: {step}"
        yield LogFault(name="depth_unit", text=text)
        return
    both = seen & seen[:, ::-1]
    if both.sum() < PIXELS:
        return
    upright = np.corrcoef(measured[both], expected[both])[0, 1]
    turned = np.corrcoef(measured[:, ::-1][both], expected[both])[0, 1]
    if upright < UPSIDE_DOWN[0] and turned > UPSIDE_DOWN[1]:
        yield LogFault(
            name="upside_down",
            text=f"depth: images fit pose and terrain upside down ({turned:.2f}), not upright",
        )
