"""A run log's images prepared for comparison: chosen frames, pixels, prediction without effects, noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices
from saltus.errors import RecordingError
from saltus.real2sim.problem.camera.alignment import WHOLE, aligned, misfit
from saltus.real2sim.problem.camera.candidates import CameraEffects
from saltus.real2sim.problem.camera.frames import Frames, frames_of
from saltus.real2sim.problem.camera.model import DepthModel
from saltus.real2sim.problem.camera.noise import NoiseLaw, fitted_noise, second_differences
from saltus.real2sim.problem.camera.pixels import PixelGrid, clip_guess, is_broken
from saltus.real2sim.problem.camera.pose import BaseMotion, ClaimedCamera, claimed_camera
from saltus.real2sim.problem.camera.rays import VisibleScene, claimed_scenes
from saltus.real2sim.problem.log import segments_of
from saltus.real2sim.problem.problem import Segment
from saltus.recordings.run_log import RunLog

MAX_FRAMES = 300  # looked at of a log: more say little that these do not, and cost as much
BLIND_M = 0.05  # nearer than this no depth camera sees anything
AS_CLAIMED = CameraEffects()


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraData:
    """Images and claims of a log, prepared."""

    camera: ClaimedCamera
    motion: BaseMotion
    frames: Frames
    segments: tuple[Segment, ...]
    kept: Indices
    """Frames that are looked at, places in `frames`, shape (kept,)."""
    owner: Indices
    """Segment of each of them, shape (kept,)."""
    images_mm: NDArray[np.uint16]
    """The images themselves, shape (kept, height, width)."""
    grid: PixelGrid
    model: DepthModel
    measured: Floats
    """At the grid [m], 0 invalid, shape (kept, pixels)."""
    view: CameraEffects
    """From where and when edges are told: as claimed, or where a camera that is far off seems to be."""
    predicted: Floats
    """Predicted depth of that view [m], shape (kept, pixels)."""
    noise: NoiseLaw
    difference: Floats
    """Second differences of measured less predicted depth along rows of the grid [m], NaN where edges or holes are,
    shape (kept, rows, columns - 2)."""
    known: NDArray[np.bool_]
    """Pixels that are compared, shape (kept, pixels)."""
    clip_m: float | None
    """Where measured depth seems to end although the scene goes on [m]."""


def camera_data(log: RunLog) -> CameraData:
    """Prepares a log; `RecordingError` where it has no claimed camera, or no image within segments and motion."""
    if log.depth is None or not len(log.depth.frame_id):
        raise RecordingError("the log has no images: depth.npz is missing or empty")
    camera, motion, frames, segments = claimed_camera(log.meta), BaseMotion(log), frames_of(log.depth), segments_of(log)
    scenes = claimed_scenes(log.meta.get("terrain"))
    kept, owner = _choose(frames, segments, motion, camera, scenes[0])
    images = log.depth.depth_mm[frames.index[kept]]
    grid = PixelGrid.of(*images.shape[1:])
    measured = 1e-3 * grid.of_images(images).astype(np.float64)
    model = _likeliest(scenes, camera, motion, frames, grid, kept, measured)
    model = replace(model, is_hole=log.depth.depth_mm[frames.filtered][:, grid.row, grid.column] == 0)
    view = aligned(model, kept, measured)
    predicted = model.predict(view, kept)
    # at the end of the range noise is cut
    known = (measured > 0.0) & (np.maximum(predicted, measured) < WHOLE * camera.range_m)
    known &= ~_edge_of_scene(model, camera, grid, kept, predicted, view)
    clip_m = clip_guess(images, camera.range_m)
    whole = np.ones_like(known) if clip_m is None else np.maximum(predicted, measured) < WHOLE * clip_m
    noise = fitted_noise(_middle(grid, predicted), _difference(grid, measured - predicted, known & whole))
    known &= ~_edge_of_images(images, grid, measured, noise)
    return CameraData(
        camera=camera,
        motion=motion,
        frames=frames,
        segments=segments,
        kept=kept,
        owner=owner,
        images_mm=images,
        grid=grid,
        model=model,
        measured=measured,
        view=view,
        predicted=predicted,
        noise=noise,
        difference=_difference(grid, measured - predicted, known & whole),
        known=known,
        clip_m=clip_m,
    )


def owners(time_s: Floats, segments: Sequence[Segment]) -> Indices:
    """In which segment each time lies, -1 in none, shape as `time_s`."""
    owner = np.full(len(time_s), -1, dtype=np.int64)
    for k, segment in enumerate(segments):
        owner[(time_s >= segment.start_s) & (time_s <= segment.end_s) & (owner < 0)] = k
    return owner


def _choose(
    frames: Frames, segments: Sequence[Segment], motion: BaseMotion, camera: ClaimedCamera, scene: VisibleScene
) -> tuple[Indices, Indices]:
    """Evenly spaced frames of those that lie in a segment and within the measured motion, and not in a box.

    The camera of a simulated robot that falls may pass into the ground.
    """
    owner = owners(frames.stamp_s, segments)
    exposed_s = frames.stamp_s - camera.latency_s
    position, rotation = motion.at(exposed_s)
    place = (position + rotation @ camera.position)[:, None]
    is_within = np.all((place > scene.box_low - BLIND_M) & (place < scene.box_high + BLIND_M), axis=2).any(axis=1)
    is_told = (owner >= 0) & (exposed_s >= motion.start_s) & (exposed_s <= motion.end_s)
    usable = np.flatnonzero(is_told & ~is_within)
    if not usable.size:
        raise RecordingError("the log has no image within its segments and the measured motion of its base")
    kept = usable[np.unique(np.linspace(0, len(usable) - 1, MAX_FRAMES).astype(np.int64))]
    return kept, owner[kept]


def _likeliest(
    scenes: tuple[VisibleScene, ...],
    camera: ClaimedCamera,
    motion: BaseMotion,
    frames: Frames,
    grid: PixelGrid,
    kept: Indices,
    measured: Floats,
) -> DepthModel:
    """The model of the reading of the terrain that the images fit best."""
    models = [
        DepthModel(
            scene=scene,
            camera=camera,
            motion=motion,
            stamp_s=frames.stamp_s,
            jitter_s=frames.jitter_s,
            shown=frames.shown,
            tangents=camera.tangents(grid.row, grid.column),
        )
        for scene in scenes
    ]
    if len(models) == 1:
        return models[0]
    return min(models, key=lambda model: misfit(model.predict(AS_CLAIMED, kept), measured, camera.range_m))


def _edge_of_scene(
    model: DepthModel,
    camera: ClaimedCamera,
    grid: PixelGrid,
    kept: Indices,
    predicted: Floats,
    view: CameraEffects,
) -> NDArray[np.bool_]:
    """Pixels near an edge of the predicted scene, shape (kept, pixels)."""
    broken = np.zeros(predicted.shape, dtype=bool)
    for one, other in grid.around():
        before, after = (
            replace(model, tangents=camera.tangents(side.row, side.column)).predict(view, kept) for side in (one, other)
        )
        broken |= is_broken(predicted, before, after, np.zeros_like(predicted))
    return broken


def _edge_of_images(
    images: NDArray[np.uint16], grid: PixelGrid, measured: Floats, noise: NoiseLaw
) -> NDArray[np.bool_]:
    """Pixels near an edge of the measured images, shape (kept, pixels)."""
    sigma = noise.sigma(measured)
    broken = np.zeros(measured.shape, dtype=bool)
    for one, other in grid.around():
        before, after = (1e-3 * side.of_images(images).astype(np.float64) for side in (one, other))
        broken |= is_broken(measured, before, after, sigma)
    return broken


def _difference(grid: PixelGrid, residual: Floats, known: NDArray[np.bool_]) -> Floats:
    return second_differences(grid.as_image(np.where(known, residual, np.nan)))


def _middle(grid: PixelGrid, depth: Floats) -> Floats:
    return grid.as_image(depth)[..., 1:-1]
