"""Messages of a camera and of a state as ROS has them."""

from typing import Any

from recorded import run_messages

from saltus.config import RunConfig
from saltus.ros2.wall_clock import WallClock
from saltus.wire.depth_codec import depth_on_the_wire

LOCKSTEP = WallClock(RunConfig(robot="go1", grid="line", pace="lockstep"))
"""Times of ROS are those of the run."""


def frame_messages(step: int = 2) -> tuple[Any, Any, Any]:
    frame: Any = dict(run_messages(step))["camera/depth"]
    wire = depth_on_the_wire(frame)
    return frame, wire.image, wire.camera_info
