"""Ray casts in Warp, on a GPU or on the CPU: boxes and capsules, one thread a pixel.

The camera frame is that of `saltus.render.camera`; a ray's parameter is its depth along the optical
axis.
"""

import math

import warp as wp

NOTHING = math.inf
PARALLEL = 1e-9  # a ray's share along an axis below this is taken to be this: no division by 0


@wp.func
def box_span(origin: wp.vec3f, direction: wp.vec3f, low: wp.vec3f, high: wp.vec3f) -> wp.vec2f:
    """Depths between which a ray's line is inside a box; the first is the greater where it misses.

    All in the box's axes. Depths are in units of `direction`, below 0 behind the origin.
    """
    enters = -NOTHING
    leaves = NOTHING
    for axis in range(3):
        share = direction[axis]
        if wp.abs(share) < PARALLEL:
            share = PARALLEL
        first = (low[axis] - origin[axis]) / share
        last = (high[axis] - origin[axis]) / share
        enters = wp.max(enters, wp.min(first, last))
        leaves = wp.min(leaves, wp.max(first, last))
    return wp.vec2f(enters, leaves)


@wp.func
def first_root(a: float, b: float, c: float) -> float:
    """The lesser t with a t^2 - 2 b t + c = 0.

    Infinite where there is none or it is not positive.
    """
    inside = b * b - a * c
    root = NOTHING
    if inside >= 0.0 and a > 0.0:
        nearer = (b - wp.sqrt(inside)) / a
        if nearer > 0.0:
            root = nearer
    return root


@wp.func
def capsule_entry(direction: wp.vec3f, start: wp.vec3f, end: wp.vec3f, radius: float) -> float:
    """Depth at which a ray from the origin enters a capsule.

    The same quadratics as `saltus.render.capsules`.
    """
    axis = end - start
    speed_squared = wp.dot(direction, direction)
    to_start = wp.dot(direction, start)
    along = wp.dot(direction, axis)
    start_ball = wp.dot(start, start) - radius * radius
    nearest = wp.min(
        first_root(speed_squared, to_start, start_ball),
        first_root(speed_squared, to_start + along, wp.dot(end, end) - radius * radius),
    )
    length_squared = wp.dot(axis, axis)
    offset = wp.dot(axis, start)
    side = first_root(
        length_squared * speed_squared - along * along,
        length_squared * to_start - offset * along,
        length_squared * start_ball - offset * offset,
    )
    place = side * along - offset
    if side < NOTHING and place > 0.0 and place < length_squared:
        nearest = wp.min(nearest, side)
    return nearest


@wp.struct
class WarpScene:
    """Cameras and the boxes and legs that they see, as Warp's kernels take them."""

    origin: wp.array[wp.vec3f]
    rotation: wp.array[wp.mat33f]
    """Camera to world."""
    low: wp.array2d[wp.vec3f]
    high: wp.array2d[wp.vec3f]
    turn: wp.array2d[wp.mat33f]
    """Turn of boxes: one row for all frames, or one for each."""
    start: wp.array2d[wp.vec3f]
    end: wp.array2d[wp.vec3f]
    radius: wp.array[float]
    """Radius of capsules, in the camera frames."""
    fx: float
    fy: float
    cx: float
    cy: float


@wp.func
def turned_entry(
    scene: WarpScene, row: int, i: int, origin: wp.vec3f, direction: wp.vec3f
) -> wp.vec2f:
    """`box_span` of a box that may be turned about its centre;
    `turn` is empty where all are level.
    """
    low, high = scene.low[row, i], scene.high[row, i]
    if scene.turn.shape[0] > 0:
        back = wp.transpose(scene.turn[row, i])
        center = 0.5 * (low + high)
        return box_span(center + back * (origin - center), back * direction, low, high)
    return box_span(origin, direction, low, high)


@wp.func
def boxes_entry(scene: WarpScene, row: int, origin: wp.vec3f, direction: wp.vec3f) -> float:
    """Depth of the nearest surface of the union of boxes, from inside as from outside."""
    nearest = wp.float32(NOTHING)  # Warp keeps what a loop changes in variables, not in constants
    within = wp.float32(-1.0)
    for i in range(scene.low.shape[1]):
        span = turned_entry(scene, row, i, origin, direction)
        if span[0] <= span[1] and span[1] > 0.0:
            if span[0] > 0.0:
                nearest = wp.min(nearest, span[0])
            else:
                within = wp.max(within, span[1])
    if within > 0.0:  # the camera is inside: out through whatever boxes follow without a gap
        for _ in range(scene.low.shape[1]):
            before = within
            for i in range(scene.low.shape[1]):
                span = turned_entry(scene, row, i, origin, direction)
                if span[0] <= within + 1.0e-5 and span[1] > within:
                    within = span[1]
            if within == before:
                break
        nearest = within
    return nearest


@wp.func
def pixel_direction(row: int, column: int, fx: float, fy: float, cx: float, cy: float) -> wp.vec3f:
    """Direction of a pixel in the camera frame, of depth 1."""
    return wp.vec3f((float(column) + 0.5 - cx) / fx, (float(row) + 0.5 - cy) / fy, 1.0)


@wp.func
def nearest_along(scene: WarpScene, frame: int, origin: wp.vec3f, way: wp.vec3f) -> float:
    """Depth of what a ray meets first; its origin and direction are in the camera frame."""
    turn = scene.rotation[frame]
    row = wp.min(frame, scene.low.shape[0] - 1)
    nearest = boxes_entry(scene, row, scene.origin[frame] + turn * origin, turn * way)
    for k in range(scene.radius.shape[0]):
        start, end = scene.start[frame, k] - origin, scene.end[frame, k] - origin
        nearest = wp.min(nearest, capsule_entry(way, start, end, scene.radius[k]))
    return nearest


@wp.kernel(enable_backward=False)
def cast_kernel(scene: WarpScene, depth: wp.array3d[float]):
    """Writes the depth of boxes and capsules into `depth`."""
    frame, row, column = wp.tid()
    direction = pixel_direction(row, column, scene.fx, scene.fy, scene.cx, scene.cy)
    depth[frame, row, column] = nearest_along(scene, frame, wp.vec3f(), direction)


@wp.kernel(enable_backward=False)
def hide_kernel(
    scene: WarpScene,
    depth: wp.array3d[float],
    baseline: float,
    farthest: float,
    along: float,
    hidden: wp.array3d[wp.bool],
):
    """Writes into `hidden` where something lies on the way from the right imager
    to the point that the left one sees.
    """
    frame, row, column = wp.tid()
    to_right = wp.vec3f(baseline, 0.0, 0.0)
    direction = pixel_direction(row, column, scene.fx, scene.fy, scene.cx, scene.cy)
    way = direction * wp.min(depth[frame, row, column], farthest) - to_right
    hidden[frame, row, column] = nearest_along(scene, frame, to_right, way) < along
