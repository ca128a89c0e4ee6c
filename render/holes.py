"""Holes in depth images take depths from around them,
in the scan order of librealsense, as whole-array operations.

Each rule exists once for lists of holes, which are few, and once for whole images. To make a list
is to ask how many there are, for which a GPU would have to come to a stop; there, the number and
the shapes of the operations depend on the size of the images only. Both give the same depths, to
the bit.
"""

import math
from collections.abc import Callable

from saltus.arrays import Array, Images, Masks, namespace


def on_host(array: Array) -> bool:
    """True where an array, numpy's or torch's, is in the memory of the processor.

    There a program may look at values and go by what it finds. On a GPU it would have to wait for
    all that has been asked of the GPU so far.
    """
    return str(array.device) == "cpu"


def filled_from_around(depth: Images) -> Images:
    """Holes take the nearest depth among what is above, above left, left, below left and below.

    Pixels are visited row by row, so filled ones fill others. The pixel above must be valid, or
    filled. The first column, the top and the bottom row are not filled. Depth is 0 where invalid,
    any unit, shape (..., height, width); `depth` itself is returned where nothing can change.
    """
    return _from_around_by_list(depth) if on_host(depth) else _from_around_by_lines(depth)


def _from_around_by_list(depth: Images) -> Images:
    """Works on the list of holes, with jumps of 1, 2, 4, ... of them, since values walk far."""
    xp = namespace(depth)
    width = depth.shape[-1]
    empty = depth == 0.0
    inner = xp.zeros_like(empty)
    inner[..., 1:-1, 1:] = empty[..., 1:-1, 1:]
    (hole,) = xp.nonzero(xp.reshape(inner, (-1,)))
    if not hole.shape[0]:
        return depth
    # a pixel below another that is valid, however far above, finds its upper neighbour filled when
    # its turn comes
    supported = xp.concat([~xp.reshape(empty, (-1,))[hole - width], hole[:1] < 0])
    for jump in _jumps(hole, width):
        supported = supported | supported[jump]
    hole = hole[supported[:-1]]
    far = xp.reshape(xp.where(empty, xp.full_like(depth, math.inf), depth), (-1,))
    # the row below has not been visited yet: of it counts only what it had by itself
    nearest = far[hole - width]
    for step in (-width - 1, -1, width - 1, width):
        nearest = xp.minimum(nearest, far[hole + step])
    nearest = xp.concat([nearest, xp.full_like(far[:1], math.inf)])
    jumps = [jump for step in (1, width, width + 1) for jump in _jumps(hole, step)]
    before = None
    while before is None or bool(xp.any(nearest < before)):
        before = nearest
        for jump in jumps:
            nearest = xp.minimum(nearest, nearest[jump])
    result = xp.reshape(xp.asarray(depth, copy=True), (-1,))
    result[hole] = nearest[:-1]
    return xp.reshape(result, depth.shape)


def _jumps(place: Array, step: int) -> list[Array]:
    """For each entry of a sorted list of places the entry that is `step`,
    2 `step`, 4 `step`, ... places before it.

    Only where all between are entries, too. An entry more, at the end, stands for none; each array
    has it as well.
    """
    xp = namespace(place)
    none = place.shape[0]
    found = xp.searchsorted(place, place - step)
    jump = xp.where(place[found] == place - step, found, none) if none else found
    jump = xp.concat([jump, xp.full((1,), none, dtype=jump.dtype, device=place.device)])
    jumps = []
    while bool(xp.any(jump < none)):
        jumps.append(jump)
        jump = jump[jump]
    return jumps


def _from_around_by_lines(depth: Images) -> Images:
    """Works on whole images, a line after the other.

    A hole that is filled gets the least of what its neighbours had by themselves (its own), and of
    what holes to its left, above, and above left got. Rows and columns play the same part in this,
    so lines run along the longer axis.
    """
    xp = namespace(depth)
    empty = depth == 0.0
    hole = xp.zeros_like(empty)
    # a valid pixel above, however far: what is between has been filled before
    hole[..., 1:-1, 1:] = empty[..., 1:-1, 1:] & _running(~empty, -2, xp.logical_or)[..., :-2, 1:]
    own = _least_around(xp.where(empty, xp.full_like(depth, math.inf), depth))
    nearest = xp.where(hole, own, xp.full_like(own, math.inf))
    if depth.shape[-1] < depth.shape[-2]:
        nearest = xp.matrix_transpose(
            _along_lines(xp.matrix_transpose(nearest), xp.matrix_transpose(hole))
        )
    else:
        nearest = _along_lines(nearest, hole)
    return xp.where(hole, nearest, depth)


def _least_around(far: Images) -> Images:
    """The least of what is above, above left, left, below left and below.

    Only of use off the borders.
    """
    xp = namespace(far)
    left = xp.minimum(far[..., 1:-1, :-1], xp.minimum(far[..., :-2, :-1], far[..., 2:, :-1]))
    least = xp.full_like(far, math.inf)
    least[..., 1:-1, 1:] = xp.minimum(left, xp.minimum(far[..., :-2, 1:], far[..., 2:, 1:]))
    return least


def _along_lines(nearest: Images, hole: Masks) -> Images:
    """Hands values on from line to line and along each, through holes only; infinite elsewhere."""
    xp = namespace(nearest)
    no_way = xp.full_like(nearest[..., :1, :1], math.inf)
    free = xp.zeros_like(no_way)
    # what it costs to come from 1, 2, 4, ... places before: nothing where all on the way are holes
    costs, open_way, reach = [], hole, 1
    while reach < nearest.shape[-1]:
        costs.append((reach, xp.where(open_way, free, no_way)))
        further = xp.zeros_like(open_way)
        further[..., reach:] = open_way[..., reach:] & open_way[..., :-reach]
        open_way, reach = further, 2 * reach
    lines = [nearest[..., 0, :]]
    for i in range(1, nearest.shape[-2]):
        before, line = lines[-1], xp.minimum(nearest[..., i, :], lines[-1])
        line[..., 1:] = xp.minimum(line[..., 1:], before[..., :-1])
        line = xp.where(hole[..., i, :], line, no_way[..., 0])
        for reach, cost in costs:
            line[..., reach:] = xp.minimum(
                line[..., reach:], line[..., :-reach] + cost[..., i, reach:]
            )
        lines.append(line)
    return xp.stack(lines, axis=-2)


def _running(values: Array, axis: int, pick: Callable[[Array, Array], Array]) -> Array:
    """Extreme (`pick`) of all values up to each place along an axis."""
    xp = namespace(values)
    turned = axis == -2
    run, reach = xp.asarray(xp.matrix_transpose(values) if turned else values, copy=True), 1
    while reach < run.shape[-1]:
        run[..., reach:] = pick(run[..., reach:], run[..., :-reach])
        reach *= 2
    return xp.matrix_transpose(run) if turned else run


def filled_along_rows(depth: Images, reach: int, passes: int = 1) -> Images:
    """Holes take what is to the left of them, then what is to the right,
    up to `reach` pixels away, `passes` times.

    The last column stays as it is. Depth is 0 where invalid, any unit, shape (..., height, width);
    `depth` itself is returned where nothing can change.
    """
    if reach <= 0:
        return depth
    if not on_host(depth):
        return _along_rows(depth, reach, passes)
    xp = namespace(depth)
    broken = xp.any(depth[..., :-1] == 0.0, axis=-1) & xp.any(depth > 0.0, axis=-1)
    if not bool(xp.any(broken)):
        return depth
    result = xp.asarray(depth, copy=True)
    result[broken] = _along_rows(depth[broken], reach, passes)  # few: most rows are whole
    return result


def _along_rows(depth: Images, reach: int, passes: int) -> Images:
    """A pass takes `reach` pixels off both ends of every hole, the left end first."""
    xp = namespace(depth)
    width = depth.shape[-1]
    column = xp.arange(width, dtype=xp.int16, device=depth.device)
    valid = depth > 0.0
    # the last column gives to the left, but not to the right: nothing is to the right of it
    left = _running(xp.where(valid, column, -1), -1, xp.maximum)
    right = xp.flip(
        _running(xp.flip(xp.where(valid, column, width), axis=-1), -1, xp.minimum), axis=-1
    )
    never = passes + 1
    turn_left = xp.where(left >= 0, (column - left + reach - 1) // reach, never)
    turn_right = xp.where(right < width, (right - column + reach - 1) // reach, never)
    source = xp.where(turn_left <= turn_right, left, right)
    source = xp.where(xp.minimum(turn_left, turn_right) <= passes, source, column)
    source[..., -1] = width - 1
    return xp.take_along_axis(depth, xp.astype(source, xp.int64), axis=-1)
