"""A camera looks further down or up than it is said to."""

from dataclasses import dataclass
from typing import ClassVar

from saltus.effects.effect import Effect, PerRobot, Site, added, parameter
from saltus.effects.signals import CameraView


@dataclass(frozen=True, kw_only=True)
class CameraPitch(Effect[CameraView]):
    """The camera is turned by `offset` about the trunk's left axis, nose down positive."""

    name: ClassVar[str] = "camera_pitch"
    site: ClassVar[Site] = "view"

    # 0.5 to 3 degrees on real robots
    offset: PerRobot = parameter(unit="rad", null=0.0, low=-0.5, high=0.5)

    def apply(self, signal: CameraView, time_s: float, state: None) -> tuple[CameraView, None]:
        """Turns the camera."""
        del time_s, state
        return added(signal, "pitch", self.offset), None
