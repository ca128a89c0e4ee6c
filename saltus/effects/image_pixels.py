"""Effects that count in pixels of an image: a log's camera
may have other pixels than the robot's own.

A profile speaks of the robot's camera, a D435i of 424 x 240 pixels (original); a log of its own
images.
"""

from dataclasses import replace

from saltus.depth import D435I
from saltus.effects.depth_errors import DepthNoise, EdgeHoles, HoleFill
from saltus.effects.effect import Effect, PerRobot
from saltus.effects.profile import Profile


def to_robot(effect: Effect, focal_px: float) -> Effect:
    """An effect as images of focal length `focal_px` show it, for the robot's camera.

    Noise stays in the pixels in which it was measured, and says which those are.
    """
    if isinstance(effect, DepthNoise):
        return replace(effect, focal_px=focal_px)
    return _scaled(effect, D435I.fx / focal_px)


def to_images(profile: Profile, focal_px: float) -> Profile:
    """A profile of the robot's camera, for images of focal length `focal_px`."""
    return replace(profile, camera=tuple(_seen(effect, focal_px) for effect in profile.camera))


def _seen(effect: Effect, focal_px: float) -> Effect:
    if isinstance(effect, DepthNoise):
        scale = focal_px / effect.focal_px
        return replace(
            effect, subpixel_sigma=_times(effect.subpixel_sigma, scale), focal_px=focal_px
        )
    return _scaled(effect, focal_px / D435I.fx)


def _scaled(effect: Effect, scale: float) -> Effect:
    if isinstance(effect, EdgeHoles):
        return replace(effect, width=_times(effect.width, scale))
    if isinstance(effect, HoleFill):
        return replace(effect, reach=_times(effect.reach, scale))
    return effect


def _times(value: PerRobot, scale: float) -> PerRobot:
    """A number, or one for each robot."""
    return scale * value
