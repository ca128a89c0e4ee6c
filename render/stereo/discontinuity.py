"""Where a disparity image breaks."""

from saltus.arrays import Images, Masks, namespace


def discontinuity(disparity: Images, jump: float) -> Masks:
    """Samples next to a step of more than `jump` [px] in disparity,
    on both sides of it, bool, shape as `disparity`.

    The disparity of a plane is linear in the image, so the second difference is 0 on every plane,
    however slanted.
    """
    xp = namespace(disparity)
    found = xp.zeros_like(disparity, dtype=xp.bool)
    for axis in (-2, -1):
        if disparity.shape[axis] < 2:
            continue
        across, broken = (xp.matrix_transpose(a) if axis == -2 else a for a in (disparity, found))
        slope = across[..., 1:] - across[..., :-1]
        bend = abs(slope[..., 1:] - slope[..., :-1])
        broken[..., 1:-1] |= bend > jump
        # beyond the border all is as at the border
        broken[..., 0] |= abs(slope[..., 0]) > jump
        broken[..., -1] |= abs(slope[..., -1]) > jump
    return found
