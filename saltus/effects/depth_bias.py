"""Depth is off by a constant."""

from dataclasses import dataclass, replace

from saltus.arrays import namespace
from saltus.effects.effect import Effect, PerRobot, parameter, per_image
from saltus.effects.signals import DepthImage


@dataclass(frozen=True, kw_only=True)
class DepthBias(Effect[DepthImage], name="depth_bias", site="depth"):
    """Every valid depth is `bias` larger than the true one; images in metres."""

    # 5 to 20 mm on a D435 (a published study of its distances)
    bias: PerRobot = parameter(unit="m", null=0.0, low=-0.3, high=0.3, sought=(-0.1, 0.1))

    def apply(self, signal: DepthImage, time_s: float, state: None) -> tuple[DepthImage, None]:
        """Adds to what is valid; what would come out at the lens or behind it becomes invalid."""
        del time_s, state
        xp = namespace(signal.depth)
        moved = signal.depth + per_image(self.bias, signal.depth, xp)
        valid = (signal.depth > 0.0) & (moved > 0.0)
        return replace(signal, depth=xp.where(valid, moved, xp.zeros_like(signal.depth))), None
