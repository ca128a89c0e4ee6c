"""Velocity commands of ROS, made an operator's:
what `teleop_twist_keyboard` or Nav2 send as `cmd_vel`.
"""

import math
from collections import Counter

from saltus.clock import RunClock
from saltus.errors import MessageError
from saltus.recordings import ros_messages as ros
from saltus.wire.bus import Bus, Slot
from saltus.wire.messages import CommandMode, DriveCommand
from saltus.wire.ros2_node import RosNode
from saltus.wire.schemas import PLAN_VELOCITY

TWIST = "geometry_msgs/msg/Twist"


class CommandReceiver:
    """Puts the newest velocity of a topic on the bus, dated when it is taken: a Twist has no stamp.

    Args:
        bus: Of the run.
        node: In the ROS graph.
        topic: Name in ROS, of `geometry_msgs/msg/Twist`.
        clock: Of the run, in real time.
    """

    def __init__(self, bus: Bus, node: RosNode, topic: str, clock: RunClock) -> None:
        self.rejected: Counter[str] = Counter()
        """Messages that were of no use, by reason."""
        self._clock, self._slot = clock, Slot(bus.bell)
        self._commands = bus.publisher("operator/command")
        node.subscribe(topic, TWIST, ros.hash_of(TWIST), self._slot)

    def step(self) -> None:
        """Hands on the newest of what has come, where it is a velocity."""
        velocity = None
        while (raw := self._slot.pop()) is not None:
            try:
                velocity = _velocity(raw.payload)
            except MessageError as error:
                self.rejected[error.reason] += 1
        if velocity is not None:
            self._commands.put(
                DriveCommand(
                    time_ns=self._clock.now_ns(),
                    step=-1,
                    mode=CommandMode.WALK,
                    velocity_x=velocity[0],
                    velocity_y=velocity[1],
                    yaw_rate=velocity[2],
                )
            )


def _velocity(payload: bytes) -> list[float]:
    """Ahead, to the left, turning, each cut off at what a command may say."""
    twist = ros.decode_ros_message(TWIST, payload)
    asked = (twist.linear.x, twist.linear.y, twist.angular.z)
    if not all(math.isfinite(value) for value in asked):
        raise MessageError("not_finite", f"{asked}")
    return [min(max(value, -PLAN_VELOCITY), PLAN_VELOCITY) for value in asked]
