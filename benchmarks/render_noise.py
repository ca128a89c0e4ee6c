"""The stereo camera beside what is published of the D435i, and what each of its effects costs.

With a picture it draws the stages of the chain in front of stairs; with a recording it compares
invalid pixels.

    saltus bench render_noise -- --recording FILE.bag
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks._command import Command
from saltus.arrays import Floats, Reals
from saltus.config import TerrainConfig
from saltus.depth import D435I, Intrinsics, supersampled_model_camera
from saltus.effects.signals import DepthImage
from saltus.render.camera import RobotCamera
from saltus.render.stereo.camera import UNFILTERED, StereoCamera, StereoConfig
from saltus.render.stereo.image import stereo_image
from saltus.render.stereo.model_view import pool_valid
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_embree import StereoEmbree
from saltus.render.stereo_fit import fit_stereo, load_frames
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.curriculum import make_terrain

ROBOT = load_robot(DEFAULT_ROBOT)
NATIVE = supersampled_model_camera(5, 5)
HD = Intrinsics(width=1280, height=180, fx=640.0, fy=640.0, cx=640.0, cy=90.0)
"""The sensor's largest mode; fewer rows, which are all alike here."""
REPEATS = 200
# front feet ahead and inwards, where the camera sees them
REACHING = np.array([0.8, -0.6, -0.95, -0.8, -0.6, -0.95, 0.0, 0.9, -1.8, 0.0, 0.9, -1.8])
CONTOUR_M = 0.05


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    picture: Path | None = None
    """PNG of the stages of the chain."""
    recording: Path | None = None
    """A RealSense bag whose invalid pixels are compared."""

    def measure(self) -> dict[str, Any]:
        table, costs = sigma_rows() + place_rows(), cost_rows()
        if self.recording:
            table += recorded_rows(self.recording)
        if self.picture:
            draw(self.picture)
        return {"table": table, "costs": costs}


def wall(camera: Intrinsics, depth_m: float) -> tuple[Any, Any]:
    """A wall square to the camera, which both imagers see."""
    shape = camera.height, camera.width
    return np.full(shape, depth_m, dtype=np.float32), np.zeros(shape, dtype=bool)


def exposures(
    config: StereoConfig, camera: Intrinsics, scene: tuple[Any, Any], count: int
) -> Floats:
    """Frames [m], a second apart, shape (count, height, width)."""
    stereo = StereoCamera(config, StereoOptics.of(camera, sensor=camera))
    state = stereo.init((), np.random.default_rng(0))
    frames = []
    for k in range(count):
        image, state = stereo.step(*scene, np.asarray(float(k)), state)
        frames.append(image.depth)
    return np.stack(frames)


def sigma_rows() -> list[dict[str, Any]]:
    """Axial noise after quantisation of the disparity,
    and after whole millimetres, beside z^2 s / (f B).
    """
    rows = []
    for depth_m in (0.3, 0.5, 1.0, 2.0, 3.0):
        published = 1e3 * depth_m**2 * 0.08 / (D435I.fx * 0.05)
        row = {"what": f"sigma at {depth_m:g} m [mm]", "published": round(published, 2)}
        for key, names in (
            ("model", ("disparity_noise", "disparity_step")),
            ("model_in_mm_units", ("disparity_noise", "disparity_step", "depth_unit")),
        ):
            frames = exposures(StereoConfig().only(names), D435I, wall(D435I, depth_m), 12)
            row[key] = round(1e3 * float(np.std(frames[frames > 0.0])), 2)
        rows.append(row)
    return rows


def place_rows() -> list[dict[str, Any]]:
    """Pixels that are invalid: the left band, the nearest depth,
    the dead columns of the largest mode.
    """
    rows: list[dict[str, Any]] = []
    for depth_m, published in ((0.3, 35.0), (1.0, 11.0)):
        frame = exposures(UNFILTERED, D435I, wall(D435I, depth_m), 1)[0]
        band = float(np.mean(np.argmax(frame > 0.0, axis=1)))
        rows.append(
            {
                "what": f"invalid band at {depth_m:g} m [px of 424]",
                "published": published,
                "model": round(band, 1),
            }
        )
    depths = np.arange(0.060, 0.120, 0.0005)
    seen = [
        np.any(exposures(StereoConfig().only(["search_range"]), D435I, wall(D435I, z), 1) > 0.0)
        for z in depths
    ]
    rows.append(
        {
            "what": "minimum depth [mm]",
            "published": 84.0,
            "model": round(1e3 * float(depths[np.argmax(seen)]), 1),
        }
    )
    # published of real frames, at distances that are not stated; the band alone says that they were
    # near 0.9 m
    frames = [
        exposures(UNFILTERED, HD, wall(HD, z), 1)[0][:, :40] == 0.0
        for z in np.linspace(0.85, 0.90, 6)
    ]
    rows.append(
        {
            "what": "invalid in the left 40 of 1280 columns, walls at 0.85 to 0.90 m [%]",
            "published": "89 to 94",
            "model": round(100.0 * float(np.mean(frames)), 1),
        }
    )
    return rows


def recorded_rows(path: Path) -> list[dict[str, Any]]:
    """The invalid pixels of a recorded frame beside those
    that the model makes of the frame's own geometry.
    """
    result = fit_stereo(load_frames(path))
    scene = result.scene
    nearest = filled(scene.median)
    optics = StereoOptics(focal_px=scene.fx)
    depth = (1.0 / nearest).astype(np.float32)
    margin = result.parameters.margin_px.value or 0.0
    config = replace(UNFILTERED, search_range=replace(UNFILTERED.search_range, margin=margin))
    camera = StereoCamera(config, optics)
    hidden = shadows_of(nearest * optics.disparity_at_1m)
    image, _ = camera.step(
        depth, hidden, np.asarray(0.0), camera.init((), np.random.default_rng(0))
    )
    model, real = image.depth == 0.0, scene.presence < 0.5
    rows: list[dict[str, Any]] = [
        {
            "what": f"invalid in {where} of {path.name} [%]",
            "published": round(100.0 * float(np.mean(real[part])), 1),
            "model": round(100.0 * float(np.mean(model[part])), 1),
        }
        for where, part in (
            ("all", np.s_[:, :]),
            ("the left 40 columns", np.s_[:, :40]),
            ("the other columns", np.s_[:, 40:]),
        )
    ]
    likeness = float(np.corrcoef(np.mean(model, axis=0), np.mean(real, axis=0))[0, 1])
    rows.append(
        {
            "what": "correlation of invalid shares by column",
            "published": 1.0,
            "model": round(likeness, 3),
        }
    )
    return rows


def filled(inverse: Reals) -> Reals:
    """Invalid pixels take the farther of their valid neighbours in the row:
    a shadow falls on what is far.
    """
    result = inverse.copy()
    columns = np.arange(inverse.shape[1])
    for row in result:
        valid = np.flatnonzero(row > 0.0)
        place = np.searchsorted(valid, columns)
        sides = (
            row[valid[np.clip(place - 1, 0, None)]],
            row[valid[np.clip(place, None, len(valid) - 1)]],
        )
        row[row == 0.0] = np.minimum(*sides)[row == 0.0]
    return result


def shadows_of(disparity: Reals) -> Any:
    """Returns what the right imager does not see of the surfaces that the left one sees,
    bool, shape as `disparity`.
    """
    place = np.round(np.arange(disparity.shape[1]) - disparity).astype(int)
    place -= place.min()
    right = np.zeros((disparity.shape[0], place.max() + 1))
    for row, target, values in zip(right, place, disparity, strict=True):
        np.maximum.at(row, target, values)
    return np.take_along_axis(right, place, axis=1) > disparity + 1.0


def pose(x: float, yaw: float, joints: Floats = ROBOT.stand_pose) -> tuple[Floats, Floats, Floats]:
    """A robot with its trunk level, 0.4 m above the ground in front of the stairs."""
    quaternion = quaternion_from_roll_pitch_yaw(*(np.asarray(angle) for angle in (0.0, 0.0, yaw)))
    return np.array([x, 0.0, 0.40]), quaternion, np.asarray(joints)


def cost_rows() -> list[dict[str, Any]]:
    """Milliseconds of each effect on the native crop, one image on one core."""
    optics = StereoOptics.of(NATIVE)
    pair = StereoEmbree(
        make_terrain(TerrainConfig(rise_m=0.06)), optics, RobotCamera.on(ROBOT, NATIVE)
    )
    depth, hidden = pair.render_pair(*pose(0.8, 0.2))
    rows = []
    signal: Any = stereo_image(depth, hidden, np.asarray(0.0), optics)
    camera = StereoCamera(StereoConfig(), optics)
    image, _ = camera.step(
        depth, hidden, np.asarray(0.0), camera.init((), np.random.default_rng(0))
    )
    for effect in StereoConfig().effects:
        given = image if effect.name in DEPTH_EFFECTS else signal
        state = effect.init((), np.random.default_rng(0))
        begin = time.perf_counter()
        for k in range(REPEATS):
            _, state = effect.apply(replace(given, time_s=np.asarray(0.02 * k)), 0.0, state)
        rows.append(
            {"effect": effect.name, "ms": round(1e3 * (time.perf_counter() - begin) / REPEATS, 3)}
        )
    return rows


DEPTH_EFFECTS = ("depth_unit", "hole_filling", "spatial_filter", "temporal_filter")


def colours(depth: Reals, height: int = 360) -> Any:
    """Near is red, 3 m is blue, in steps of 5 cm; invalid is black, nothing is grey."""
    near = np.clip(1.0 - np.nan_to_num(depth, posinf=3.0) / 3.0, 0.0, 1.0)
    image = cv2.applyColorMap((255 * near).astype(np.uint8), cv2.COLORMAP_TURBO)
    with np.errstate(invalid="ignore"):
        # Every second step is darker, so that noise shows
        dark = depth % (2.0 * CONTOUR_M) < CONTOUR_M
    image[dark] = (0.8 * image[dark]).astype(np.uint8)
    image[np.isinf(depth)] = 70
    image[depth == 0.0] = 0
    width = round(height * depth.shape[1] / depth.shape[0])
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_NEAREST)


def draw(path: Path) -> None:
    """The stages of the chain, for a robot beside stairs with its front legs in view,
    on a grey page.
    """
    optics = StereoOptics.of(D435I)
    pair = StereoEmbree(
        make_terrain(TerrainConfig(rise_m=0.06)), optics, RobotCamera.on(ROBOT, D435I)
    )
    depth, hidden = pair.render_pair(*pose(1.0, 0.35, REACHING))
    stages: list[tuple[str, Reals]] = [("true depth", depth)]
    stages.append(("not seen by the right imager", np.where(hidden, 0.0, depth)))
    names = [effect.name for effect in StereoConfig().effects]
    for title, count in (
        ("noise and steps of disparity", 3),
        ("search range, holes, flying pixels", 8),
        ("post-filters", 11),
    ):
        camera = StereoCamera(StereoConfig().only(names[:count]), optics)
        state = camera.init((), np.random.default_rng(0))
        image = DepthImage(depth=depth, time_s=np.asarray(0.0))
        for k in range(3):
            image, state = camera.step(depth, hidden, np.asarray(0.02 * k), state)
        stages.append((title, image.depth))
    middle = stages[-1][1][:, 172:252]
    stages.append(("what the model sees", pool_valid(middle, 5, 5)))
    tiles = [titled(title, colours(stage)) for title, stage in stages]
    page = np.vstack([np.hstack(tiles[row : row + 3]) for row in (0, 3)])
    cv2.imwrite(str(path), cv2.resize(page, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA))


def titled(title: str, image: Any) -> Any:
    """An image under its title."""
    right = 12 + round(image.shape[0] * D435I.width / D435I.height) - image.shape[1]
    page = cv2.copyMakeBorder(image, 34, 10, 0, right, cv2.BORDER_CONSTANT, value=(255, 255, 255))
    return cv2.putText(
        page, title, (2, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.75, (40, 40, 40), 2, cv2.LINE_AA
    )
