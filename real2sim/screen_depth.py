"""Faults of depth images: units, clocks, images upside down; compared with flat floor and boxes as claimed."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from real2sim.fault import Fault
from saltus.run_log import DepthTable, RunLog, Table

Floats = NDArray[np.float64]

FRAMES = 12  # spread over the log
PIXELS = 400  # of each
UNIT_OFF = 2.5  # times the expected depth; a scale 5 % off, a bias of 5 cm or a clipped range stay below
SEEN_SHARE = 0.02  # of valid pixels
UPSIDE_DOWN = (-0.3, 0.6)  # correlation with the expected image as it is, and upside down
MAX_AGE_S = 2.0  # older images come from another clock
MOVES_M = 0.02


def depth_faults(log: RunLog) -> list[Fault]:
    """Faults of `depth.npz`."""
    if log.depth is None or not len(log.depth.arrival_s):
        return []
    camera = log.meta.get("camera")
    if not isinstance(camera, dict):
        return [
            Fault(name="no_camera", text="depth: meta.json claims no camera: images cannot be compared", is_fatal=False)
        ]
    height, width = log.depth.depth_mm.shape[1:]
    if (camera.get("height"), camera.get("width")) != (height, width):
        text = f"depth: images are {width} x {height}, meta.json claims {camera.get('width')} x {camera.get('height')}"
        return [Fault(name="image_size", text=text)]
    return [*_clocks(log.depth), *_contents(log.depth, log.base), *_geometry(log, log.depth, camera)]


def _clocks(depth: DepthTable) -> Iterator[Fault]:
    if np.any(np.diff(depth.frame_id) < 0):
        yield Fault(name="frames_backwards", text="depth: frame_id runs backwards: images are out of order")
    if depth.capture_s is None:
        return
    age = float(np.median(depth.arrival_s - depth.capture_s))
    if not 0 <= age < MAX_AGE_S:
        yield Fault(
            name="two_clocks", text=f"depth: images are {age:.4g} s old at arrival: two clocks that do not agree"
        )


def _contents(depth: DepthTable, base: Table | None) -> Iterator[Fault]:
    valid = float(np.mean(depth.depth_mm > 0))
    if valid < SEEN_SHARE:
        yield Fault(name="blind", text=f"depth: {valid:.1%} of the pixels are valid")
    if base is None or len(depth.depth_mm) < 2:
        return
    moved = float(np.ptp(base.values[:, :3], axis=0).max())
    if moved > MOVES_M and not np.any(depth.depth_mm[1:] != depth.depth_mm[0]):
        yield Fault(name="dead_channel", text=f"depth: all images are the same although the base moves {moved:.2f} m")


def _geometry(log: RunLog, depth: DepthTable, camera: dict[str, Any]) -> Iterator[Fault]:
    """Compares some pixels with the floor and the boxes that are claimed."""
    if log.base is None:
        return
    rows = np.unique(np.linspace(0, len(depth.arrival_s) - 1, FRAMES).astype(int))
    expected = np.stack([_expected(log, log.base, camera, float(depth.arrival_s[row])) for row in rows])
    measured = 1e-3 * depth.depth_mm[rows].astype(np.float64)
    seen = (measured > 0) & np.isfinite(expected) & (expected < float(camera.get("range_max", np.inf)))
    if seen.sum() < PIXELS:
        return
    ratio = float(np.median(measured[seen] / expected[seen]))
    if not 1 / UNIT_OFF < ratio < UNIT_OFF:
        yield Fault(name="depth_unit", text=f"depth: images read {ratio:.3g} times what pose and terrain imply: unit?")
        return
    both = seen & seen[:, ::-1]
    if both.sum() < PIXELS:
        return
    upright = np.corrcoef(measured[both], expected[both])[0, 1]
    turned = np.corrcoef(measured[:, ::-1][both], expected[both])[0, 1]
    if upright < UPSIDE_DOWN[0] and turned > UPSIDE_DOWN[1]:
        yield Fault(
            name="upside_down", text=f"depth: images fit pose and terrain upside down ({turned:.2f}), not upright"
        )


def _expected(log: RunLog, base: Table, camera: dict[str, Any], arrival_s: float) -> Floats:
    """Depth along the optical axis to floor and boxes [m], shape (height, width); infinite above the horizon."""
    when = arrival_s - float(camera.get("latency", 0.0))
    row = base.values[int(np.clip(np.searchsorted(base.time_s, when), 0, len(base.time_s) - 1))]
    body = Rotation.from_quat(row[3:7], scalar_first=True)
    eye = row[:3] + body.apply(np.asarray(camera["position"], float))
    u = (np.arange(camera["width"]) + 0.5 - camera["cx"]) / camera["fx"]
    v = (np.arange(camera["height"]) + 0.5 - camera["cy"]) / camera["fy"]
    right, down = np.meshgrid(u, v)
    # Camera looks along x of the trunk, turned nose down about y; a ray advances one metre along the axis
    rays = np.stack([np.ones_like(right), -right, -down], axis=-1).reshape(-1, 3)
    rays = body.apply(Rotation.from_euler("y", float(camera["pitch"])).apply(rays))
    with np.errstate(divide="ignore", invalid="ignore"):
        nearest = np.where(rays[:, 2] < 0, -eye[2] / rays[:, 2], np.inf)
        for box in log.meta["terrain"] if isinstance(log.meta.get("terrain"), list) else []:
            half = 0.5 * np.asarray(box["size"], float)
            sides = (np.asarray(box["center"], float) + np.stack([-half, half])[:, None] - eye) / rays
            enter, leave = np.min(sides, axis=0).max(axis=1), np.max(sides, axis=0).min(axis=1)
            nearest = np.where((enter > 0) & (enter < leave), np.minimum(nearest, enter), nearest)
    return np.where(nearest > 0, nearest, np.inf).reshape(right.shape)
