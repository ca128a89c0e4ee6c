"""Messages that the processes send each other:
frozen dataclasses, SI units, one meaning for each field.

Frames. *world*: z up, x along the course, yaw as the IMU reports it. *base*: at the trunk's
geometric centre, x forward, y left, z up. *yaw frame*: world axes rotated by the yaw of the base,
origin at the base. Legs are in the order FR, FL, RR, RL; joints in the order hip, thigh, calf of
each leg. Quaternions are (w, x, y, z), base to world. A message's time (`header.stamp`, and the
same to the nanosecond in the attachment; `time_ns` in Python) is its capture time: the moment at
which the thing was true, not the moment at which it was sent. It is in the clock of the run. With
`saltus router` that is CLOCK_MONOTONIC of the router's computer; with `saltus up` what has passed
of it since `epoch_ns` of run.toml, times `speed`. States that are dated more than 5 ms ahead or 100
ms behind are not answered.
"""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Reals

OPERATOR = "operator"
"""Name of the operator, whose events under `event/operator` ask something of a run."""
SUPERVISOR = "supervisor"
"""Name of the process that starts and watches those of a run; its events are under
`event/supervisor`."""


class HeightmapStatus(IntEnum):
    """How far a heightmap may be trusted."""

    OK = 0
    """It may be trusted."""
    WARMING = 1
    """Fewer images since the hidden state was emptied than the model needs."""
    DEGRADED = 2
    """The image is 50 ms older than nominal, too many pixels or images are missing, or the output
    is frozen."""
    INVALID = 3
    """The image is 100 ms older than nominal (for a scan: was when it came), or the output is not
    plausible."""


class PlanStatus(IntEnum):
    """Task that the planner gives the controller."""

    STAND = 0
    """Stay on all four feet."""
    GO = 1
    """Follow the plan."""
    STOP = 2
    """Land, then stand: the planner cannot see."""
    LIE = 3
    """Lie down; a robot that moves lands and stands before."""


class CommandMode(IntEnum):
    """Way in which a robot is asked to move."""

    STAND = 0
    """Come to a stand and stay on all four feet."""
    WALK = 1
    """Follow the velocities by walking; a planner that only jumps stands."""
    JUMP = 2
    """Go ahead by jumps, at the planner's own speed; a planner that only walks stands."""
    LIE_DOWN = 3
    """Come to a stand, then fold the legs until the trunk is just above the ground."""


class ControllerMode(IntEnum):
    """State of the leg controller."""

    STAND = 0
    """On all four feet, before it runs or after its run."""
    RUN = 1
    """Follows the plans."""
    COAST = 2
    """The newest plan is 30 to 100 ms old: bounds on by a plan of its own that brakes."""
    LANDING = 3
    """Brakes in the same way until it is slow, then brings all feet down."""
    STOPPED = 4
    """Stands after a fault; needs a new run to jump again."""
    DAMP = 5
    """Joint damping only: not upright, or a state that is not finite."""
    WALK = 7
    """Joints follow the targets of a policy; where they are late it coasts, as it does from RUN."""
    LIE = 6
    """Legs folded, the trunk just above the ground; it stands up when it is to stand or to go."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthFrame:
    """One depth image with what is needed to interpret it."""

    time_ns: int
    frame_id: int
    depth: NDArray[np.uint16]
    """Depth along the optical axis, shape (height, width), in units of `depth_unit_m`; 0 is
    invalid, 65535 is "nothing within range"."""
    depth_unit_m: float
    fx: float
    fy: float
    cx: float
    cy: float
    """Intrinsics [px]: pixel (u, v) looks through ((u + 0.5 - cx) / fx, (v + 0.5 - cy) / fy)."""


def _nothing() -> Floats:
    return np.zeros(0)


def _no_feet() -> Floats:
    return np.zeros((0, 3))


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotState:
    """Measurements and estimates of a robot about itself at one instant."""

    time_ns: int
    step: int
    """Policy step (100 Hz) since the start of the run."""
    quaternion_base_in_world: Floats
    """Shape (4,), from the IMU."""
    angular_velocity_base: Floats
    """Gyroscope, base frame [rad/s], shape (3,)."""
    acceleration_base: Floats
    """Accelerometer (specific force), base frame [m/s^2], shape (3,)."""
    joint_position: Floats
    """[rad], shape (12,)."""
    joint_velocity: Floats
    """[rad/s], shape (12,)."""
    joint_torque: Floats
    """Torque that the drives believe they apply [Nm], shape (12,)."""
    velocity_base_in_world: Floats
    """Estimate [m/s], shape (3,)."""
    base_height: float
    """Estimated height of the base above the feet in stance [m]."""
    leg_contact: NDArray[np.bool_]
    """Scheduled contact, shape (4,)."""
    leg_progress: Floats
    """Progress in the present stance or swing, [0, 1], shape (4,)."""
    leg_trusted: NDArray[np.bool_]
    """Leg is in the middle half of its stance: its foot may be taken to be on the ground.

    Shape (4,).
    """
    cycle: int
    """Number of completed gait cycles."""
    mode: ControllerMode
    depth_due: int
    """Lockstep: the newest `DepthFrame.frame_id` that is due at this step; -1 where none is, or in
    real time."""
    position_base_in_odometry: Floats = field(default_factory=_nothing)
    """Position by the robot's odometry, along the world's axes from any origin [m], shape (3,);
    (0,) where it has none, and velocities are added up."""
    standing_feet: Floats = field(default_factory=_no_feet)
    """Points of the ground under feet that surely stand, base frame [m], shape (n, 3): of robots
    whose legs are not those of a known model. The others have `leg_trusted`."""


def _on_the_axis() -> Floats:
    return np.zeros(1)


def points_of(heights: "Heightmap | GroundTruth") -> Floats:
    """Place of each point of a message with heights,
    x and y in the yaw frame of the base [m], shape (points, 2).
    """
    return np.stack(np.meshgrid(heights.x, heights.y, indexing="ij"), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class Heightmap:
    """The terrain on a grid (`saltus.grid.HeightGrid`) at the time
    of the robot state with the same step.

    Points stand row after row, each from its first y on; points = rows times columns.
    """

    time_ns: int
    step: int
    x: Floats
    """Rows: distance ahead of the base along its yaw, ascending [m], shape (rows,)."""
    y: Floats = field(default_factory=_on_the_axis)
    """Columns: distance to the left of that axis, ascending [m], shape (columns,)."""
    height: Reals
    """Terrain height relative to the base [m], shape (points,)."""
    half_width_90: Reals
    """Half of the 90 % interval of `height` [m]: 90 % of the errors are smaller, shape
    (points,)."""
    status: HeightmapStatus
    depth_age_s: float
    """Age of the image that was used; infinite where there is none yet."""
    frame_id: int
    """The image that was used; -1 where there is none yet."""
    model_id: str
    """First 16 hexadecimal digits of the model file's sha256."""
    seen_share: float = -1.0
    """Share of the points that any image has shown since the service began, 0 to 1; -1 where nobody
    counts."""
    age_s: Reals = field(default_factory=_nothing)
    """Time since a point was last in an image [s], infinite where it never was, shape (points,);
    (0,) where nobody counts."""
    dialect: str = ""
    """Name of the dialect of `observation` (`saltus.dialects`); empty where there is none."""
    observation: Reals = field(default_factory=_nothing)
    """The heights as a policy reads them: in its dialect's order, with its offset, clip and scale,
    shape (points,); (0,) without a dialect."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionPlan:
    """The centroidal reference that the leg controller tracks."""

    time_ns: int
    step: int
    status: PlanStatus
    stepping_frequency_hz: float
    velocity_x: float
    """Forward velocity of the base, yaw frame [m/s]."""
    velocity_z: float
    """Vertical velocity of the base [m/s]."""
    pitch_rate: float
    """Rotation about the y axis of the yaw frame, nose down positive [rad/s]."""
    foot_residual_front: Floats
    """Added to the nominal swing position of the front feet, yaw frame [m], shape (3,); y is
    outward."""
    foot_residual_rear: Floats
    """The same for the rear feet."""
    reason: str
    """Why the status is not GO; empty otherwise."""
    yaw_rate: float = 0.0
    """Turning to the left of the heading that the robot holds [rad/s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointPlan:
    """A plan of joint targets, in place of a `MotionPlan`:
    what a walking policy asks of the drives.
    """

    time_ns: int
    step: int
    status: PlanStatus
    joint_position: Floats
    """Targets [rad], shape (12,); followed where the status is GO."""
    kp: Floats
    """Stiffness with which the drives hold them [Nm/rad], shape (12,)."""
    kd: Floats
    """Damping [Nm s/rad], shape (12,)."""
    reason: str
    """Why the status is not GO; empty otherwise."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveCommand:
    """An operator's wish: how the robot is to move from now on, until the next command.

    A command that is older than 0.5 s asks to stand.
    """

    time_ns: int
    step: int
    """The robot state that it answers; -1 where it answers none."""
    mode: CommandMode
    velocity_x: float
    """Ahead, in the yaw frame [m/s]; read in WALK alone."""
    velocity_y: float
    """To the left [m/s]; read in WALK alone."""
    yaw_rate: float
    """Turning to the left [rad/s]; read in WALK and JUMP."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointLog:
    """The 500 Hz rows between two policy steps:
    state measured at a time and the command that takes force then.
    """

    time_ns: int
    """Time of the first row: that of the header."""
    step: int
    dt_s: float
    position: Floats
    """[rad], shape (rows, 12), as all that follow."""
    velocity: Floats
    position_desired: Floats
    velocity_desired: Floats
    torque_feedforward: Floats
    torque_estimated: Floats
    kp: Floats
    kd: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundTruth:
    """Quantities that only a simulator knows, for camera, labels and reports.

    Never perception or control.
    """

    time_ns: int
    step: int
    position_base_in_world: Floats
    quaternion_base_in_world: Floats
    velocity_base_in_world: Floats
    angular_velocity_base: Floats
    joint_position: Floats
    foot_force: Floats
    """Vertical ground reaction [N], shape (4,)."""
    x: Floats
    """Rows of the grid of `height` [m], as those of a `Heightmap`, shape (rows,)."""
    y: Floats = field(default_factory=_on_the_axis)
    """Columns of that grid [m], shape (columns,)."""
    height: Floats
    """True terrain height relative to the base [m], shape (points,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Done:
    """Lockstep: `process` has finished `step`."""

    time_ns: int
    step: int
    process: str
    frame_id: int = -1
    """From the camera: the newest frame that is due."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Event:
    """Something that a person should know, once, when it begins."""

    time_ns: int
    process: str
    code: str
    """Machine-readable, see the table of codes."""
    detail: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class ProcessStatus:
    """How a process is doing; sent twice a second as proof of life."""

    time_ns: int
    process: str
    ready: bool
    ticks: int
    overruns: int
    rejected: dict[str, int] = field(default_factory=dict)
    """Count of rejected messages by "topic/reason"."""
    received: dict[str, int] = field(default_factory=dict)
    """Messages that came since the last status, by topic."""
    silence_us: dict[str, int] = field(default_factory=dict)
    """The longest time that passed without one since then, by topic [microseconds, run's clock]."""


Message = (
    DepthFrame
    | RobotState
    | Heightmap
    | MotionPlan
    | JointPlan
    | DriveCommand
    | JointLog
    | GroundTruth
    | Done
    | Event
    | ProcessStatus
)

AnyPlan = MotionPlan | JointPlan
"""An answer of the planner, of either kind."""
