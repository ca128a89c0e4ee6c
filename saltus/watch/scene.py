"""A run at an instant, as known from the messages of the seconds before it,
live and recorded alike.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Reals
from saltus.config import PLAN_TOPICS, RunConfig
from saltus.depth_camera import DepthCamera
from saltus.errors import MessageError
from saltus.footholds import Footholds
from saltus.recordings.recording import RecordedMessage
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.rotations import rotation_matrix, yaw_rotation
from saltus.terrain.terrain import Terrain
from saltus.wire import codec
from saltus.wire.messages import (
    ControllerMode,
    DepthFrame,
    Event,
    GroundTruth,
    Heightmap,
    HeightmapStatus,
    JointPlan,
    Message,
    MotionPlan,
    PlanStatus,
    RobotState,
    points_of,
)
from saltus.wire.topics import CAMERA_LATENCY_S, TOPICS, depth_topic, staleness_of

MessageT = TypeVar("MessageT", bound=Message)

LOOK_BACK_NS = 1_500_000_000
"""How far back messages are looked at: a topic that has said nothing for so long is silent."""
RATE_OVER_NS = 1_000_000_000
STEPS_APART_NS = 100_000_000
"""A heightmap whose truth is known is drawn rather than a newer one without, if it is no older than
this."""
SILENT = "silent"


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneWorld:
    """Parts of a scene that stay the same in a run."""

    title: str
    config: RunConfig
    robot: Robot
    terrain: Terrain
    camera: DepthCamera


@dataclass(frozen=True, kw_only=True)
class TopicRow:
    """How a topic is doing."""

    name: str
    rate_hz: float
    age_ms: float
    """Since the newest message was true; infinite where it is silent."""
    status: str
    """A value of `Freshness`, or "silent"."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightsInWorld:
    """A heightmap and the truth at its points."""

    predicted: Floats
    """World frame [m], shape (points, 3)."""
    half_width_90: Reals
    """90 % of the errors are smaller [m], shape (points,)."""
    true: Floats | None
    """World frame [m], shape (points, 3); None where nobody knows."""
    x: Floats
    """Distance ahead of the base [m], shape (points,)."""
    shape: tuple[int, int]
    """Rows and columns of the grid; points stand row after row."""
    status: HeightmapStatus
    depth_age_s: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A run at an instant; None for what nobody has said."""

    time_s: float
    """In the run's clock."""
    base_pose: Floats | None
    """Position [m] and quaternion (w, x, y, z) of the base in the world, shape (7,). True where a
    simulator says it; else from IMU and estimated height, at the origin."""
    joint_position: Floats
    """[rad], shape (12,)."""
    speed_mps: float
    """Horizontal, true or estimated."""
    feet: Floats
    """World frame [m], shape (4, 3)."""
    foot_force: Floats
    """Vertical ground reaction [N], shape (4,); zeros where nobody knows."""
    planned_feet: Floats
    """Where feet in swing are to stand next, on the predicted heights, world frame [m], shape (4,
    3); NaN for those that stand."""
    mode: ControllerMode | None
    plan: PlanStatus | None
    heights: HeightsInWorld | None
    scan: HeightsInWorld | None
    """Heights of `scan/heightmap`."""
    depth: DepthFrame | None
    topics: tuple[TopicRow, ...]
    events: tuple[Event, ...]
    """The newest last."""


class SceneMaker:
    """Makes scenes of one run."""

    def __init__(self, world: SceneWorld) -> None:
        self.world = world
        self._legs = LegKinematics(world.robot)
        self._footholds = Footholds(world.robot)
        self._topics = {
            **TOPICS,
            "camera/depth": depth_topic(world.camera.latency_s or CAMERA_LATENCY_S),
        }
        for unused in set(PLAN_TOPICS) - set(world.config.plan_topics):
            del self._topics[unused]

    def make(
        self, arrivals: Iterable[RecordedMessage], now_ns: int, events: tuple[Event, ...]
    ) -> Scene:
        """The scene at `now_ns`, from what came in within `LOOK_BACK_NS`,
        in order, and from all events.
        """
        rows = list(arrivals)
        newest = {row.key: row for row in rows}
        rates = Counter(row.key for row in rows if row.arrival_ns > now_ns - RATE_OVER_NS)
        truths = {row.envelope.capture_ns: row for row in rows if row.key == "plant/truth"}
        with_truth = next(
            (
                r
                for r in reversed(rows)
                if r.key == "heightmap/heightmap" and r.envelope.capture_ns in truths
            ),
            None,
        )
        if with_truth is not None and now_ns - with_truth.envelope.capture_ns < STEPS_APART_NS:
            newest["heightmap/heightmap"] = with_truth
        state = _newest(RobotState, newest, "controller/state")
        truth = _newest(GroundTruth, newest, "plant/truth")
        plan = _newest(MotionPlan, newest, "policy/plan")
        told = plan or _newest(JointPlan, newest, "policy/joints")
        heightmap = _newest(Heightmap, newest, "heightmap/heightmap")
        scan = _newest(Heightmap, newest, "scan/heightmap")
        pose, joints = _pose(truth, state)
        velocity = truth or state
        return Scene(
            time_s=1e-9 * now_ns,
            base_pose=pose,
            joint_position=joints,
            speed_mps=float(np.hypot(*velocity.velocity_base_in_world[:2]))
            if velocity is not None
            else float("nan"),
            feet=_feet(self._legs, pose, joints),
            foot_force=np.zeros(4) if truth is None else np.asarray(truth.foot_force),
            planned_feet=self._planned_feet(state, plan, heightmap, pose),
            mode=None if state is None else ControllerMode(state.mode),
            plan=None if told is None else PlanStatus(told.status),
            heights=None if heightmap is None else _heights(heightmap, truths, pose),
            scan=None if scan is None else _heights(scan, truths, pose),
            depth=_newest(DepthFrame, newest, "camera/depth"),
            topics=tuple(self._rows(newest, rates, now_ns)),
            events=events,
        )

    def _rows(
        self, newest: dict[str, RecordedMessage], rates: Counter[str], now_ns: int
    ) -> Iterable[TopicRow]:
        for topic in self._topics.values():
            keys = [key for key in newest if key == topic.name or key.startswith(f"{topic.name}/")]
            if topic.rate_hz == 0.0:
                continue
            missed = not topic.beside and topic.publisher != "*"
            for key in sorted(keys) or ([topic.name] if missed else []):
                if key not in newest:
                    yield TopicRow(name=key, rate_hz=0.0, age_ms=float("inf"), status=SILENT)
                    continue
                capture_ns = newest[key].envelope.capture_ns
                yield TopicRow(
                    name=key,
                    rate_hz=rates[key] * 1e9 / RATE_OVER_NS,
                    age_ms=1e-6 * (now_ns - capture_ns),
                    status=staleness_of(topic, capture_ns, now_ns).value,
                )

    def _planned_feet(
        self,
        state: RobotState | None,
        plan: MotionPlan | None,
        heightmap: Heightmap | None,
        pose: Floats | None,
    ) -> Floats:
        """The end of the law's own path of each swinging foot, with the plan's residual."""
        if state is None or plan is None or pose is None:
            return np.full((4, 3), np.nan)
        return np.asarray(
            pose[:3] + self._footholds.planned(state, plan, heightmap) @ _heading(pose).T
        )


def _newest(kind: type[MessageT], newest: dict[str, RecordedMessage], key: str) -> MessageT | None:
    """The newest message of a key; None where there is none, or it is malformed."""
    row = newest.get(key)
    try:
        return None if row is None else codec.decode_message(kind, row.payload)
    except MessageError:
        return None


def _pose(truth: GroundTruth | None, state: RobotState | None) -> tuple[Floats | None, Floats]:
    if truth is not None:
        pose = np.concatenate([truth.position_base_in_world, truth.quaternion_base_in_world])
        return pose, np.asarray(truth.joint_position)
    if state is not None:
        pose = np.concatenate([[0.0, 0.0, state.base_height], state.quaternion_base_in_world])
        return pose, np.asarray(state.joint_position)
    return None, np.zeros(12)


def _feet(legs: LegKinematics, pose: Floats | None, joints: Floats) -> Floats:
    if pose is None:
        return np.full((4, 3), np.nan)
    feet = legs.position(np.asarray(joints, dtype=np.float64))
    return np.asarray(pose[:3] + feet @ rotation_matrix(np.asarray(pose[3:], dtype=np.float64)).T)


def _heading(pose: Floats) -> NDArray[np.float64]:
    """Rotation from the yaw frame of the base to the world, shape (3, 3)."""
    rotation = rotation_matrix(np.asarray(pose[3:], dtype=np.float64))
    return np.asarray(yaw_rotation(np.arctan2(rotation[1, 0], rotation[0, 0])))


def _same_points(truth: GroundTruth, heightmap: Heightmap) -> bool:
    """Truth is told at the planner's points alone."""
    return np.array_equal(points_of(truth), points_of(heightmap))


def _heights(
    heightmap: Heightmap, truths: dict[int, RecordedMessage], pose: Floats | None
) -> HeightsInWorld | None:
    """A heightmap is relative to where the base was when it was true."""
    row = truths.get(heightmap.time_ns)
    truth = None if row is None else _newest(GroundTruth, {"": row}, "")
    base = pose if truth is None else _pose(truth, None)[0]
    if base is None:
        return None

    def in_world(heights: Heightmap | GroundTruth) -> Floats:
        local = np.concatenate([points_of(heights), np.asarray(heights.height)[:, None]], axis=-1)
        return base[:3] + local @ _heading(base).T

    return HeightsInWorld(
        predicted=in_world(heightmap),
        half_width_90=np.asarray(heightmap.half_width_90),
        true=in_world(truth) if truth is not None and _same_points(truth, heightmap) else None,
        x=points_of(heightmap)[:, 0],
        shape=(len(heightmap.x), len(heightmap.y)),
        status=HeightmapStatus(heightmap.status),
        depth_age_s=heightmap.depth_age_s,
    )
