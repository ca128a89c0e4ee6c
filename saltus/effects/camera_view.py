"""Effects on where a camera looks: its pitch, height and field of view."""

from dataclasses import dataclass

from saltus.effects.effect import Effect, PerRobot, parameter
from saltus.effects.signals import CameraView


@dataclass(frozen=True, kw_only=True)
class CameraPitch(Effect[CameraView], name="camera_pitch", site="view"):
    """The camera is turned by `offset` about the trunk's left axis, nose down positive."""

    # 0.5 to 3 degrees on real robots
    offset: PerRobot = parameter(
        unit="rad", null=0.0, low=-0.5, high=0.5, sought=(-0.2, 0.2), adds_to="pitch"
    )


@dataclass(frozen=True, kw_only=True)
class CameraHeight(Effect[CameraView], name="camera_height", site="view"):
    """The optical centre is `offset` higher in the trunk's frame."""

    # 5 to 20 mm on real robots
    offset: PerRobot = parameter(
        unit="m", null=0.0, low=-0.3, high=0.3, sought=(-0.1, 0.1), adds_to=("position", 2)
    )


@dataclass(frozen=True, kw_only=True)
class CameraFov(Effect[CameraView], name="camera_fov", site="view"):
    """The tangent of each pixel's true angle
    to the optical axis is `scale` times the claimed one.
    """

    # 1 to 3 % on real robots; mistakes in cropping and resizing are the usual cause
    scale: PerRobot = parameter(
        unit="", null=1.0, low=0.5, high=2.0, sought=(0.8, 1.25), scales="tangent_scale"
    )
