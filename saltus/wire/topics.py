"""THE table of topics: key, type, publisher, readers, rate, and the age that is allowed."""

from dataclasses import dataclass, replace
from enum import Enum

from saltus.wire import messages
from saltus.wire.messages import Message

CAMERA_LATENCY_S = (
    0.050  # exposure to arrival; paper, "real-to-sim" (a sine of body height against the image)
)
CAMERA_JITTER_S = (
    0.005  # of a trial's images, either way: half a policy period, they arrive at any phase of it
)
CAMERA_PERIOD_S = 0.020  # 50 Hz
# A policy that tolerates 8 cm of horizontal shift at 1.4 m/s tolerates 57 ms beyond the delay it
# was trained with: 50 ms more is degraded, 100 ms more (ten periods of the consumer) is lost.
MAX_EXTRA_AGE_S = 0.100
COMMAND_AGE_S = 0.5  # a command holds so long; the time-out of ros2_control's diff_drive_controller


@dataclass(frozen=True)
class Topic:
    """One row of the table."""

    name: str
    """Key expression below the robot's prefix, e.g. "camera/depth" of "robot/0/camera/depth"."""
    message: type[Message]
    publisher: str
    """The process that may publish it; "*" where every process does, each under
    `name/<process>`."""
    readers: tuple[str, ...] = ()
    """The processes that subscribe to it; others show it, and each is recorded."""
    rate_hz: float = 100.0
    """0 of what has no rate of its own."""
    nominal_age_s: float = 0.0
    """Age (now - capture time) of a message that is on time, when it is used; of images see
    `depth_topic`."""
    max_extra_age_s: float = MAX_EXTRA_AGE_S
    """Beyond nominal + this a message must not be used. Half of it is the limit of "degraded"."""
    jitter_s: float = 0.0
    """So much sooner or later a message may come in a trial, however fast the computer."""
    urgent: bool = False
    """It overtakes the others, and does not get lost with them where a link is full."""
    named: bool = False
    """The publisher may also send under `name/<name>`: images of further cameras."""
    beside: bool = False
    """Some runs alone have it: `saltus up --grid scan`."""

    @property
    def degraded_age_s(self) -> float:
        """Beyond this age [s] a message is late."""
        return self.nominal_age_s + 0.5 * self.max_extra_age_s

    @property
    def invalid_age_s(self) -> float:
        """Beyond this age [s] a message must not be used."""
        return self.nominal_age_s + self.max_extra_age_s


_ROWS = (
    Topic(
        "camera/depth",
        messages.DepthFrame,
        "render",
        ("heightmap", "scan"),
        50.0,
        nominal_age_s=CAMERA_LATENCY_S + CAMERA_PERIOD_S,
        jitter_s=CAMERA_JITTER_S,
        named=True,
    ),
    Topic("controller/state", messages.RobotState, "controller", ("heightmap", "scan", "policy")),
    Topic("heightmap/heightmap", messages.Heightmap, "heightmap", ("policy",)),
    Topic("scan/heightmap", messages.Heightmap, "scan", beside=True),
    Topic("policy/plan", messages.MotionPlan, "policy", ("controller",)),
    Topic("policy/joints", messages.JointPlan, "policy", ("controller",)),
    Topic(
        "operator/command",
        messages.DriveCommand,
        "operator",
        ("policy",),
        0.0,
        max_extra_age_s=COMMAND_AGE_S,
    ),
    Topic("controller/joints", messages.JointLog, "controller", nominal_age_s=0.010),
    Topic("plant/truth", messages.GroundTruth, "controller", ("render", "heightmap")),
    Topic("done", messages.Done, "*", ("controller",), 0.0, max_extra_age_s=1.0),
    Topic(
        "event",
        messages.Event,
        "*",
        ("render", "controller"),
        0.0,
        max_extra_age_s=1.0,
        urgent=True,
    ),
    Topic("status", messages.ProcessStatus, "*", (), 2.0, max_extra_age_s=1.0),
)
TOPICS: dict[str, Topic] = {topic.name: topic for topic in _ROWS}

SHARED = "@shared"
"""Below the prefix: here a supervisor hands all messages on to onlookers (`saltus.wire.sharing`).
Zenoh matches a part of a key that begins with @ by itself alone: who subscribes to everything does
not get it."""


def depth_topic(latency_s: float) -> Topic:
    """The depth topic of a camera whose images arrive so long after exposure [s]:
    then they are on time.

    Images of a faster camera than the one that predictors know may be as old as that one's.
    """
    return replace(
        TOPICS["camera/depth"], nominal_age_s=max(latency_s, CAMERA_LATENCY_S) + CAMERA_PERIOD_S
    )


FUTURE_TOLERANCE_NS = 5_000_000
"""Clocks of one machine agree; 5 ms is a rounding, more is another clock."""


class Staleness(Enum):
    """Judgement of a message's age, by the limits of its topic."""

    OK = "ok"
    DEGRADED = "degraded"
    INVALID = "invalid"
    FUTURE = "future"
    """Captured later than now: a wrong clock, as unusable as INVALID."""

    @property
    def usable(self) -> bool:
        """True where a consumer may act on the message at all."""
        return self in (Staleness.OK, Staleness.DEGRADED)


def staleness_of(topic: Topic, capture_ns: int, now_ns: int) -> Staleness:
    """Judges a message by its age, both times in the run's clock."""
    age_ns = now_ns - capture_ns
    if age_ns < -FUTURE_TOLERANCE_NS:
        return Staleness.FUTURE
    if age_ns > 1e9 * topic.invalid_age_s:
        return Staleness.INVALID
    if age_ns > 1e9 * topic.degraded_age_s:
        return Staleness.DEGRADED
    return Staleness.OK
