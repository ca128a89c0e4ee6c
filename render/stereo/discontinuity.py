"""Where a disparity image breaks."""

from typing import Any

from render.stereo.fields import padded
from saltus.arrays import namespace


def discontinuity(disparity: Any, jump: float) -> Any:
    """Samples next to a step of more than `jump` [px] in disparity, on both sides of it, bool, shape as `disparity`.

    The disparity of a plane is linear in the image, so the second difference is 0 on every plane, however slanted.
    """
    xp = namespace(disparity)
    found = None
    for axis in (-2, -1):
        if disparity.shape[axis] < 2:
            continue
        wide = padded(disparity, 1, axis)
        if axis == -2:
            bend = wide[..., 2:, :] + wide[..., :-2, :] - 2.0 * disparity
        else:
            bend = wide[..., 2:] + wide[..., :-2] - 2.0 * disparity
        broken = xp.abs(bend) > jump
        found = broken if found is None else found | broken
    return xp.zeros_like(disparity) > 0.0 if found is None else found
