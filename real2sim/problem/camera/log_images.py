"""A run log's images prepared for comparison: which are new, lost and chosen, when they were
exposed, pixels, prediction without effects, noise.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices
from saltus.errors import RecordingError
from saltus.real2sim.problem.camera.candidates import CameraEffects
from saltus.real2sim.problem.camera.depth_model import WHOLE, DepthModel, align_camera, depth_misfit
from saltus.real2sim.problem.camera.noise import NoiseLaw, fitted_noise, second_differences
from saltus.real2sim.problem.camera.pixels import PixelGrid, clip_guess, is_broken
from saltus.real2sim.problem.camera.rays import (
    BaseMotion,
    ClaimedCamera,
    VisibleScene,
    claimed_camera,
    claimed_scenes,
)
from saltus.real2sim.problem.log import boxes_of, segments_of
from saltus.real2sim.problem.problem import LogSegment
from saltus.recordings.run_log import DepthTable, RunLog

# Of the median gap between arrivals: from here on an image is missing where numbers do not tell
LATE = 1.6
PAUSE = 20.0  # of the median gap: from here on nothing was recorded
MOSTLY_EQUAL = (
    0.5  # a scene without motion and noise repeats every image: then equality says nothing
)
JITTER_S = 3e-4  # arrivals that scatter by less are as good as regular


@dataclass(frozen=True, kw_only=True, eq=False)
class LogImages:
    """New images of a log in the order of their arrival, repeats left out."""

    index: Indices
    """Index of each in the log, shape (n,)."""
    stamp_s: Floats
    """Exposure plus total latency [s], as far as the log knows it: arrival where it has no time of
    capture."""
    jitter_s: Floats
    """Excess of `stamp_s` over frames at a constant rate [s]; 0 where that cannot be told."""
    filtered: Indices
    """Index of each image in the log that a temporal filter has seen: new ones, and repeats that
    are not equal to the image before, shape (filtered,)."""
    shown: Indices
    """Which of the new images each of them shows, shape (filtered,)."""
    due_s: Floats
    """When an image should have come [s], lost ones included, shape (sent,)."""
    lost: NDArray[np.bool_]
    """Which of them did not come, or came as a repeat, shape (sent,)."""


def frames_of(depth: DepthTable) -> LogImages:
    """Sorts out what came: repeats, gaps, times."""
    repeated, same = _repeats(depth)
    filtered = np.flatnonzero(~(repeated & same))
    index = np.flatnonzero(~repeated)
    stamp_s = depth.arrival_s[index]
    if depth.capture_s is not None and np.isfinite(depth.capture_s).all():
        captured = depth.capture_s[index]
        stamp_s = captured + np.median(stamp_s - captured)
    due_s, lost = _losses(depth, repeated)
    return LogImages(
        index=index,
        stamp_s=stamp_s,
        jitter_s=_jitter(stamp_s, depth.frame_id[index]),
        filtered=filtered,
        shown=(np.cumsum(~repeated) - 1)[filtered],
        due_s=due_s,
        lost=lost,
    )


def _repeats(depth: DepthTable) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Images that are the one before, by number or by content, and those that are equal to it.

    Shape (n,) each.
    """
    count = len(depth.frame_id)
    by_number, by_content = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    by_number[1:] = depth.frame_id[1:] == depth.frame_id[:-1]
    flat = depth.depth_mm.reshape(count, -1)
    by_content[1:] = [np.array_equal(a, b) for a, b in zip(flat[1:], flat[:-1], strict=True)]
    return (by_number if by_content.mean() > MOSTLY_EQUAL else by_number | by_content), by_content


def _losses(depth: DepthTable, repeated: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.bool_]]:
    """Times at which images were due and whether each was lost."""
    gap_s = np.diff(depth.arrival_s)
    if not gap_s.size:
        return depth.arrival_s, repeated
    new = np.flatnonzero(~repeated)
    step = np.diff(depth.frame_id[new])
    if np.all(
        np.diff(depth.frame_id) <= 1
    ):  # numbers are given on arrival: only the clock shows a gap
        new = np.arange(len(repeated))
        usual = np.median(gap_s)
        is_loss = (gap_s > LATE * usual) & (gap_s < PAUSE * usual)
        step = np.where(is_loss, np.round(gap_s / max(usual, 1e-9)), 1).astype(np.int64)
    # a repeat has come in the place of the image whose number is missing: it is lost once, not
    # twice
    missing = np.maximum(step - np.diff(new), 0)
    after = np.repeat(new[1:] - 1, missing)
    share = np.arange(len(after)) - np.repeat(np.cumsum(missing) - missing, missing) + 1.0
    share /= np.repeat(missing, missing) + 1.0
    absent_s = depth.arrival_s[after] + share * gap_s[after]
    due_s = np.concatenate([depth.arrival_s, absent_s])
    lost = np.concatenate([repeated, np.ones(len(absent_s), dtype=bool)])
    order = np.argsort(due_s, kind="stable")
    return due_s[order], lost[order]


def _jitter(stamp_s: Floats, frame_id: Indices) -> Floats:
    """Scatter of the stamps about a straight line over the numbers [s].

    None where numbers and times disagree.
    """
    none = np.zeros_like(stamp_s)
    if len(stamp_s) < 10 or np.any(np.diff(frame_id) <= 0):
        return none
    number = (frame_id - frame_id[0]).astype(np.float64)
    line = np.polynomial.Polynomial.fit(number, stamp_s, 1)
    jitter = stamp_s - line(number)
    period = np.median(np.diff(stamp_s))
    spread = float(np.std(jitter))
    # a slow wander is drift of a clock or a camera that keeps no rate, not the scatter of arrivals
    wander = float(np.std(jitter[:-1] + jitter[1:])) > 1.8 * spread
    return none if spread < JITTER_S or spread > 0.5 * period or wander else jitter


MAX_FRAMES = 300  # looked at of a log: more say little that these do not, and cost as much
BLIND_M = 0.05  # nearer than this no depth camera sees anything
AS_CLAIMED = CameraEffects()


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraData:
    """Images and claims of a log, prepared."""

    camera: ClaimedCamera
    motion: BaseMotion
    frames: LogImages
    segments: tuple[LogSegment, ...]
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
    """From where and when edges are told: as claimed, or where a camera that is far off seems to
    be."""
    predicted: Floats
    """Predicted depth of that view [m], shape (kept, pixels)."""
    noise: NoiseLaw
    difference: Floats
    """Second differences of measured less predicted depth along rows of the grid [m], NaN where
    edges or holes are, shape (kept, rows, columns - 2)."""
    known: NDArray[np.bool_]
    """Pixels that are compared, shape (kept, pixels)."""
    clip_m: float | None
    """Where measured depth seems to end although the scene goes on [m]."""


def camera_data(log: RunLog) -> CameraData:
    """Prepares a log; `RecordingError` where it has no image,
    or none within segments and motion.
    """
    if log.depth is None or not len(log.depth.frame_id):
        raise RecordingError("the log has no images: depth.npz is missing or empty")
    camera, motion, frames, segments = (
        claimed_camera(log),
        BaseMotion(log),
        frames_of(log.depth),
        segments_of(log),
    )
    scenes = claimed_scenes(boxes_of(log))
    kept, owner = _choose(frames, segments, motion, camera, scenes[0])
    images = log.depth.depth_mm[frames.index[kept]]
    grid = PixelGrid.of(*images.shape[1:])

    def in_images(pixels: PixelGrid) -> Floats:
        return 1e-3 * pixels.of_images(images).astype(np.float64)

    def seen_by(pixels: PixelGrid) -> DepthModel:
        return replace(model, tangents=camera.tangents(pixels.row, pixels.column))

    def difference() -> Floats:
        return second_differences(
            grid.as_image(np.where(known & whole, measured - predicted, np.nan))
        )

    measured = in_images(grid)
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
    model = models[0]
    if len(models) > 1:  # the reading of the terrain that the images fit best
        model = min(
            models,
            key=lambda each: depth_misfit(each.predict(AS_CLAIMED, kept), measured, camera.range_m),
        )
    model = replace(
        model, is_hole=log.depth.depth_mm[frames.filtered][:, grid.row, grid.column] == 0
    )
    view = align_camera(model, kept, measured)
    predicted = model.predict(view, kept)
    # at the end of the range noise is cut
    known = (measured > 0.0) & (np.maximum(predicted, measured) < WHOLE * camera.range_m)
    known &= ~_near_edge(
        grid, predicted, np.zeros_like(predicted), lambda side: seen_by(side).predict(view, kept)
    )
    clip_m = clip_guess(images, camera.range_m)
    whole = (
        np.ones_like(known) if clip_m is None else np.maximum(predicted, measured) < WHOLE * clip_m
    )
    noise = fitted_noise(grid.as_image(predicted)[..., 1:-1], difference())
    known &= ~_near_edge(grid, measured, noise.sigma(measured), in_images)
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
        difference=difference(),
        known=known,
        clip_m=clip_m,
    )


def segment_indices(time_s: Floats, segments: Sequence[LogSegment]) -> Indices:
    """Index of the segment in which each time lies, -1 in none, shape as `time_s`."""
    owner = np.full(len(time_s), -1, dtype=np.int64)
    for k, segment in enumerate(segments):
        owner[(time_s >= segment.start_s) & (time_s <= segment.end_s) & (owner < 0)] = k
    return owner


def _choose(
    frames: LogImages,
    segments: Sequence[LogSegment],
    motion: BaseMotion,
    camera: ClaimedCamera,
    scene: VisibleScene,
) -> tuple[Indices, Indices]:
    """Evenly spaced frames of those that lie in a segment and within the measured motion,
    and not in a box.

    The camera of a simulated robot that falls may pass into the ground.
    """
    owner = segment_indices(frames.stamp_s, segments)
    exposed_s = frames.stamp_s - camera.latency_s
    position, rotation = motion.at(exposed_s)
    place = (position + rotation @ camera.mount.position)[:, None]
    is_within = np.all(
        (place > scene.box_low - BLIND_M) & (place < scene.box_high + BLIND_M), axis=2
    ).any(axis=1)
    is_told = (owner >= 0) & (exposed_s >= motion.start_s) & (exposed_s <= motion.end_s)
    usable = np.flatnonzero(is_told & ~is_within)
    if not usable.size:
        raise RecordingError(
            "the log has no image within its segments and the measured motion of its base"
        )
    kept = usable[np.unique(np.linspace(0, len(usable) - 1, MAX_FRAMES).astype(np.int64))]
    return kept, owner[kept]


def _near_edge(
    grid: PixelGrid, depth: Floats, sigma: Floats, at: Callable[[PixelGrid], Floats]
) -> NDArray[np.bool_]:
    """Pixels of a grid near an edge, shape (kept, pixels);
    `at` gives depth [m] at the pixels of another grid.
    """
    broken = np.zeros(depth.shape, dtype=bool)
    for one, other in grid.around():
        broken |= is_broken(depth, at(one), at(other), sigma)
    return broken
