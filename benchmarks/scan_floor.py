"""The scan on a real floor: single images of a real D4xx,
judged by planes that were fitted to them.

The floor is taken to be level: what the attitude is off counts.

The folder holds images (NNN.png, 16-bit, mm) and plane.csv: per image camera_height_m,
pitch_down_deg and roll_deg of the floor's fit. Attitude is that of the image before; each image
makes a map of its own.

    saltus bench scan_floor -- --folder floor_d4xx
"""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks._command import Command
from saltus.arrays import Floats
from saltus.errors import SaltusError
from saltus.grid import HeightGrid
from saltus.heightmap.scan.cells import fine_cell_positions, sample_bilinear
from saltus.heightmap.scan.elevation import MapUpdate, OdometryPoses, advance_map, new_map
from saltus.heightmap.scan.geometry import geometric_heights
from saltus.heightmap.scan.predictor import ScanNetwork, ScanPredictor
from saltus.resources import shipped_file
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix

FOCAL_PX, CENTRE_PX = 383.8, (321.7, 236.8)
STRIDE_PX = 8
"""Every eighth pixel each way: 80 x 60 points."""
ON_FLOOR_M = 0.05
SEEN_M = 0.03
AHEAD = HeightGrid(x=tuple(np.arange(0.3, 1.21, 0.05)), y=tuple(np.arange(-0.8, 0.81, 0.05)))
"""Points of the window that a camera sees that looks ahead."""


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    """Errors [mm] of seen points of the floor, half-widths and the share inside them."""

    folder: Path
    """With images and plane.csv."""
    off_deg: float = 1e-9
    """By this pitch and roll are off besides."""
    odometry_error: float = 1.0
    """Errors of the attitude of which the network is told, 1 for 0.4 degrees."""

    def measure(self) -> dict[str, Any]:
        """Figures of the network, of the classical map and
        of flat ground at the camera's height.
        """
        rows = _rows(self.folder)
        network = ScanNetwork(shipped_file("models/scan.onnx"))
        errors: dict[str, list[Floats]] = {}
        widths: dict[str, list[Floats]] = {}
        for before, row in zip(rows[::2], rows[1::2], strict=False):
            self._judge(before, row, network, errors, widths)
        return {
            method: _summary(np.concatenate(errors[method]), np.concatenate(widths[method]))
            for method in errors
        }

    def _judge(
        self, before: dict[str, float], row: dict[str, float], network: ScanNetwork,
        errors: dict[str, list[Floats]], widths: dict[str, list[Floats]],
    ) -> None:  # fmt: skip
        points, depth = _points(self.folder / f"{int(row['frame']):03d}.png")
        assumed, true = _attitude(before, self.off_deg), _attitude(row, 0.0)
        level = points @ assumed.T
        on_floor = np.abs((points @ true.T)[:, 2] + row["camera_height_m"]) < ON_FLOOR_M
        truth = -row["camera_height_m"]
        seen = _near(AHEAD.points, level[on_floor, :2]) & ~_near(
            AHEAD.points, level[~on_floor, :2], 0.1
        )
        pose = OdometryPoses(np.zeros((1, 3), np.float32), assumed[None].astype(np.float32))
        measured = MapUpdate(
            points=points[None].astype(np.float32), depth=depth[None].astype(np.float32),
            exposed=pose, now=pose,
            feet=np.zeros((1, 1, 3), np.float32), standing=np.zeros((1, 1), bool),
            body_height=np.full(1, before["camera_height_m"], np.float32),
            exposed_s=np.zeros(1, np.float32),
            odometry_error=np.full(1, self.odometry_error, np.float32),
            mount_error=np.ones(1, np.float32),
            viewpoint=np.zeros((1, 1, 3), np.float32),
        )  # fmt: skip
        predictor = ScanPredictor(network)
        predictor.see(measured, 0.05)
        state, around = advance_map(
            new_map(1, network.settings, pose.position), measured, network.settings
        )
        classical = geometric_heights(state, around, np.full(1, 0.05, np.float32), network.settings)
        at = fine_cell_positions(AHEAD.points[None], state.corner, network.settings)
        found = {
            "network": predictor.heights(pose, 0.0, AHEAD),
            "map": (
                sample_bilinear(classical.height, at)[0],
                sample_bilinear(classical.half_width, at)[0],
            ),
            "flat": (np.full(AHEAD.size, -before["camera_height_m"]), np.full(AHEAD.size, 0.1)),
        }
        for method, (height, half_width) in found.items():
            errors.setdefault(method, []).append(np.abs(height - truth)[seen])
            widths.setdefault(method, []).append(half_width[seen])


def _rows(folder: Path) -> list[dict[str, float]]:
    path = folder / "plane.csv"
    if not path.exists():
        raise SaltusError(f"{path} is missing: --folder names one with images and plane.csv")
    with path.open(newline="", encoding="utf-8") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


def _points(path: Path) -> tuple[Floats, Floats]:
    """In a base at the camera that looks along x [m], and their depth [m], of valid pixels."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise SaltusError(f"{path} is missing or no image: plane.csv names it")
    depth = image[::STRIDE_PX, ::STRIDE_PX] * 1e-3
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]] * STRIDE_PX + 0.5
    right, down = (u - CENTRE_PX[0]) / FOCAL_PX, (v - CENTRE_PX[1]) / FOCAL_PX
    valid = depth > 0.0
    points = np.stack([depth, -right * depth, -down * depth], -1)[valid]
    return points, depth[valid]


def _attitude(row: dict[str, float], off_deg: float) -> Floats:
    roll, pitch = (np.radians(row[name] + off_deg) for name in ("roll_deg", "pitch_down_deg"))
    found: Floats = rotation_matrix(quaternion_from_roll_pitch_yaw(roll, pitch, np.zeros(())))
    return found


def _near(
    places_m: Floats, points: Floats, within_m: float = SEEN_M
) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Which places have a point within a distance, in x and y."""
    if not len(points):
        return np.zeros(len(places_m), bool)
    distance = np.linalg.norm(places_m[:, None] - points[None], axis=-1)
    near: np.ndarray[Any, np.dtype[np.bool_]] = distance.min(1) < within_m
    return near


def _summary(error: Floats, half_width: Floats) -> dict[str, float]:
    return {
        "points": len(error),
        "mean_mm": round(1e3 * float(error.mean()), 1),
        "median_mm": round(1e3 * float(np.median(error)), 1),
        "inside": round(float((error <= half_width).mean()), 3),
        "half_width_mm": round(1e3 * float(np.median(half_width)), 1),
    }
