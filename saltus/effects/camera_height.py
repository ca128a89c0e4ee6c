"""A camera sits higher or lower than it is said to."""

from dataclasses import dataclass, replace
from typing import ClassVar

from saltus.arrays import namespace
from saltus.effects.effect import Effect, PerRobot, Site, like, parameter
from saltus.effects.signals import CameraView


@dataclass(frozen=True, kw_only=True)
class CameraHeight(Effect[CameraView]):
    """The optical centre is `offset` higher in the trunk's frame."""

    name: ClassVar[str] = "camera_height"
    site: ClassVar[Site] = "view"

    # 5 to 20 mm on real robots
    offset: PerRobot = parameter(unit="m", null=0.0, low=-0.3, high=0.3)

    def apply(self, signal: CameraView, time_s: float, state: None) -> tuple[CameraView, None]:
        """Lifts the camera."""
        del time_s, state
        xp, position = namespace(signal.position), signal.position
        height = position[..., 2] + like(self.offset, position, xp)
        return replace(signal, position=xp.stack([position[..., 0], position[..., 1], height], axis=-1)), None
