"""Derived messages in ROS 2's own types, so that a viewer shows a recording at once.

`TOPICS` is the table of them. They hold nothing that the messages on the bus and the metadata do
not. Where no simulator says the truth, the robot stands at the origin, as IMU and estimated height
have it. An image was taken at a time at which there is a transform, so that each of its points has
a place in the world.
"""

import math
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from rosbags.typesys import get_types_from_msg

from saltus.arrays import Floats
from saltus.constants import FORCE_M_PER_N, LOADED_N
from saltus.footholds import Footholds
from saltus.recordings import ros_messages as ros
from saltus.recordings.ros_messages import BASE, BASE_YAW, CAMERA, WORLD
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import LINKS, Robot
from saltus.rotations import rotation_matrix
from saltus.sim.robot_model import TRUNK
from saltus.sim.visual_shapes import looks_of
from saltus.terrain.terrain import Terrain
from saltus.wire import ros_types
from saltus.wire.bus import topic_of
from saltus.wire.cdr import make_ros_header, make_ros_time
from saltus.wire.codec import LOG_INFO
from saltus.wire.depth_codec import depth_on_the_wire
from saltus.wire.messages import (
    DepthFrame,
    Event,
    GroundTruth,
    Heightmap,
    Message,
    MotionPlan,
    RobotState,
    points_of,
)
from saltus.wire.schemas import EVENT_TYPE

EVERY = 5  # one in five, 20 a second, is enough for the eye
LEGS_EVERY = 2  # legs swing in 0.2 s
KEPT = 50  # truths that a heightmap may belong to: half a second of them

NUMBERS_TYPE = "saltus_msgs/msg/Numbers"
NUMBERS = (
    ("float64", "speed", "Horizontal [m/s], true or estimated."),
    ("float64", "x", "True place along the course [m]."),
    ("float64", "base_height", "Estimated height of the base above the feet in stance [m]."),
    ("uint8", "mode", "`mode` of the newest robot state."),
    ("uint8", "plan_status", "`status` of the newest plan; 255 before the first."),
    ("uint8", "heightmap_status", "`status` of the newest heightmap; 255 before the first."),
    ("float64", "depth_age_ms", "Since the newest message of `camera/depth` was true."),
    ("float64", "heightmap_age_ms", "The same of `heightmap/heightmap`."),
    ("float64", "plan_age_ms", "The same of `policy/plan`."),
    (
        "float64",
        "height_error_mm",
        "How far the newest heightmap is off the truth, mean over its points.",
    ),
    ("float64", "height_error_max_mm", "The same at the worst point."),
    ("float64", "half_width_90_mm", "Mean half-width of the predicted 90 % intervals."),
    ("float64", "foot_force_fr", "True vertical force [N], as the three that follow."),
    ("float64", "foot_force_fl", ""),
    ("float64", "foot_force_rr", ""),
    ("float64", "foot_force_rl", ""),
)
"""Type, name and meaning of the fields after the header; NaN for what nobody knows."""
ros.STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\n" + "".join(f"{t} {n}\n" for t, n, _ in NUMBERS), NUMBERS_TYPE
    )
)
NEVER = 255  # a status before the first message

MARKERS = "visualization_msgs/msg/MarkerArray"
POINTS = "sensor_msgs/msg/PointCloud2"
TOPICS: dict[str, tuple[str, str]] = {
    "/viewer/robot": (MARKERS, "shapes of the robot, each in the frame of its link; once"),
    "/viewer/terrain": (MARKERS, "the boxes of the terrain; once"),
    "/viewer/tf": (
        "tf2_msgs/msg/TFMessage",
        "world to base and base_yaw, base to camera (z along the optical axis), 100 Hz; links of "
        "the legs, 50 Hz",
    ),
    "/viewer/depth": ("sensor_msgs/msg/Image", "one depth image in five"),
    "/viewer/camera_info": (
        "sensor_msgs/msg/CameraInfo",
        "of that image: pixel (u, v) looks through ((u - cx) / fx, (v - cy) / fy)",
    ),
    "/viewer/heightmap": (
        POINTS,
        "predicted heights in the yaw frame, half_width_90 and, of a scan, age; NaN where not to "
        "be used",
    ),
    "/viewer/grid_map": (
        "grid_map_msgs/msg/GridMap",
        "the same as layers elevation, variance, half_width, age; sigma is half of the 90 % "
        "interval over 1.645",
    ),
    "/viewer/scan": (POINTS, "the same points of `scan/heightmap`, where a run has it"),
    "/viewer/true_heights": (
        POINTS,
        "true heights at the same points, where a simulator says them",
    ),
    "/viewer/plan": (MARKERS, "where feet in swing are to stand next, and the way there"),
    "/viewer/contacts": (MARKERS, "feet that are to stand, and the true force on each foot"),
    "/viewer/numbers": (NUMBERS_TYPE, "speed, modes, ages, errors, forces: fields to plot"),
    "/viewer/log": (EVENT_TYPE, "all events in one topic"),
}
"""Type of each derived topic, and what it holds; 20 Hz where the text says nothing else."""

# Okabe and Ito's palette, as the page of saltus watch has it
PLANNED, FORCE, STANCE = (
    (0.0, 0.447, 0.698, 1.0),
    (0.902, 0.624, 0.0, 1.0),
    (0.337, 0.706, 0.914, 1.0),
)
GREY = (0.6, 0.63, 0.68, 1.0)
DOT_M, LINE_M = 0.03, 0.012
KINDS = {"box": ros.CUBE, "ball": ros.SPHERE, "cylinder": ros.CYLINDER}


@dataclass(frozen=True, eq=False)
class ViewerMessage:
    """One message for a viewer such as Foxglove, derived from those of a run."""

    topic: str
    type_name: str
    payload: bytes


class Viewer:
    """Derives what a viewer needs of the messages of one run,
    which it is given in order of arrival.
    """

    def __init__(self, robot: Robot, terrain: Terrain) -> None:
        self._terrain = terrain
        self._looks = looks_of(robot)
        self._frames = RobotFrames(robot)
        self._legs = LegKinematics(robot)
        self._footholds = Footholds(robot)
        self._counts: Counter[str] = Counter()
        self._captured: dict[str, int] = {}
        self._truths: deque[GroundTruth] = deque(maxlen=KEPT)
        self._plan: MotionPlan | None = None
        self._heightmap: Heightmap | None = None
        self._errors: Floats | None = None
        for type_name, _ in TOPICS.values():
            ros.prepare(type_name)

    def first(self) -> Iterator[ViewerMessage]:
        """Channels of what stands still: robot and terrain."""
        yield _message("/viewer/robot", ros.marker_array(list(self._robot_markers())))
        yield _message("/viewer/terrain", ros.marker_array(list(self._terrain_markers())))

    def derive(self, key: str, message: Message, arrival_ns: int) -> Iterator[ViewerMessage]:
        """Derived messages for viewers, of one message of a key below the robot's prefix.

        None for most.
        """
        topic = topic_of(key)
        if topic is None:
            return
        self._counts[key] += 1
        self._captured[topic.name] = message.time_ns
        drawn = self._counts[key] % EVERY == 0
        if isinstance(message, GroundTruth):
            self._truths.append(message)
            yield self._transforms(message, message.position_base_in_world)
        elif isinstance(message, RobotState):
            yield from self._of_state(message, arrival_ns, drawn=drawn)
        elif isinstance(message, MotionPlan):
            self._plan = message
        elif isinstance(message, Heightmap) and topic.beside:
            if drawn:
                yield _message("/viewer/scan", ros.height_points(message))
        elif isinstance(message, Heightmap):
            yield from self._of_heightmap(message, drawn=drawn)
        elif isinstance(message, DepthFrame) and key == topic.name and drawn:
            wire = depth_on_the_wire(message)
            yield _message("/viewer/depth", wire.image)
            yield _message("/viewer/camera_info", wire.camera_info)
        elif isinstance(message, Event):
            text = f"{message.code} {message.detail}".strip()
            yield _message(
                "/viewer/log",
                ros.make(
                    EVENT_TYPE, stamp=make_ros_time(message.time_ns), level=LOG_INFO,
                    name=message.process, msg=text, file="", function=message.code, line=0,
                ),
            )  # fmt: skip

    def _of_state(
        self, state: RobotState, arrival_ns: int, *, drawn: bool
    ) -> Iterator[ViewerMessage]:
        if not self._truths:
            yield self._transforms(state, (0.0, 0.0, state.base_height))
        if drawn:
            yield _message("/viewer/contacts", ros.marker_array(list(self._contacts(state))))
            yield _message("/viewer/plan", ros.marker_array(list(self._planned(state))))
            yield _message("/viewer/numbers", self._numbers(state, arrival_ns))

    def _of_heightmap(self, heightmap: Heightmap, *, drawn: bool) -> Iterator[ViewerMessage]:
        self._heightmap = heightmap
        truth = next(
            (truth for truth in reversed(self._truths) if truth.time_ns == heightmap.time_ns), None
        )
        self._errors = (
            None
            if truth is None or len(truth.height) != len(heightmap.height)
            else np.abs(heightmap.height - truth.height)
        )
        if not drawn:
            return
        yield _message("/viewer/heightmap", ros.height_points(heightmap))
        if len(heightmap.height) > 1:
            yield _message("/viewer/grid_map", ros.grid_map(heightmap))
        if truth is not None:
            x, y = points_of(truth).T
            places = ros.points(heightmap.time_ns, BASE_YAW, x=x, y=y, z=truth.height)
            yield _message("/viewer/true_heights", places)

    def _transforms(self, body: GroundTruth | RobotState, position: ArrayLike) -> ViewerMessage:
        """Where the base is, and in one of `LEGS_EVERY` where its links are."""
        turned, time_ns = np.asarray(body.quaternion_base_in_world), body.time_ns
        where, head = ros.vector(position), make_ros_header(time_ns, WORLD)
        transforms = [
            ros.place(head, BASE, where, ros.quaternion(turned)),
            ros.place(head, BASE_YAW, where, ros.quaternion(ros.yaw_of(turned))),
            self._frames.camera(time_ns),
        ]
        if body.step % LEGS_EVERY == 0:
            transforms += self._frames.links(time_ns, body.joint_position)
        return _message("/viewer/tf", ros.make("tf2_msgs/msg/TFMessage", transforms=transforms))

    def _robot_markers(self) -> Iterator[ros_types.RosMessage]:
        for number, part in enumerate(self._looks.primitives):
            frame = BASE if part.body == TRUNK else part.body
            yield ros.marker(
                0, frame, "robot", number, KINDS[part.kind], rgba=part.rgba, scale=part.size,
                position=part.position,
                wxyz=part.quaternion, locked=True,
            )  # fmt: skip

    def _terrain_markers(self) -> Iterator[ros_types.RosMessage]:
        boxes = self._terrain.arrays
        rows = zip(boxes.center, 2.0 * boxes.half_size, boxes.quaternion, strict=True)
        for number, (centre, size, turned) in enumerate(rows):
            yield ros.marker(
                0, WORLD, "terrain", number, ros.CUBE, rgba=GREY, scale=size, position=centre,
                wxyz=turned
            )  # fmt: skip

    def _feet(self, state: RobotState) -> Floats:
        """Relative to the base, yaw frame [m], shape (4, 3)."""
        turned = np.asarray(state.quaternion_base_in_world, dtype=np.float64)
        yaw = rotation_matrix(np.array(ros.yaw_of(turned)))
        feet = self._legs.position(np.asarray(state.joint_position, dtype=np.float64))
        return np.asarray(feet @ rotation_matrix(turned).T @ yaw)

    def _contacts(self, state: RobotState) -> Iterator[ros_types.RosMessage]:
        feet = self._feet(state)
        standing = feet[np.asarray(state.leg_contact)]
        yield _dots(state, "stance", 0, STANCE, standing)
        force = np.asarray(self._truths[-1].foot_force) if self._truths else np.zeros(4)
        loaded = force > LOADED_N
        up = np.zeros((int(loaded.sum()), 3))
        up[:, 2] = FORCE_M_PER_N * force[loaded]
        yield _lines(state, "force", 1, FORCE, feet[loaded], feet[loaded] + up)

    def _planned(self, state: RobotState) -> Iterator[ros_types.RosMessage]:
        feet, planned = self._feet(state), np.full((4, 3), np.nan)
        if self._plan is not None:
            planned = self._footholds.planned(state, self._plan, self._heightmap)
        swings = np.isfinite(planned).all(axis=1)
        yield _dots(state, "target", 0, PLANNED, planned[swings])
        yield _lines(state, "way", 1, PLANNED, feet[swings], planned[swings])

    def _numbers(self, state: RobotState, arrival_ns: int) -> ros_types.RosMessage:
        truth = self._truths[-1] if self._truths else None
        heightmap, plan, errors = self._heightmap, self._plan, self._errors
        velocity = np.asarray((truth or state).velocity_base_in_world)
        nan = float("nan")

        def age_ms(topic: str) -> float:
            return 1e-6 * (arrival_ns - self._captured[topic]) if topic in self._captured else nan

        forces = np.full(4, nan) if truth is None else np.asarray(truth.foot_force)
        legs = dict(zip(("fr", "fl", "rr", "rl"), map(float, forces), strict=True))
        return ros.make(
            NUMBERS_TYPE,
            header=make_ros_header(state.time_ns, BASE),
            speed=float(np.hypot(velocity[0], velocity[1])),
            x=nan if truth is None else float(truth.position_base_in_world[0]),
            base_height=float(state.base_height),
            mode=int(state.mode),
            plan_status=NEVER if plan is None else int(plan.status),
            heightmap_status=NEVER if heightmap is None else int(heightmap.status),
            depth_age_ms=age_ms("camera/depth"),
            heightmap_age_ms=age_ms("heightmap/heightmap"),
            plan_age_ms=age_ms("policy/plan"),
            height_error_mm=nan if errors is None else 1e3 * float(errors.mean()),
            height_error_max_mm=nan if errors is None else 1e3 * float(errors.max()),
            half_width_90_mm=nan
            if heightmap is None
            else 1e3 * float(np.mean(heightmap.half_width_90)),
            **{f"foot_force_{leg}": force for leg, force in legs.items()},
        )


class RobotFrames:
    """Where the frames of a robot are, as `geometry_msgs/msg/TransformStamped`.

    That of its trunk is named `base`.
    """

    def __init__(self, robot: Robot, base: str = BASE) -> None:
        looks = looks_of(robot)
        self._base = base
        self._links = [
            (
                base if parent == TRUNK else parent,
                body,
                ros.vector(offset),
                body.endswith(f"_{LINKS[0]}"),
            )
            for (body, parent), offset in zip(looks.parents.items(), looks.offsets, strict=True)
            if body != TRUNK
        ]
        self._camera = (
            ros.vector(robot.camera_position),
            ros.quaternion(ros.optical(robot.camera_roll, robot.camera_pitch, robot.camera_yaw)),
        )

    def camera(self, time_ns: int) -> ros_types.RosMessage:
        """The camera, z along its optical axis, on the base."""
        return ros.place(make_ros_header(time_ns, self._base), CAMERA, *self._camera)

    def links(self, time_ns: int, joint_position: ArrayLike) -> list[ros_types.RosMessage]:
        """The links of the legs, each in the frame of the one before it.

        Joint positions [rad], shape (12,).
        """
        places = []
        angles = np.asarray(joint_position, dtype=np.float64).tolist()
        for (parent, link, offset, abduction), angle in zip(self._links, angles, strict=True):
            cosine, sine = math.cos(0.5 * angle), math.sin(0.5 * angle)
            turned = (
                ros.QUATERNION(sine, 0.0, 0.0, cosine)
                if abduction
                else ros.QUATERNION(0.0, sine, 0.0, cosine)
            )
            places.append(ros.place(make_ros_header(time_ns, parent), link, offset, turned))
        return places


def _dots(
    state: RobotState, name: str, number: int, rgba: ros.Rgba, places: Floats
) -> ros_types.RosMessage:
    return ros.marker(
        state.time_ns,
        BASE_YAW,
        name,
        number,
        ros.SPHERE_LIST,
        rgba=rgba,
        scale=(DOT_M,) * 3,
        places=list(places),
    )


def _lines(
    state: RobotState, name: str, number: int, rgba: ros.Rgba, start: Floats, end: Floats
) -> ros_types.RosMessage:
    places = list(np.stack([start, end], axis=1).reshape(-1, 3))
    return ros.marker(
        state.time_ns,
        BASE_YAW,
        name,
        number,
        ros.LINE_LIST,
        rgba=rgba,
        scale=(LINE_M, 0.0, 0.0),
        places=places,
    )


def _message(topic: str, wire: ros_types.RosMessage) -> ViewerMessage:
    return ViewerMessage(topic, wire.__msgtype__, ros.payload_of(wire))
