"""The signals that effects change, one frozen dataclass a site; the signal of "command" is `messages.JointCommand`."""

from dataclasses import dataclass

from saltus.messages import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """Torque inside a drive, with the motion of its joint. Site "torque"."""

    torque: Floats
    """[Nm], shape (..., 12)."""
    position: Floats
    """[rad], shape (..., 12)."""
    velocity: Floats
    """[rad/s], shape (..., 12)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthImage:
    """The newest depth image that there is at some point between exposure and arrival. Site "depth"."""

    depth: Floats
    """Shape (..., height, width), any unit; 0 is invalid."""
    time_s: Floats
    """Capture time in the run's clock [s], float64, shape (...); -inf where there is no image yet."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightQuery:
    """Where a heightmap is read, and what is added to what is read. Site "heightmap"."""

    x: Floats
    """Distance ahead of the base along its yaw [m], shape (..., 30)."""
    offset: Floats
    """Added to every height [m], shape (..., 1)."""
