"""At an edge a matcher may find something between near and far."""

from dataclasses import dataclass, field, replace

from saltus.arrays import Array, namespace
from saltus.effects.effect import PerRobot, parameter, per_image
from saltus.effects.fields import unit_uniform
from saltus.render.stereo.discontinuity import discontinuity
from saltus.render.stereo.image import StereoImage
from saltus.render.stereo.random_effect import RandomStereoEffect


@dataclass(frozen=True, kw_only=True)
class FlyingPixels(RandomStereoEffect, name="flying_pixels"):
    """A share `fraction` of the pixels next to a depth edge
    has a disparity anywhere between both sides.
    """

    # not published; one in five makes the thin veil at edges that recordings show
    fraction: PerRobot = parameter(unit="", null=0.0, low=0.0, high=1.0)
    # as for holes at edges
    jump: float = field(
        default=1.0, metadata={"unit": "px", "low": 0.05, "high": 50.0, "per_joint": False}
    )

    def drawn(self, signal: StereoImage, keys: Array) -> StereoImage:
        """Moves pixels into the gap."""
        disparity, optics = signal.disparity, signal.optics
        # one sample in `pitch` lies within a pixel of the edge
        scale = 1.0 / max(optics.pitch_x, optics.pitch_y)
        share = per_image(self.fraction, disparity, namespace(disparity)) * scale
        draw = unit_uniform(keys, signal.time_s, disparity.shape[-2:], disparity.dtype)
        flies = discontinuity(signal.truth, self.jump) & (draw < share)
        low, high = signal.windows.range_around(disparity)
        # among those that fly, draw / share is uniform again; where the share is 0 none do
        between = low + (high - low) * (draw / (share + (share == 0.0)))
        return replace(signal, disparity=namespace(disparity).where(flies, between, disparity))
