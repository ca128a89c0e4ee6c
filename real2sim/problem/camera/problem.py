"""The camera as a problem: images of a run log against depth from the measured pose of the base."""

from dataclasses import replace

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.camera.candidates import CameraEffects, camera_candidates
from saltus.real2sim.problem.camera.counts import counted_rows
from saltus.real2sim.problem.camera.data import AS_CLAIMED, camera_data
from saltus.real2sim.problem.camera.end import end_of_range
from saltus.real2sim.problem.camera.shake import shake_of
from saltus.real2sim.problem.camera.testable import untestable_effects
from saltus.real2sim.problem.problem import LARGEST_RESIDUAL, Driver, Problem
from saltus.recordings.run_log import RunLog

RANGE, ROW, COLUMN = "range", "row", "column"  # names of drivers
LINEAR = 30.0  # up to here a residual is as it is; beyond, it is bent towards the limit
BEYOND = 1.01  # times an end of the range: at least as far goes a scene that it cuts
PROBE_S = 0.010  # latency by which it is judged whether the scene moves


class CameraProblem(Problem):
    """See `Problem`; one block, "camera".

    The base's pose is interpolated at the time of each exposure, rays go to the claimed terrain, and pixels are
    compared on a grid. Pixels near edges of depth are left out there: what happens at edges is counted instead, as are
    lost images and the spread of the noise, in rows of their own.

    Raises:
        RecordingError: no images, no claimed camera, or no image within the segments of the log.
    """

    name = "camera"
    blocks = ("camera",)
    places = ({"camera": "camera"},)
    signals = ("noise", "holes", "copies", "lost images", "usual noise", "filled holes", "end of range", "depth")
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
        self.signal = np.concatenate([np.repeat([depth, end], [len(self._at[0]), of_end]), counts.kind])
        self.time_s = np.concatenate([data.frames.stamp_s[data.kept][frame], counts.time_s])
        self._set_candidates()

    def _set_candidates(self) -> None:
        data = self._data
        latency_s = data.view.camera_latency + PROBE_S
        later = data.model.predict(replace(data.view, camera_latency=latency_s), data.kept)
        shift = self._depth_residuals(later) - self._depth_residuals(data.predicted)
        self.untestable = untestable_effects(data, self._counts, shift)
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
            rows.append(np.concatenate([self._depth_residuals(predicted), _bent(end), _bent(counted)]))
        return np.stack(rows)[:, None] if rows else np.empty((0, 1, len(self.segment)))

    def drivers(self) -> tuple[Driver, ...]:
        """Where in the image, and how far away; for depth only, not for what is counted."""
        data = self._data
        _, pixel = self._at
        seen = (
            (RANGE, "m", data.predicted[self._at]),
            (ROW, "px", data.grid.row[pixel].astype(np.float64)),
            (COLUMN, "px", data.grid.column[pixel].astype(np.float64)),
            ("distance to edges and holes", "px", data.grid.distance_to_others(data.known)[self._at]),
        )
        nothing = np.full(len(self.signal) - len(pixel), np.nan)
        return tuple(Driver(name=name, unit=unit, values=np.concatenate([v, nothing])) for name, unit, v in seen)

    def _depth_residuals(self, predicted: Floats) -> Floats:
        residual = (self._data.measured - predicted) / self._sigma
        return self._shake.whitened(_bent(residual))[self._at]


def _bent(residual: Floats) -> Floats:
    """Large residuals are bent so that none passes the limit; their order stays."""
    size = np.abs(residual)
    room = LARGEST_RESIDUAL - LINEAR
    bent = LINEAR + room * np.tanh(np.maximum(size - LINEAR, 0.0) / room)
    return np.asarray(np.sign(residual) * np.where(size > LINEAR, bent, size))
