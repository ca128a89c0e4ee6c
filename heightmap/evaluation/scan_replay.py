"""The service of any grid on a recorded run again, and how far its heights are off the simulator's ground."""

import heapq
from collections.abc import Iterable, Iterator

import numpy as np

from saltus.errors import RecordingError
from saltus.grid import HeightGrid
from saltus.heightmap.service.scan import ScanService
from saltus.heightmap.service.scan_fleet import ScanChoice
from saltus.recordings.recording import Recording
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.wire.messages import DepthFrame, GroundTruth, Heightmap, RobotState
from saltus.wire.topics import depth_topic

SETTLED_NS = 1_000_000_000
"""Figures are of what comes so long after the first image, as those of models/scan.md."""
VISIBLE_S = 0.2
"""A point is visible where a ray of an image ended that was exposed within this time before its
newest image."""


def replayed_run(
    recording: Recording, choice: ScanChoice
) -> Iterator[tuple[RobotState, dict[str, DepthFrame], Heightmap]]:
    """Each recorded state with the images that came with it, by camera, and its answer, in order of time.

    Raises:
        RecordingError: there is no image or no state in it, or none of one of the cameras.
    """
    times = [
        (arrival_ns, envelope.capture_ns)
        for arrival_ns, envelope, _ in recording.payloads("camera/depth")
    ]
    states = recording.of(RobotState)
    if not times or not states:
        raise RecordingError(
            f"{recording.path} has no {'robot state' if times else 'depth image'}: record a run"
        )
    latency_s = 1e-9 * min(arrival_ns - capture_ns for arrival_ns, capture_ns in times)
    rig = choice.rig(recording.robot, recording.camera)
    service = ScanService(choice.network(), rig, depth_topic(latency_s))
    arriving = _images(recording, list(rig.cameras))
    following = next(arriving, None)
    for state in states:
        newest: dict[str, DepthFrame] = {}
        while following is not None and following[0] <= state.time_ns:
            newest[following[1]], following = following[2], next(arriving, None)
        yield state, newest, service.step(state, newest, state.time_ns)


def _images(recording: Recording, cameras: list[str]) -> Iterator[tuple[int, str, DepthFrame]]:
    """Arrival [ns], camera and image, of all cameras in order of arrival."""

    def of_camera(name: str) -> Iterator[tuple[int, str, DepthFrame]]:
        for ns, _, frame in recording.messages("camera/depth" + (f"/{name}" if name else "")):
            if isinstance(frame, DepthFrame):
                yield ns, name, frame

    for name in cameras:
        if next(of_camera(name), None) is None:
            raise RecordingError(
                f"{recording.path} has no images of the camera '{name}': it needs the name under "
                "which they were sent"
            )
    yield from heapq.merge(*map(of_camera, cameras), key=lambda each: each[0])


def scan_errors(
    recording: Recording, grid: HeightGrid, answers: Iterable[Heightmap]
) -> dict[str, object]:
    """Errors [mm], share inside the 90 % interval, median half-width [mm] and share of all points, by visibility.

    Only `points` where the recording has no truth, or no image came a second before its end.
    """
    truths = {truth.step: truth for truth in recording.of(GroundTruth)}
    columns: list[list[np.ndarray]] = [[], [], [], []]
    begun_ns = None
    for answer in answers:
        begun_ns = answer.time_ns if begun_ns is None and answer.seen_share > 0.0 else begun_ns
        truth = truths.get(answer.step)
        if truth is None or begun_ns is None or answer.time_ns - begun_ns < SETTLED_NS:
            continue
        height = true_heights(recording, grid, truth)
        found = (
            np.abs(answer.height - height),
            answer.half_width_90,
            answer.age_s,
            answer.depth_age_s + 0.0 * height,
        )
        for column, values in zip(columns, found, strict=True):
            column.append(np.asarray(values))
    if not columns[0]:
        return {"points": grid.size}
    error, half_width, age_s, newest_s = (np.concatenate(column) for column in columns)
    seen, lately = np.isfinite(age_s), age_s - newest_s < VISIBLE_S
    kinds = {
        "all": seen | True,
        "seen": seen,
        "visible": lately,
        "remembered": seen & ~lately,
        "never": ~seen,
    }
    return {"points": grid.size} | {
        name: {
            "mean_mm": round(1e3 * float(error[kind].mean()), 2),
            "inside": round(float((error <= half_width)[kind].mean()), 3),
            "half_width_mm": round(1e3 * float(np.median(half_width[kind])), 1),
            "share": round(float(kind.mean()), 3),
        }
        for name, kind in kinds.items()
        if kind.any()
    }


def true_heights(recording: Recording, grid: HeightGrid, truth: GroundTruth) -> np.ndarray:
    """Heights of the ground at the points of a grid, relative to the base [m], shape (points,)."""
    _, _, yaw = roll_pitch_yaw(rotation_matrix(np.asarray(truth.quaternion_base_in_world)))
    position = np.asarray(truth.position_base_in_world)
    return np.asarray(
        recording.terrain.height_at(*grid.points_in_world(position, yaw)) - position[2]
    )
