"""Kinds of ground: each a law from draws to rasters of heights."""

from collections.abc import Callable

import torch
from torch import Tensor

from saltus.heightmap.scan.training.patch_places import PatchPlaces
from saltus.heightmap.scan.training.rasters import (
    edges_of,
    linear_between_edges,
    segment_heights,
    smooth_bicubic,
    with_boxes,
)
from saltus.heightmap.scan.training.seeded_random import SeededRandom

DEEP = ("stones", "stones_line", "ditches", "stones_dense")
"""Families whose trenches no base sinks into."""


def _flat(place: PatchPlaces, _: SeededRandom) -> Tensor:
    return torch.zeros_like(place.u)


def _rubble(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    return with_boxes(
        torch.zeros_like(place.u), place, draws, count=48, side=(0.1, 1.0), tall=(0.02, 0.22)
    )


def _blocks(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    """Squares of a grid, each of its own height."""
    side = draws.log_uniform(0.08, 0.7, place.n)[:, None, None]
    spread = draws.uniform(0.02, 0.15, place.n)[:, None]
    count = 64
    i, j = ((c / side).floor().long() % count for c in (place.u, place.v))
    table = draws.normal(1.0, place.n, count * count).clamp(-2.0, 2.0) * spread
    return table.gather(1, (i * count + j).flatten(1)).view_as(place.u)


def _strips(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    """Steps up and down across the way."""
    k = place.segments(0.15)
    runs = draws.uniform(0.15, 1.0, place.n, k)
    height = (
        draws.normal(1.0, place.n, k + 1).clamp(-2.0, 2.0)
        * draws.uniform(0.03, 0.2, place.n)[:, None]
    )
    return _between_sides(segment_heights(place.u, edges_of(runs, place), height), place, draws)


def _flights_of_stairs(place: PatchPlaces, draws: SeededRandom, u: Tensor) -> Tensor:
    """Stairs up and down with landings; their middle is at height 0."""
    k = place.segments(0.2)
    run, rise = draws.uniform(0.2, 0.45, place.n, 1), draws.uniform(0.04, 0.25, place.n, 1)
    # flights: every one leads up, down, or is a landing
    turn = draws.chance(0.15, place.n, k + 1).cumsum(1)
    way = draws.one_of((-1.0, 1.0, 1.0, -1.0, 0.0), place.n, k + 2).gather(1, turn.clamp(max=k + 1))
    uneven = draws.normal(0.15, place.n, k) * draws.chance(0.3, place.n, 1)
    rises = rise * way * (1.0 + draws.normal(0.15, place.n, k + 1) * draws.chance(0.3, place.n, 1))
    height = rises.cumsum(1)
    edges = edges_of(run * (1.0 + uneven).clamp(0.5, 1.5), place)
    middle = torch.searchsorted(edges, torch.zeros_like(edges[:, :1]))
    return segment_heights(u, edges, height - height.gather(1, middle))


def _stairs(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    return _between_sides(_flights_of_stairs(place, draws, place.u), place, draws)


def _pyramid(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    """Stairs around a square in the middle, up or down on all four sides."""
    return _flights_of_stairs(place, draws, torch.maximum(place.u.abs(), place.v.abs()))


def _ramps(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    k = place.segments(0.4)
    runs = draws.uniform(0.4, 2.0, place.n, k)
    slope = draws.uniform(-0.5, 0.5, place.n, k) * draws.chance(0.7, place.n, k)
    edges, height = edges_of(runs, place), (slope * runs).cumsum(1)
    middle = height[:, k // 2, None]
    return _between_sides(linear_between_edges(place.u, edges, height - middle), place, draws)


def _stones(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    """Stones of a grid over a trench: moved, turned sizes, some missing."""
    pitch = draws.uniform(0.25, 0.9, place.n)
    share = draws.uniform(0.5, 0.95, place.n)
    return _stones_of(place, draws, pitch=pitch, share=share, there=0.9)


def _stones_dense(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    """Stones of a grid without missing ones, with narrow gaps or none; half of them begin behind
    level ground.
    """
    pitch = draws.uniform(0.35, 0.7, place.n)
    share = draws.uniform(0.8, 1.1, place.n)
    stones = _stones_of(place, draws, pitch=pitch, share=share, there=1.0)
    begins = draws.uniform(-1.5, 1.5, place.n)[:, None, None]
    level = draws.chance(0.5, place.n)[:, None, None] & (place.u < begins)
    return torch.where(level, 0.0, stones)


def _stones_of(
    place: PatchPlaces, draws: SeededRandom, *, pitch: Tensor, share: Tensor, there: float
) -> Tensor:
    """Stones of a grid over a trench.

    Args:
        place: Where the cells of the patches are.
        draws: Give the sizes, places and heights of the stones.
        pitch: Side of a cell [m], shape (patches,).
        share: Side of the largest stone, by that of its cell, shape (patches,).
        there: Share of the cells that have a stone.
    """
    pitch, share = pitch[:, None, None], share[:, None]
    count = 32
    i, j = ((c / pitch).floor() for c in (place.u, place.v))
    cell = ((i.long() % count) * count + j.long() % count).flatten(1)

    def by_stone(table: Tensor) -> Tensor:
        return table.gather(1, cell).view_as(place.u)

    def half(table: Tensor) -> Tensor:
        return by_stone(0.5 * share * (1.0 - 0.3 * table))

    def middle() -> Tensor:
        return by_stone(0.5 + draws.uniform(-0.5, 0.5, place.n, count**2) * (1.0 - share))

    a, b = place.u / pitch - i - middle(), place.v / pitch - j - middle()
    sizes = [draws.uniform(0.0, 1.0, place.n, count**2) for _ in range(2)]
    stands = by_stone(draws.chance(there, place.n, count**2).float()) > 0.5
    inside = (a.abs() < half(sizes[0])) & (b.abs() < half(sizes[1])) & stands
    spread = draws.uniform(0.0, 0.08, place.n)[:, None]
    top = by_stone(draws.uniform(-1.0, 1.0, place.n, count**2) * spread)
    return torch.where(inside, top, -place.trench[:, None, None])


def _alternating(
    place: PatchPlaces, draws: SeededRandom, first: tuple[float, float], second: tuple[float, float]
) -> Tensor:
    """Edges of segments of two kinds by turns."""
    k = 2 * place.segments(first[0] + second[0])
    odd = torch.arange(k, device=draws.device) % 2
    return edges_of(
        torch.where(
            odd == 0, draws.uniform(*first, place.n, k), draws.uniform(*second, place.n, k)
        ),
        place,
    )


def _by_turns(place: PatchPlaces, edges: Tensor, even: Tensor, odd: Tensor) -> Tensor:
    """Heights by turns: of segments that begin at even edges,
    and of those that begin at odd ones.
    """
    k = edges.shape[1] + 1
    is_odd = torch.arange(k, device=edges.device) % 2 == 0  # segment i begins at edge i - 1
    return segment_heights(place.u, edges, torch.where(is_odd[None], odd, even))


def _stones_line(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    """Stones across the whole way, with gaps between them."""
    edges = _alternating(place, draws, (0.25, 0.8), (0.03, 0.6))
    top = (
        draws.normal(1.0, place.n, edges.shape[1] + 1).clamp(-2.0, 2.0)
        * draws.uniform(0.0, 0.06, place.n)[:, None]
    )
    return _by_turns(place, edges, top, -place.trench[:, None].expand_as(top))


def _ditches(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    edges = _alternating(place, draws, (0.8, 2.5), (0.1, 1.1))
    top = torch.zeros(place.n, edges.shape[1] + 1, device=draws.device)
    return _by_turns(place, edges, top, -place.trench[:, None].expand_as(top))


def _hurdles(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    edges = _alternating(place, draws, (0.4, 1.6), (0.03, 0.2))
    tall = draws.uniform(0.04, 0.35, place.n, edges.shape[1] + 1)
    return _between_sides(_by_turns(place, edges, torch.zeros_like(tall), tall), place, draws)


def _walls(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    return with_boxes(
        torch.zeros_like(place.u), place, draws, count=8, side=(0.1, 3.0), tall=(0.2, 1.2)
    )


def _clutter(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    return with_boxes(
        torch.zeros_like(place.u), place, draws, count=40, side=(0.04, 0.4), tall=(0.02, 0.4)
    )


def _rough(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    raster = place.u.shape[-1]
    fine, coarse = (max(4, round(place.patch_m / m)) for m in (0.1, 0.3))
    spread = draws.uniform(0.005, 0.05, place.n)[:, None, None]
    waves = smooth_bicubic(draws.normal(1.0, place.n, coarse, coarse), raster)
    return spread * (waves + 0.5 * smooth_bicubic(draws.normal(1.0, place.n, fine, fine), raster))


def _hills(place: PatchPlaces, draws: SeededRandom) -> Tensor:
    waves = smooth_bicubic(draws.normal(1.0, place.n, 9, 9), place.u.shape[-1])
    return draws.uniform(0.05, 0.35, place.n)[:, None, None] * waves


def _between_sides(height: Tensor, place: PatchPlaces, draws: SeededRandom) -> Tensor:
    """A third of the courses end at their sides, on level ground."""
    half = draws.uniform(0.4, 1.5, place.n)[:, None, None]
    ends = draws.chance(0.33, place.n)[:, None, None] & (place.v.abs() > half)
    return torch.where(ends, draws.uniform(-0.2, 0.0, place.n)[:, None, None], height)


KINDS: dict[str, Callable[[PatchPlaces, SeededRandom], Tensor]] = {
    "flat": _flat, "rubble": _rubble, "blocks": _blocks, "strips": _strips, "stairs": _stairs,
    "pyramid": _pyramid,
    "ramps": _ramps, "stones": _stones, "stones_line": _stones_line, "ditches": _ditches,
    "hurdles": _hurdles,
    "walls": _walls, "clutter": _clutter, "rough": _rough, "hills": _hills,
    "stones_dense": _stones_dense,
}  # fmt: skip
"""The law of each family."""
