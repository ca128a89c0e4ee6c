"""Depth images by casting a ray through the middle of each pixel at a floor and boxes."""

import warp as wp

FAR = 1.0e6
"""Depth where a ray meets nothing [m]."""
NOTHING = wp.constant(FAR)


@wp.kernel(enable_backward=False)
def cast(
    origin: wp.array(dtype=wp.vec3, ndim=2),
    forward: wp.array(dtype=wp.mat33, ndim=2),
    tangent: wp.array(dtype=wp.vec2, ndim=2),
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
    depth: wp.array(dtype=float, ndim=3),
):
    """Depth along the optical axis; poses are given for each frame and row of pixels."""
    frame, row, column = wp.tid()
    start = origin[frame, row]
    slope = tangent[row, column]
    ray = forward[frame, row] * wp.vec3(1.0, -slope[0], -slope[1])
    nearest = float(NOTHING)
    if ray[2] < -1.0e-6:
        nearest = -start[2] / ray[2]
    for box in range(low.shape[0]):
        enter = float(1.0e-4)  # noqa: UP018 - tells the compiler that it changes
        leave = float(NOTHING)
        for axis in range(3):
            if wp.abs(ray[axis]) < 1.0e-9:
                if start[axis] < low[box][axis] or start[axis] > high[box][axis]:
                    leave = -1.0
            else:
                a = (low[box][axis] - start[axis]) / ray[axis]
                b = (high[box][axis] - start[axis]) / ray[axis]
                enter = wp.max(enter, wp.min(a, b))
                leave = wp.min(leave, wp.max(a, b))
        if enter < leave:
            nearest = wp.min(nearest, enter)
    depth[frame, row, column] = nearest
