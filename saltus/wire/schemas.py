"""THE table of what travels: the fields of every message,
their shapes and the bounds outside which it is refused.

The text of the ROS 2 message definitions is derived from it. Bounds are not limits of the robot:
they are wide enough for a simulated crash and narrow enough that nothing beyond them can be meant.
"""

import math
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Literal

from saltus.config import UNNAMED
from saltus.grid import load_grid
from saltus.wire import messages
from saltus.wire.messages import Message

WireType = Literal["float64", "int64", "bool", "uint8", "string"]

INDEX_MAX = 2**53  # the largest integer that viewers, which count in doubles, still show exactly
TEXT_MAX = 2048  # bytes of one string; an event is one line
JOINTS = 12
LEGS = 4
ANY = -1
"""As the size of a vector: as many as there are."""
POINTS_MAX = 4096  # of a grid of heights: 64 x 64
JOINT_ROWS_MAX = 50  # 100 ms of 500 Hz rows: what a stalled loop may hand over at once

DEPTH_TYPE = "saltus_msgs/msg/DepthFrame"
EVENT_TYPE = "rcl_interfaces/msg/Log"
STATUS_TYPE = "saltus_msgs/msg/ProcessStatus"


@dataclass(frozen=True)
class MessageField:
    """One field of a message as it travels."""

    name: str
    wire: WireType
    shape: tuple[int, ...] | None = None
    """None for a scalar; (-1,) for any number of values; (-1, n) for any number of rows of n."""
    low: float = -math.inf
    high: float = math.inf
    enum: type[IntEnum] | None = None
    may_lack: bool = False
    """A vector may also have no values: nobody knows them."""

    @property
    def definition(self) -> str:
        """The field's line in a ROS 2 message definition."""
        if self.shape is None:
            return f"{self.wire} {self.name}"
        count = "" if -1 in self.shape or self.may_lack else math.prod(self.shape)
        return f"{self.wire}[{count}] {self.name}"


def _vector(name: str, size: int, bound: float, low: float | None = None) -> MessageField:
    return MessageField(name, "float64", (size,), -bound if low is None else low, bound)


def _scalar(name: str, low: float, high: float) -> MessageField:
    return MessageField(name, "float64", None, low, high)


def _index(name: str, low: int = 0) -> MessageField:
    return MessageField(name, "int64", None, low, INDEX_MAX)


def _rows(name: str, bound: float) -> MessageField:
    return MessageField(name, "float64", (-1, JOINTS), -bound, bound)


def _former(field: MessageField) -> str:
    return (
        replace(field, shape=(FORMER_GRID.size,)).definition
        if field.shape == (ANY,)
        else field.definition
    )


ROUNDING = 1e-6
QUATERNION = 1.0 + ROUNDING
ANGULAR_VELOCITY = 500.0  # [rad/s]; the gyroscope ends at 35, a simulated impact does not
ACCELERATION = 1e5  # [m/s^2]
VELOCITY = 100.0  # [m/s]
POSITION = 1e4  # [m]
HEIGHT = 100.0  # [m]
ANGLE = 100.0  # [rad]; joints end at 4.5
JOINT_SPEED = 1e4  # [rad/s]; drives end at 30
TORQUE = 1e4  # [Nm]; drives end at 36, what a PD law asks for does not
GAIN = 1e4
FORCE = 1e6  # [N]
FREQUENCY = 20.0  # [Hz]; the original's gait lies between 1 and 4
PLAN_VELOCITY = 10.0  # [m/s], [rad/s]
OBSERVATION = 1e5  # a height, times the largest scale that a dialect may have
FOOT_RESIDUAL = (
    1.0  # [m]; onto a step of 0.75 m a foot is lifted by 0.8 m from its path on the ground
)

FIELDS: dict[type[Message], tuple[MessageField, ...]] = {
    messages.RobotState: (
        _index("step"),
        _vector("quaternion_base_in_world", 4, QUATERNION),
        _vector("angular_velocity_base", 3, ANGULAR_VELOCITY),
        _vector("acceleration_base", 3, ACCELERATION),
        _vector("joint_position", JOINTS, ANGLE),
        _vector("joint_velocity", JOINTS, JOINT_SPEED),
        _vector("joint_torque", JOINTS, TORQUE),
        _vector("velocity_base_in_world", 3, VELOCITY),
        _scalar("base_height", -HEIGHT, HEIGHT),
        MessageField("leg_contact", "bool", (LEGS,)),
        _vector("leg_progress", LEGS, 1.0 + ROUNDING, low=-ROUNDING),
        MessageField("leg_trusted", "bool", (LEGS,)),
        _index("cycle"),
        MessageField("mode", "uint8", enum=messages.ControllerMode),
        _index("depth_due", low=-1),
        MessageField(
            "position_base_in_odometry", "float64", (3,), -POSITION, POSITION, may_lack=True
        ),
        MessageField("standing_feet", "float64", (ANY, 3), -HEIGHT, HEIGHT),
    ),
    messages.Heightmap: (
        _index("step"),
        _vector("x", ANY, HEIGHT),
        _vector("y", ANY, HEIGHT),
        _vector("height", ANY, HEIGHT),
        _vector("half_width_90", ANY, HEIGHT, low=0.0),
        MessageField("status", "uint8", enum=messages.HeightmapStatus),
        _scalar("depth_age_s", -1.0, math.inf),
        _index("frame_id", low=-1),
        MessageField("model_id", "string"),
        _scalar("seen_share", -1.0, 1.0),
        MessageField("age_s", "float64", (ANY,), 0.0, may_lack=True),
        MessageField("dialect", "string"),
        MessageField("observation", "float64", (ANY,), -OBSERVATION, OBSERVATION, may_lack=True),
    ),
    messages.MotionPlan: (
        _index("step"),
        MessageField("status", "uint8", enum=messages.PlanStatus),
        _scalar("stepping_frequency_hz", 0.0, FREQUENCY),
        _scalar("velocity_x", -PLAN_VELOCITY, PLAN_VELOCITY),
        _scalar("velocity_z", -PLAN_VELOCITY, PLAN_VELOCITY),
        _scalar("pitch_rate", -PLAN_VELOCITY, PLAN_VELOCITY),
        _vector("foot_residual_front", 3, FOOT_RESIDUAL),
        _vector("foot_residual_rear", 3, FOOT_RESIDUAL),
        MessageField("reason", "string"),
        _scalar("yaw_rate", -PLAN_VELOCITY, PLAN_VELOCITY),
    ),
    messages.JointPlan: (
        _index("step"),
        MessageField("status", "uint8", enum=messages.PlanStatus),
        _vector("joint_position", JOINTS, ANGLE),
        _vector("kp", JOINTS, GAIN, low=0.0),
        _vector("kd", JOINTS, GAIN, low=0.0),
        MessageField("reason", "string"),
    ),
    messages.DriveCommand: (
        _index("step", low=-1),
        MessageField("mode", "uint8", enum=messages.CommandMode),
        _scalar("velocity_x", -PLAN_VELOCITY, PLAN_VELOCITY),
        _scalar("velocity_y", -PLAN_VELOCITY, PLAN_VELOCITY),
        _scalar("yaw_rate", -PLAN_VELOCITY, PLAN_VELOCITY),
    ),
    messages.JointLog: (
        _index("step"),
        _scalar("dt_s", 1e-5, 1.0),
        _rows("position", ANGLE),
        _rows("velocity", JOINT_SPEED),
        _rows("position_desired", ANGLE),
        _rows("velocity_desired", JOINT_SPEED),
        _rows("torque_feedforward", TORQUE),
        _rows("torque_estimated", TORQUE),
        _rows("kp", GAIN),
        _rows("kd", GAIN),
    ),
    messages.GroundTruth: (
        _index("step"),
        _vector("position_base_in_world", 3, POSITION),
        _vector("quaternion_base_in_world", 4, QUATERNION),
        _vector("velocity_base_in_world", 3, VELOCITY),
        _vector("angular_velocity_base", 3, ANGULAR_VELOCITY),
        _vector("joint_position", JOINTS, ANGLE),
        _vector("foot_force", LEGS, FORCE),
        _vector("x", ANY, HEIGHT),
        _vector("y", ANY, HEIGHT),
        _vector("height", ANY, POSITION),
    ),
    messages.Done: (_index("step"), MessageField("process", "string"), _index("frame_id", low=-1)),
}
"""Messages that travel as types of our own: a `std_msgs/Header` with the capture time, then these
fields."""

FRAME: dict[type[Message], str] = {
    messages.DepthFrame: "camera",
    messages.RobotState: "base",
    messages.Heightmap: "base_yaw",
    messages.MotionPlan: "base_yaw",
    messages.JointPlan: "base",
    messages.DriveCommand: "base_yaw",
    messages.JointLog: "base",
    messages.GroundTruth: "world",
    messages.Done: "",
    messages.ProcessStatus: "",
}
"""Frame in each message's header."""

TYPE_NAME: dict[type[Message], str] = {
    messages.DepthFrame: DEPTH_TYPE,
    messages.Event: EVENT_TYPE,
    messages.ProcessStatus: STATUS_TYPE,
    **{kind: f"saltus_msgs/msg/{kind.__name__}" for kind in FIELDS},
}
"""ROS 2 type of each message."""

STANDARD: dict[str, str] = {
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "sensor_msgs/msg/RegionOfInterest": (
        "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n"
    ),
    "sensor_msgs/msg/Image": (
        "std_msgs/Header header\n"
        "uint32 height\n"
        "uint32 width\n"
        "string encoding\n"
        "uint8 is_bigendian\n"
        "uint32 step\n"
        "uint8[] data\n"
    ),
    "sensor_msgs/msg/CameraInfo": (
        "std_msgs/Header header\n"
        "uint32 height\n"
        "uint32 width\n"
        "string distortion_model\n"
        "float64[] d\n"
        "float64[9] k\n"
        "float64[9] r\n"
        "float64[12] p\n"
        "uint32 binning_x\n"
        "uint32 binning_y\n"
        "sensor_msgs/RegionOfInterest roi\n"
    ),
    EVENT_TYPE: (
        "uint8 DEBUG=10\n"
        "uint8 INFO=20\n"
        "uint8 WARN=30\n"
        "uint8 ERROR=40\n"
        "uint8 FATAL=50\n"
        "builtin_interfaces/Time stamp\n"
        "uint8 level\n"
        "string name\n"
        "string msg\n"
        "string file\n"
        "string function\n"
        "uint32 line\n"
    ),
}
"""Definitions of ROS 2 (Jazzy) that travel.

With all types of that distribution every process starts 0.1 s later.
"""

DEFINITIONS: dict[str, str] = {
    DEPTH_TYPE: (
        "std_msgs/Header header\n"
        "sensor_msgs/Image image\n"
        "sensor_msgs/CameraInfo camera_info\n"
        "float64 depth_unit_m\n"
        "int64 frame_id\n"
    ),
    STATUS_TYPE: (
        "std_msgs/Header header\n"
        "string process\n"
        "bool ready\n"
        "int64 ticks\n"
        "int64 overruns\n"
        "string[] rejected\n"
        "int64[] rejected_count\n"
        "string[] received\n"
        "int64[] received_count\n"
        "int64[] silence_us\n"
    ),
    **{
        TYPE_NAME[kind]: "\n".join(["std_msgs/Header header", *(f.definition for f in fields)])
        + "\n"
        for kind, fields in FIELDS.items()
    },
}
"""ROS 2 message definitions of the types that are our own."""

_ON_A_LINE: dict[type[Message], tuple[str, ...]] = {
    messages.Heightmap: ("y",),
    messages.GroundTruth: ("x", "y"),
}
_OF_THE_LINE: dict[type[Message], tuple[str, ...]] = {
    messages.Heightmap: ("seen_share", "age_s", "dialect", "observation"),
    messages.RobotState: ("position_base_in_odometry", "standing_feet"),
    messages.MotionPlan: ("yaw_rate",),
}
FORMER_GRID = load_grid(UNNAMED["grid"])


def _without(kind: type[Message], added: tuple[str, ...], *, line: bool) -> str:
    kept = (f for f in FIELDS[kind] if f.name not in added)
    return (
        "\n".join(["std_msgs/Header header", *(_former(f) if line else f.definition for f in kept)])
        + "\n"
    )


FORMER: dict[type[Message], tuple[str, ...]] = {
    kind: (
        *([_without(kind, _OF_THE_LINE[kind], line=False)] if kind in _OF_THE_LINE else []),
        *(
            [_without(kind, _OF_THE_LINE.get(kind, ()) + _ON_A_LINE[kind], line=True)]
            if kind in _ON_A_LINE
            else []
        ),
    )
    for kind in dict.fromkeys([*_OF_THE_LINE, *_ON_A_LINE])
}
"""Definitions in older recordings, the newest first: of before there were scans and jumps that
turn, and of before messages carried their grid, when all heights stood on `FORMER_GRID`."""
