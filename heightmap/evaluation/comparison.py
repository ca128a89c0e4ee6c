"""Predicted heights and the reference, for every step of a recorded run."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saltus import rotations
from saltus.arrays import Floats
from saltus.depth import MODEL_CAMERA, RANGE_M
from saltus.errors import RecordingError
from saltus.grid import HeightGrid
from saltus.heightmap.evaluation.geometric import FOOT_GAIN, GeometricHeightmap
from saltus.heightmap.evaluation.odometry import VelocityOdometry
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.replay import HeightPredictor, replay_predictor
from saltus.heightmap.service.service import HeightmapService
from saltus.recordings.recording import Recording
from saltus.render.camera import camera_pose
from saltus.robots.mount import Mount
from saltus.robots.robot import Robot
from saltus.wire.messages import (
    ControllerMode,
    DepthFrame,
    GroundTruth,
    Heightmap,
    HeightmapStatus,
    RobotState,
)

RECORDED = "recorded"
BASELINES = {"geometric": 0.0, "geometric-feet": FOOT_GAIN}
"""Geometric baselines by name, with the gain by which their map follows the feet."""
# A place counts as seen again from five images later on; odometry drifts: not for longer than 2 s
LATER_S = (
    0.1,
    2.0,
)
SHOWN_LOST = 2
"""Parts of a damaged recording that an error message names."""
FLIGHT, FRONT, REAR, ALL = "flight", "front stance", "rear stance", "front and rear"
PHASES = (FRONT, FLIGHT, REAR, ALL)


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedRun:
    """The messages of a recording that tell about heights, by step."""

    name: str
    robot: Robot
    grid: HeightGrid
    terrain: str
    states: dict[int, RobotState]
    truths: dict[int, GroundTruth]
    frames: list[DepthFrame]
    arrival_ns: list[int]
    recorded: dict[int, Heightmap]
    lost: tuple[str, ...]
    """Losses of the recording, one line each."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightComparison:
    """Heights of one predictor beside the true ones, in one recorded run.

    N steps in which every predictor that is compared had a heightmap of status OK.
    """

    run: str
    terrain: str
    predictor: str
    reference: str
    """Reference of the prediction: "truth", or "seen later" where the recording has no truth."""
    x: Floats
    """Place of each point ahead of the base [m], shape (30,)."""
    ok_share: float
    """Share of the steps for which this predictor had a heightmap of status OK."""
    step: NDArray[np.int64]
    time_s: Floats
    """Since the first state, shape (n,)."""
    height: Floats
    """Predicted, relative to the base [m], shape (n, 30)."""
    half_width_90: Floats
    """Half of its 90 % interval, as the predictor states it [m], shape (n, 30)."""
    true_height: Floats
    """By the reference, NaN where it does not know [m], shape (n, 30)."""
    visible: NDArray[np.bool_]
    """Inside the camera's field of view when the image in use was taken, shape (n, 30)."""
    phase: NDArray[np.str_]
    """One of `PHASES`, by scheduled contact, shape (n,)."""
    progress: Floats
    """In [0, 1], of the legs that stand; in flight of the legs that land next. Shape (n,)."""
    speed_mps: Floats
    age_s: Floats
    """Age of the image in use, shape (n,)."""
    frame_id: NDArray[np.int64]

    @property
    def error(self) -> Floats:
        """Predicted less true [m], NaN where the reference does not know. Shape (n, 30)."""
        return self.height - self.true_height


@dataclass(frozen=True, kw_only=True, eq=False)
class _Poses:
    """Base in the world, by ground truth or by odometry, at n times."""

    time_ns: NDArray[np.int64]
    position: Floats
    quaternion: Floats
    yaw: Floats

    def at(self, time_ns: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Position and quaternion at other times, linear between two."""
        start = self.time_ns[0]
        when, known = time_ns - start, self.time_ns - start
        position = np.stack([np.interp(when, known, column) for column in self.position.T], axis=-1)
        quaternion = np.stack(
            [np.interp(when, known, column) for column in self.quaternion.T], axis=-1
        )
        return position, quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)


def read_compared_run(recording: Recording) -> ComparedRun:
    """Reads what a recording has, whole or not."""
    arrivals, frames = [], []
    for arrival_ns, _, frame in recording.messages("camera/depth"):
        if isinstance(frame, DepthFrame):
            arrivals.append(arrival_ns)
            frames.append(frame)
    states = {m.step: m for m in recording.of(RobotState)}
    truths = {m.step: m for m in recording.of(GroundTruth)}
    recorded = {m.step: m for m in recording.of(Heightmap)}
    missing = (
        *_missing("robot states", list(states)),
        *_missing("heightmaps", list(recorded)),
        *_missing("ground truth", list(truths)),
        *_missing("depth images", [frame.frame_id for frame in frames]),
    )
    path = recording.path
    return ComparedRun(
        name=path.parent.name if path.stem == "recording" else path.stem,
        robot=recording.robot,
        grid=recording.grid,
        terrain=recording.terrain.kind if recording.config else "unknown",
        states=dict(sorted(states.items())),
        truths=truths,
        frames=frames,
        arrival_ns=arrivals,
        recorded=recorded,
        lost=(*recording.lost, *missing),
    )


def lost_note(lost: Sequence[str]) -> str:
    """Note on what a recording lacks, for the end of an error message.

    Empty where it lacks nothing.
    """
    more = f"; and {len(lost) - SHOWN_LOST} more" if len(lost) > SHOWN_LOST else ""
    return f" (lost: {'; '.join(lost[:SHOWN_LOST])}{more})" if lost else ""


def predictor_named(name: str, robot: Robot, grid: HeightGrid) -> HeightPredictor:
    """A fresh predictor of heights: "geometric", "geometric-feet",
    or the path of an ONNX file (or `ModelError`).
    """
    if name in BASELINES:
        return GeometricHeightmap(robot, grid, foot_gain=BASELINES[name])
    return HeightmapService(HeightmapNetwork(robot, Path(name), grid))


def compare_heights(run: ComparedRun, models: Sequence[str] = ()) -> list[HeightComparison]:
    """Compares the heightmaps of a recording, and those of models on its depth,
    with what is true or was seen later.

    Models are names for `predictor_named`. Only steps in which the robot runs count; all steps
    where it never does.

    Raises:
        RecordingError: nothing in the recording can be compared.
    """
    predicted = {RECORDED: run.recorded} if run.recorded else {}
    states = list(run.states.values())
    for model in models:
        replayed = replay_predictor(
            predictor_named(model, run.robot, run.grid), run.frames, states, run.arrival_ns
        )
        predicted[model] = {heightmap.step: heightmap for heightmap in replayed}
    ok = {
        name: {step for step, heightmap in maps.items() if heightmap.status == HeightmapStatus.OK}
        for name, maps in predicted.items()
    }
    steps = set(run.states) & (set(run.truths) if run.truths else set(run.states))
    common = steps.intersection(*ok.values()) if ok else set()
    running = {step for step in common if run.states[step].mode == ControllerMode.RUN}
    used = sorted(running or common)
    if not used:
        raise RecordingError(
            f"{run.name}: no step has a robot state and a heightmap of status OK of every "
            f"model{lost_note(run.lost)}"
        )
    poses = _poses(run)
    result = []
    for name, maps in predicted.items():
        share = len(ok[name] & run.states.keys()) / len(run.states)
        result.append(_comparison(run, name, [maps[step] for step in used], poses, share))
    return result


def _comparison(
    run: ComparedRun, name: str, maps: list[Heightmap], poses: _Poses, ok_share: float
) -> HeightComparison:
    states = [run.states[heightmap.step] for heightmap in maps]
    time_ns = np.array([state.time_ns for state in states], np.int64)
    age_s = np.array([heightmap.depth_age_s for heightmap in maps])
    height: Floats = np.array([heightmap.height for heightmap in maps], np.float64)
    true_height: Floats
    mount = Mount.of(run.robot)
    position, _ = poses.at(time_ns)
    yaw = np.interp(time_ns - poses.time_ns[0], poses.time_ns - poses.time_ns[0], poses.yaw)
    captured = poses.at(time_ns - np.rint(1e9 * age_s).astype(np.int64))
    if run.truths:
        true_height = np.array([run.truths[state.step].height for state in states], np.float64)
        place = _places(run.grid, position, yaw, true_height)
    else:
        place = _places(run.grid, position, yaw, height)
        true_height = _seen_later(run.grid, mount, time_ns, position, yaw, captured, height)
    phases = [_phase(state) for state in states]
    return HeightComparison(
        run=run.name,
        terrain=run.terrain,
        predictor=name,
        reference="truth" if run.truths else "seen later",
        x=run.grid.points[:, 0],
        ok_share=ok_share,
        step=np.array([state.step for state in states], np.int64),
        time_s=(time_ns - poses.time_ns[0]) * 1e-9,
        height=height,
        half_width_90=np.array([heightmap.half_width_90 for heightmap in maps], np.float64),
        true_height=true_height,
        visible=in_view(mount, place, *captured),
        phase=np.array([phase for phase, _ in phases]),
        progress=np.array([progress for _, progress in phases]),
        speed_mps=np.array(
            [float(np.hypot(*state.velocity_base_in_world[:2])) for state in states]
        ),
        age_s=age_s,
        frame_id=np.array([heightmap.frame_id for heightmap in maps], np.int64),
    )


def in_view(mount: Mount, place: Floats, position: Floats, quaternion: Floats) -> NDArray[np.bool_]:
    """True where points are inside the field of view and the range of the model's camera.

    Args:
        mount: of the camera.
        place: [m], world frame, shape (..., m, 3).
        position: of the base, shape (..., 3).
        quaternion: of the base, shape (..., 4).

    Returns:
        Shape (..., m).
    """
    origin, rotation = camera_pose(mount, position, quaternion)
    in_camera = (place - np.asarray(origin)[..., None, :]) @ np.asarray(rotation)
    depth = np.maximum(in_camera[..., 2], 1e-6)
    u = MODEL_CAMERA.fx * in_camera[..., 0] / depth + MODEL_CAMERA.cx
    v = MODEL_CAMERA.fy * in_camera[..., 1] / depth + MODEL_CAMERA.cy
    inside = (u >= 0) & (u <= MODEL_CAMERA.width) & (v >= 0) & (v <= MODEL_CAMERA.height)
    visible: NDArray[np.bool_] = inside & (in_camera[..., 2] > 0) & (in_camera[..., 2] < RANGE_M)
    return visible


def _missing(what: str, numbers: list[int]) -> list[str]:
    """Says how many of a numbered series are not there, between the first and the last that is."""
    if not numbers:
        return [f"no {what}"]
    count = max(numbers) - min(numbers) + 1 - len(set(numbers))
    return [f"{count} of {count + len(set(numbers))} {what}"] if count else []


def _poses(run: ComparedRun) -> _Poses:
    if run.truths:
        truths = [run.truths[step] for step in sorted(run.truths)]
        time_ns = np.array([truth.time_ns for truth in truths], np.int64)
        position = np.array([truth.position_base_in_world for truth in truths], np.float64)
        quaternion = np.array([truth.quaternion_base_in_world for truth in truths], np.float64)
    else:
        odometry, path = VelocityOdometry(memory_s=0.0), []
        for state in run.states.values():
            odometry.advance(state)
            path.append(odometry.pose)
        time_ns = np.array([pose.time_ns for pose in path], np.int64)
        position = np.array([pose.position for pose in path])
        quaternion = np.array([pose.quaternion for pose in path])
    yaw = rotations.roll_pitch_yaw(rotations.rotation_matrix(quaternion))[2]
    return _Poses(time_ns=time_ns, position=position, quaternion=quaternion, yaw=np.unwrap(yaw))


def _places(grid: HeightGrid, position: Floats, yaw: Floats, height: Floats) -> Floats:
    """The points of heightmaps in the world, shape (n, 30, 3)."""
    x, y = grid.points_in_world(position, yaw)
    return np.stack([x, y, position[:, 2, None] + height], axis=-1)


def _seen_later(
    grid: HeightGrid,
    mount: Mount,
    time_ns: NDArray[np.int64],
    position: Floats,
    yaw: Floats,
    captured: tuple[Floats, Floats],
    height: Floats,
) -> Floats:
    """Predictions for the same places when they were last in view,
    thus nearest; NaN where they never were.

    Relative to the base at each step [m], shape (n, 30).
    """
    places, x = _places(grid, position, yaw, height), grid.points[:, 0]
    result = np.full(height.shape, np.nan)
    for k, place in enumerate(places):
        first, last = np.searchsorted(time_ns, time_ns[k] + 1e9 * np.array(LATER_S))
        if first >= last:
            continue
        later = slice(int(first), int(last))
        offset = place[None, :, :2] - position[later, None, :2]
        ahead = (
            np.cos(yaw[later])[:, None] * offset[..., 0]
            + np.sin(yaw[later])[:, None] * offset[..., 1]
        )
        spread = np.broadcast_to(place, (last - first, *place.shape))
        seen = in_view(mount, spread, captured[0][later], captured[1][later])
        seen &= (ahead >= x[0]) & (ahead <= x[-1])
        for i in np.flatnonzero(seen.any(axis=0)):
            j = int(np.flatnonzero(seen[:, i])[-1])
            z = np.interp(ahead[j, i], x, height[first + j]) + position[first + j, 2]
            result[k, i] = z - position[k, 2]
    return result


def _phase(state: RobotState) -> tuple[str, float]:
    """Scheduled contact and how far it is."""
    contact = np.asarray(state.leg_contact, np.bool_)
    progress = np.asarray(state.leg_progress, np.float64)
    front, rear = bool(contact[:2].any()), bool(contact[2:].any())
    phase = {(True, False): FRONT, (False, True): REAR, (True, True): ALL, (False, False): FLIGHT}[
        front, rear
    ]
    return phase, float(progress[contact].mean() if contact.any() else progress.max())
