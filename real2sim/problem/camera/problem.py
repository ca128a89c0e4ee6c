"""The camera as a problem: images of a run log against depth from the measured pose of the base."""

from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.camera.candidates import CameraEffects, camera_candidates
from saltus.real2sim.problem.camera.counts import COPIES, FILLED, NOISE, CountRows, counted_rows
from saltus.real2sim.problem.camera.depth_model import DepthModel, shake_of
from saltus.real2sim.problem.camera.log_images import AS_CLAIMED, CameraData, camera_data
from saltus.real2sim.problem.problem import LARGEST_RESIDUAL, ExplanatoryVariable, Problem
from saltus.recordings.run_log import RunLog

PIXELS = 60  # at most: a quarter of those that are compared elsewhere
# Of the end by which neighbours may be nearer: floor at 2 m changes by half of it from pixel to
# pixel
BESIDE = 0.15
JUMP = 0.04  # of depth: more than the slope beside it, from pixel to pixel, is an edge


@dataclass(frozen=True, kw_only=True, eq=False)
class EndOfRange:
    """Samples of pixels that have the largest depth of a log, beside what is predicted there.

    All that is known of them is that they read the end: that the scene goes on behind it is what
    speaks for a clip.
    """

    model: DepthModel
    kept: Indices
    end_m: float
    sigma_m: float
    """Noise just below the end."""
    at: tuple[Indices, Indices]
    """Places in `kept` and among the pixels of the model, each of shape (samples,)."""

    def residuals(self, effects: CameraEffects) -> Floats:
        """Measured less predicted in units of noise, shape (samples,)."""
        return np.asarray(
            (self.end_m - self.model.predict(effects, self.kept)[self.at]) / self.sigma_m
        )


def end_of_range(data: CameraData) -> EndOfRange | None:
    """The samples of a log whose depth ends early; None where it does not, or only beside edges."""
    if data.clip_m is None:
        return None
    end_mm = round(1e3 * data.clip_m)
    is_end = data.images_mm == end_mm
    often = is_end.sum(axis=0).ravel()
    best = np.argsort(-often, kind="stable")[: np.count_nonzero(often)]
    best = np.sort(best[np.unique(np.linspace(0, len(best) - 1, PIXELS).astype(np.int64))])
    row, column = np.unravel_index(best, is_end.shape[1:])
    is_chosen = is_end[:, row, column]
    for rows, columns in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        is_chosen &= _beside(data, row + rows, column + columns) >= (1.0 - BESIDE) * end_mm
    is_chosen &= ~_near_jump(data, row, column)
    if not is_chosen.any():
        return None
    frame, pixel = np.nonzero(is_chosen)
    return EndOfRange(
        model=replace(data.model, tangents=data.camera.tangents(row, column), is_hole=None),
        kept=data.kept,
        end_m=data.clip_m,
        sigma_m=float(data.noise.sigma(np.array(data.clip_m))),
        at=(frame, pixel),
    )


def _beside(data: CameraData, row: Indices, column: Indices) -> Floats:
    """Measured depth [mm] of pixels, infinite where invalid or outside, shape (kept, pixels)."""
    height, width = data.images_mm.shape[1:]
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    values = data.images_mm[:, np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)].astype(
        np.float64
    )
    return np.where(inside & (values > 0.0), values, np.inf)


def _near_jump(data: CameraData, row: Indices, column: Indices) -> np.ndarray:
    """True where the predicted scene jumps within the margin; a crease is no jump.

    Shape (kept, pixels).
    """
    reach = data.grid.margin + 1
    broken = np.zeros((len(data.kept), len(row)), dtype=bool)
    for rows, columns in ((0, 1), (1, 0)):
        line = []
        for k in range(-reach, reach + 1):
            tangents = data.camera.tangents(row + k * rows, column + k * columns)
            line.append(replace(data.model, tangents=tangents).predict(data.view, data.kept))
        slope = np.diff(np.log(np.stack(line)), axis=0)
        here = slope[1:-1]
        for other in (slope[:-2], slope[2:]):  # a slope is like its neighbour on one side at least
            here = np.where(
                np.sign(here) == np.sign(other),
                np.sign(here) * np.maximum(np.abs(here) - np.abs(other), 0.0),
                here,
            )
        broken |= np.any(np.abs(here) > JUMP, axis=0)
    return broken


RANGE, ROW, COLUMN = "range", "row", "column"  # names of explanatory variables
LINEAR = 30.0  # up to here a residual is as it is; beyond, it is bent towards the limit
BEYOND = 1.01  # times an end of the range: at least as far goes a scene that it cuts
PROBE_S = 0.010  # latency by which it is judged whether the scene moves
FEWEST_FRAMES = 50  # to tell a share of lost images
# Noise units RMS that 10 ms of latency changes: below, a log of some seconds does not show 10 ms
STILL = 0.3


class CameraProblem(Problem):
    """The problem of the camera: which effects make it see what a log's images show; one block,
    "camera". See `Problem`.

    The base's pose is interpolated at the time of each exposure, rays go to the claimed terrain,
    and pixels are compared on a grid. Pixels near edges of depth are left out there: what happens
    at edges is counted instead, as are lost images and the spread of the noise, in rows of their
    own.

    Raises:
        RecordingError: no images, no claimed camera, or no image within the segments of the log.
    """

    name = "camera"
    blocks = ("camera",)
    places = ({"camera": "camera"},)
    signals = (
        *(
            "noise",
            "holes",
            "copies",
            "lost images",
            "usual noise",
            "filled holes",
            "noise that repeats",
        ),
        *("end of range", "depth"),
    )
    simulator_disagreement = 0.2  # rays are exact: two ray casters differ by less than noise

    def __init__(self, log: RunLog) -> None:
        self._data = data = camera_data(log)
        self._counts = counts = counted_rows(data)
        self._at = np.nonzero(data.known)
        self._sigma = np.where(data.known, data.noise.sigma(data.predicted), np.inf)
        self._end = end_of_range(data)
        self._shake = shake_of(data.model, data.view, data.kept, self._sigma)
        frame = self._at[0]
        if self._end is not None:
            frame = np.concatenate([frame, self._end.at[0]])
        of_end = len(frame) - len(self._at[0])
        self.segments = data.segments
        self.segment = np.concatenate([data.owner[frame], counts.segment])
        depth, end = self.signals.index("depth"), self.signals.index("end of range")
        self.signal = np.concatenate(
            [np.repeat([depth, end], [len(self._at[0]), of_end]), counts.kind]
        )
        self.time_s = np.concatenate([data.frames.stamp_s[data.kept][frame], counts.time_s])
        self._set_candidates()

    def _set_candidates(self) -> None:
        data = self._data
        latency_s = data.view.camera_latency + PROBE_S
        later = data.model.predict(replace(data.view, camera_latency=latency_s), data.kept)
        shift = self._depth_residuals(later) - self._depth_residuals(data.predicted)
        self.untestable = _untestable(data, self._counts, shift)
        farthest_m = float(np.max(data.predicted[self._at], initial=1.0))
        clip_m = data.clip_m or farthest_m
        self._ends_m = (clip_m, max(farthest_m, BEYOND * clip_m))
        without = set(self.untestable)
        if not np.any(data.frames.jitter_s):
            without.add("arrival_jitter")
        every = camera_candidates(data.camera.latency_s, data.camera.fx, self._ends_m)
        self.candidates = tuple(c for c in every if c.effect not in without)
        if data.view != AS_CLAIMED:
            likely = [getattr(data.view, name.partition(".")[0], 0.0) for name in self.names]
            self.likely = np.array(likely)

    def residuals(self, unknowns: Floats) -> Floats:
        """See `Problem`; shape (n, 1, m)."""
        rows = []
        for values in np.asarray(unknowns, dtype=np.float64)[:, 0]:
            effects = CameraEffects.of(self.candidates, values, self._ends_m[0])
            predicted = self._data.model.predict(effects, self._data.kept)
            share = self._data.model.noise_share(effects, self._data.kept)
            counted = self._counts.residuals(effects, predicted, share)
            end = np.empty(0) if self._end is None else self._end.residuals(effects)
            rows.append(
                np.concatenate([self._depth_residuals(predicted), _bent(end), _bent(counted)])
            )
        return np.stack(rows)[:, None] if rows else np.empty((0, 1, len(self.segment)))

    def explanatory_variables(self) -> tuple[ExplanatoryVariable, ...]:
        """Where in the image, and how far away; for depth only, not for what is counted."""
        data = self._data
        _, pixel = self._at
        seen = (
            (RANGE, "m", data.predicted[self._at]),
            (ROW, "px", data.grid.row[pixel].astype(np.float64)),
            (COLUMN, "px", data.grid.column[pixel].astype(np.float64)),
            (
                "distance to edges and holes",
                "px",
                data.grid.distance_to_others(data.known)[self._at],
            ),
        )
        nothing = np.full(len(self.signal) - len(pixel), np.nan)
        return tuple(
            ExplanatoryVariable(name=name, unit=unit, values=np.concatenate([v, nothing]))
            for name, unit, v in seen
        )

    def _depth_residuals(self, predicted: Floats) -> Floats:
        residual = (self._data.measured - predicted) / self._sigma
        return self._shake.whitened(_bent(residual))[self._at]


def _bent(residual: Floats) -> Floats:
    """Large residuals are bent so that none passes the limit; their order stays."""
    size = np.abs(residual)
    room = LARGEST_RESIDUAL - LINEAR
    bent = LINEAR + room * np.tanh(np.maximum(size - LINEAR, 0.0) / room)
    return np.asarray(np.sign(residual) * np.where(size > LINEAR, bent, size))


def _untestable(data: CameraData, counts: CountRows, shift_10ms: Floats) -> dict[str, str]:
    """Effects that a log cannot show, and why, with numbers.

    `shift_10ms` is what 10 ms of latency change in units of noise, any shape.
    """
    why: dict[str, str] = {}
    moved = float(np.sqrt(np.mean(shift_10ms**2))) if shift_10ms.size else 0.0
    if moved < STILL:
        reason = (
            f"the scene hardly moves in the images: 10 ms change depth by {moved:.2f} of its "
            f"noise, below {STILL}"
        )
        why["camera_latency"] = why["temporal_smear"] = reason
    if not np.any(counts.kind == NOISE):
        reason = (
            f"only {int(np.isfinite(data.difference).sum())} second differences of "
            "depth away from edges"
        )
        why["depth_noise"] = reason
    if not np.any(counts.kind == COPIES):
        why["edge_holes"] = "no segment shows enough left edges of near objects in view"
        if not np.any(counts.kind == FILLED):
            why["hole_fill"] = why["edge_holes"] + ", nor enough holes or copies elsewhere"
    if len(data.frames.due_s) < FEWEST_FRAMES:
        why["frame_drop"] = f"{len(data.frames.due_s)} images, fewer than {FEWEST_FRAMES}"
    if data.clip_m is None:
        farthest = float(np.max(data.predicted[data.known], initial=0.0))
        why["range_clip"] = (
            f"depth does not end early: a maximum beyond {farthest:.2f} m would not show"
        )
    if not data.known.any():
        for name in ("camera_pitch", "camera_height", "camera_fov", "depth_scale", "depth_bias"):
            why[name] = "no pixel that is valid, in range and away from edges"
    return why
