"""The short TOML that says what a bag or a table
of others does not say of itself (docs/tutorials/log.md).
"""

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from saltus.flags import flag_help
from saltus.recordings.log_units import LogUnits

TopicName = Annotated[str | None, flag_help("TOPIC", "the only one of its type")]


@dataclass(frozen=True, kw_only=True)
class BagTopics:
    """Topics of a bag. One that is not named is found by its type, if there is just one."""

    joints: TopicName = None
    """sensor_msgs/JointState: what was measured."""
    commands: TopicName = None
    """sensor_msgs/JointState: what the drives were told.

    Position, velocity, effort are q_des, dq_des, tau_ff.
    """
    imu: TopicName = None
    """sensor_msgs/Imu: with orientation; acceleration with gravity."""
    base: TopicName = None
    """nav_msgs/Odometry: measured pose of the trunk, its velocity in the trunk's own frame."""
    depth: TopicName = None
    """sensor_msgs/Image: 16 bit in millimetres, or 32 bit in metres, unless [units] depth_unit_m
    says otherwise."""
    camera_info: TopicName = None
    """sensor_msgs/CameraInfo: of the depth images."""


@dataclass(frozen=True, kw_only=True)
class TableColumns:
    """Which columns of somebody else's table hold which signals.

    In that of a signal, {joint} stands for a joint's name, {number} for its place, from 0.

    In an npz, a name without them is that of an array of all joints, shape (rows, joints), and
    {log} stands for what tells several logs in one archive apart.
    """

    q: str
    """Measured angles; "jpos{number}" for example."""
    q_des: str | None = None
    dq: str | None = None
    dq_des: str | None = None
    tau_ff: str | None = None
    tau_est: str | None = None
    kp: str | None = None
    """Gains that come with each command; without them, those in the claims hold throughout."""
    kd: str | None = None
    joints: tuple[str, ...] = ()
    """The table's names of its joints, in the order of their numbers. Without them it has all of
    the robot's, in the robot's order, by their names in [joint_names]."""
    angle: Literal["rad", "deg"] = "rad"
    """Unit of angles and rates, where [units] names none."""
    time: str | None = None
    """Column of times; without it rows are evenly spaced, at `rate_hz`."""
    time_unit: Literal["s", "ms", "us", "ns"] = "s"
    rate_hz: float | None = None
    states_every_s: float | None = None
    """Each row holds the newest state of a robot that measures so often: states are put on even
    times. `dq` serves for this and is not in the log."""
    moves_freely: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Range of joints whose names on the robot end so [rad]: beyond it they lean on a stop. Each
    leg of a held robot then has a log of its own, without what a stop disturbs."""


@dataclass(frozen=True, kw_only=True)
class RecordingDescription:
    """A description of somebody else's recording, with what it does not say of itself."""

    claims: dict[str, Any] = field(default_factory=dict)
    """Claims for meta.json of the run log: base, kp, kd, terrain and so on."""
    topics: BagTopics = field(default_factory=BagTopics)
    """Topics of a bag."""
    leave_out: tuple[str, ...] = ()
    """Signals that stay out of the log although the recording has them: dq, q_des, dq_des, tau_ff,
    tau_est, kp, kd, imu, base, depth."""
    joint_names: dict[str, str] = field(default_factory=dict)
    """The recording's name of a joint, and that of the robot.

    Empty for what is no joint of the robot's legs.
    """
    columns: TableColumns | None = None
    """Columns of a table."""
    units: LogUnits = field(default_factory=LogUnits)
    """Units of the signals that are not in SI units."""
