"""A camera's field of view is wider or narrower than its intrinsics say."""

from dataclasses import dataclass
from typing import ClassVar

from saltus.effects.effect import Effect, PerRobot, Site, parameter, scaled
from saltus.effects.signals import CameraView


@dataclass(frozen=True, kw_only=True)
class CameraFov(Effect[CameraView]):
    """The tangent of each pixel's true angle to the optical axis is `scale` times the claimed one."""

    name: ClassVar[str] = "camera_fov"
    site: ClassVar[Site] = "view"

    # 1 to 3 % on real robots; mistakes in cropping and resizing are the usual cause
    scale: PerRobot = parameter(unit="", null=1.0, low=0.5, high=2.0)

    def apply(self, signal: CameraView, time_s: float, state: None) -> tuple[CameraView, None]:
        """Widens the view."""
        del time_s, state
        return scaled(signal, "tangent_scale", self.scale), None
