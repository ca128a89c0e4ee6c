"""Depth is off by a factor."""

from dataclasses import dataclass, replace

from saltus.arrays import namespace
from saltus.effects.effect import Effect, PerRobot, parameter, per_image
from saltus.effects.signals import DepthImage


@dataclass(frozen=True, kw_only=True)
class DepthScale(Effect[DepthImage], name="depth_scale", site="depth"):
    """Every depth is `scale` times the true one: baseline or focal length of the sensor off."""

    # 0.5 to 1 % at 0.5 to 1.5 m on a D435 (a published study of its distances)
    scale: PerRobot = parameter(unit="", null=1.0, low=0.5, high=2.0, sought=(0.8, 1.25))

    def apply(self, signal: DepthImage, time_s: float, state: None) -> tuple[DepthImage, None]:
        """Scales what is valid; 0 stays 0."""
        del time_s, state
        return replace(signal, depth=signal.depth * per_image(self.scale, signal.depth, namespace(signal.depth))), None
