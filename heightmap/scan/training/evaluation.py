"""Errors of heights after a second of motion,
on the scan and on the line, apart by what was seen of them.
"""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from saltus.grid import SCAN, HeightGrid, load_grid
from saltus.heightmap.scan.cells import fine_cell_positions, sample_bilinear
from saltus.heightmap.scan.elevation import ElevationMap, MapContext, advance_map, new_map
from saltus.heightmap.scan.geometry import geometric_heights
from saltus.heightmap.scan.network_inputs import MapHeights, inputs_of, remember_told
from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.flights import FlightDraws, FlightImage, draw_flight, next_image
from saltus.heightmap.scan.training.framewise import heights_kept, of_image
from saltus.heightmap.scan.training.ground_patches import heights_at
from saltus.heightmap.scan.training.last_seen import LastSeen
from saltus.heightmap.scan.training.pose_tables import turn_by_yaw
from saltus.heightmap.scan.training.scan_model import ScanModel, told_heights
from saltus.heightmap.scan.training.seeded_random import SeededRandom
from saltus.heightmap.scan.training.settings import (
    EVALUATED,
    FAMILIES,
    FlightSettings,
    ScanTrainSettings,
)

GRIDS = {"scan": SCAN, "line": load_grid("line")}
AFTER_S = 1.0
"""Motion before the first height is judged [s]."""
VISIBLE_S = 0.2
"""A point whose last image is not older was visible [s]."""
GROUPS = ("all", "seen", "visible", "remembered", "never")
EVAL_SEED = 1_000_000_007
"""Far from every seed of a round of training."""
WIDTHS_KEPT = 64
"""Every so manyth point's half-width goes into the median."""


@dataclass(frozen=True, kw_only=True)
class ScanScore:
    """Errors of the heights of one method on a group of points, in simulated flights."""

    row: str
    grid: str
    method: str
    group: str
    family: str
    """A family's name, or "every"."""
    points: int
    share: float
    """Part of all points."""
    error_mm: float
    """Mean absolute error."""
    inside: float
    """Share within the half-width."""
    half_width_mm: float
    """Median."""


def usual_flights(trained: FlightSettings) -> FlightSettings:
    """Flights of the first row: D435i errors, 30 to 110 ms late, odometry off by 3 %."""
    return replace(
        trained, families=EVALUATED, odometry=(1.0, 1.0), latency_s=(0.03, 0.11),
        rate_hz=(15.0, 40.0), images=60,
        height_m=(0.15, 1.2), down_deg=(0.0, 60.0), fov_deg=(50.0, 100.0), pitch_deg=(8.0, 40.0),
        errors=1.0, calibration=(1.0, 1.0),
    )  # fmt: skip


def evaluation_rows(trained: FlightSettings) -> dict[str, FlightSettings]:
    """Names of rows, and from what their flights are drawn."""
    usual = usual_flights(trained)
    left_out = tuple(name for name in EVALUATED if name not in trained.families)
    rows = {
        "usual": usual,
        "good odometry": replace(usual, odometry=(0.0, 0.0)),
        "known well": replace(usual, odometry=(0.0, 0.0), calibration=(0.0, 0.0)),
        "bad odometry": replace(usual, odometry=(2.0, 2.0)),
        "Go1's mount": replace(
            usual, gaits=("bound",), height_m=(0.36, 0.36), above_m=(0.092, 0.092),
            ahead_m=(0.272, 0.272),
            down_deg=(29.8, 29.8), turned=0.0, rolled=0.0, pairs=0.0, aim_deg=0.0,
            fov_deg=(21.43, 21.43),
            shape=(3.0, 3.0), rate_hz=(40.0, 40.0), latency_s=(0.04, 0.06), feet=1.0, speed_mps=1.0,
        ),
        "no feet": replace(usual, feet=0.0),
        "no velocity": replace(usual, velocity=0.0),
        "two cameras": replace(usual, pairs=1.0),
        "looking left": replace(usual, look_deg=90.0, turned=0.0),
        "rolled cameras": replace(usual, rolled=1.0),
        "1.2 to 1.7 m high": replace(usual, height_m=(1.2, 1.7)),
        "60 to 85 degrees down": replace(usual, down_deg=(60.0, 85.0)),
        "100 to 125 degrees wide": replace(usual, fov_deg=(100.0, 125.0)),
        "110 to 200 ms late": replace(usual, latency_s=(0.11, 0.2)),
        "pitch of 40 to 55 degrees": replace(usual, gaits=("bound",), pitch_deg=(40.0, 55.0)),
        "dense stones": replace(usual, families=("stones_dense",), trench_m=(0.3, 0.6)),
    }  # fmt: skip
    return {**rows, "families left out": replace(usual, families=left_out)} if left_out else rows


def rivals_of(settings: MapSettings) -> dict[str, MapSettings]:
    """Classical maps, from the plainest to the one to beat."""
    plain = replace(settings, matching=False, foot_gain=0.0)
    return {
        "map 4 cm": replace(plain, sub=1),
        "map 2 cm": plain,
        "map 2 cm, feet": replace(plain, foot_gain=settings.foot_gain),
        "map 2 cm, drift, feet": settings,
    }


class _Tally:
    """Sums over points, by group and family."""

    def __init__(self, device: torch.device) -> None:
        self.sums = torch.zeros(len(GROUPS), len(FAMILIES), 3, dtype=torch.float64, device=device)
        self.widths: list[list[Tensor]] = [[] for _ in GROUPS]

    def add(self, error: Tensor, half_width: Tensor, groups: Tensor, family: Tensor) -> None:
        """Errors and half-widths (robots, points), groups (len(GROUPS),
        robots, points), families (robots,).
        """
        inside = (error <= half_width).double()
        for index, mask in enumerate(groups):
            weight = mask.double()
            values = torch.stack(
                (weight.sum(1), (weight * error).sum(1), (weight * inside).sum(1)), -1
            )
            self.sums[index].index_add_(0, family, values)
            self.widths[index].append(half_width[mask][::WIDTHS_KEPT].cpu())

    def scores(self, row: str, grid: str, method: str) -> Iterator[ScanScore]:
        """One score per group, and one per group and family."""
        sums, every = self.sums.cpu(), self.sums.sum(1, keepdim=True).cpu()
        for index, group in enumerate(GROUPS):
            widths = torch.cat(self.widths[index]) if self.widths[index] else torch.zeros(0)
            width = 1e3 * float(widths.median()) if len(widths) else float("nan")
            for family, values in zip(
                ("every", *FAMILIES), torch.cat((every[index], sums[index])), strict=True
            ):
                count, error, inside = values.tolist()
                whole = (
                    sums[0].sum(0)[0] if family == "every" else sums[0][FAMILIES.index(family)][0]
                )
                if count:
                    yield ScanScore(
                        row=row, grid=grid, method=method, group=group, family=family,
                        points=int(count),
                        share=count / float(whole), error_mm=1e3 * error / count,
                        inside=inside / count,
                        half_width_mm=width if family == "every" else float("nan"),
                    )  # fmt: skip


def evaluate_scan(
    model: ScanModel | None, settings: ScanTrainSettings, *, robots: int, device: torch.device,
    batch: int = 128,
    rows: dict[str, FlightSettings] | None = None, rivals: dict[str, MapSettings] | None = None,
    seed: int = EVAL_SEED,
) -> list[ScanScore]:  # fmt: skip
    """Scores of the network, if any, and of its rivals on the same images, odometry and feet.

    Batches of flights follow from `seed` plus the number of flights before them.
    """
    rivals = rivals or rivals_of(settings.map)
    scores: list[ScanScore] = []
    for row, flights in (rows or evaluation_rows(settings.flight)).items():
        tallies: dict[tuple[str, str], _Tally] = {}
        for start in range(0, robots, batch):
            draws = SeededRandom(seed + start, device)
            with torch.no_grad():
                _fly(
                    model, settings.map, rivals, flights, min(batch, robots - start), draws, tallies
                )
        for (grid, method), tally in tallies.items():
            scores += tally.scores(row, grid, method)
    return scores


def _fly(
    model: ScanModel | None, map_settings: MapSettings, rivals: dict[str, MapSettings],
    flights: FlightSettings,
    robots: int, draws: SeededRandom, tallies: dict[tuple[str, str], _Tally],
) -> None:  # fmt: skip
    flight = draw_flight(robots, flights, draws)
    like = flight.ground.height
    maps = {name: new_map(robots, rival, like) for name, rival in rivals.items()}
    own = new_map(robots, map_settings, like)
    seen = LastSeen(robots, flights, like)
    for _ in range(flights.images):
        shot = next_image(flight, flights, draws)
        seen.add(shot)
        judged = shot.now_s >= AFTER_S
        told_by: dict[str, tuple[MapHeights, ElevationMap, MapContext, MapSettings]] = {}
        if model is not None:
            told_by["network"] = (
                *_told(model, own, shot, 1.0 / flight.rate_hz, map_settings),
                map_settings,
            )
            own = told_by["network"][1]
        for name, rival in rivals.items():
            measured = shot.measured
            if not rival.foot_gain:
                measured = measured._replace(standing=torch.zeros_like(measured.standing))
            maps[name], about = advance_map(maps[name], measured, rival)
            told_by[name] = (
                geometric_heights(maps[name], about, shot.now_s, rival),
                maps[name],
                about,
                rival,
            )
        if bool(judged.any()):
            for grid_name, grid in GRIDS.items():
                _judge(grid_name, grid, told_by, flight, shot, seen, judged, flights, tallies)


def _told(
    model: ScanModel,
    state: ElevationMap,
    shot: FlightImage,
    images_apart_s: Tensor,
    settings: MapSettings,
) -> tuple[MapHeights, ElevationMap, MapContext]:
    """Heights of a network after an image, with the map that remembers them."""
    state, around = advance_map(state, shot.measured, settings)
    if not model.settings.frame:
        heights = told_heights(
            model, inputs_of(state, around, shot.now_s, shot.measured), around.filled
        )
        return heights, remember_told(state, heights), around
    alone, inputs, around = of_image(state, shot.measured, shot.now_s, settings)
    heights = heights_kept(
        state, alone.corner, told_heights(model, inputs, around.filled), images_apart_s, settings
    )
    return heights, remember_told(state, heights), around


def _judge(
    name: str, grid: HeightGrid,
    told_by: dict[str, tuple[MapHeights, ElevationMap, MapContext, MapSettings]],
    flight: FlightDraws, shot: FlightImage, seen: LastSeen, judged: Tensor, flights: FlightSettings,
    tallies: dict[tuple[str, str], _Tally],
) -> None:  # fmt: skip
    points = torch.tensor(grid.points, dtype=shot.position.dtype, device=shot.position.device)
    points = points.expand(len(shot.position), -1, -1)
    place = turn_by_yaw(points, shot.angles[:, 2]) + shot.position[:, None, :2]
    truth = (
        heights_at(flight.ground.height, place[..., 0], place[..., 1], flights.raster_m)
        - shot.position[:, 2:]
    )
    age = shot.now_s[:, None] - seen.at(place)
    was_seen, visible = torch.isfinite(age), age <= VISIBLE_S
    groups = torch.stack(
        (torch.ones_like(was_seen), was_seen, visible, was_seen & ~visible, ~was_seen)
    )
    groups, family = groups[:, judged], flight.ground.family[judged]

    def add(method: str, height: Tensor, half_width: Tensor) -> None:
        tally = tallies.setdefault((name, method), _Tally(truth.device))
        tally.add((height - truth).abs()[judged], half_width[judged], groups, family)

    flat = -shot.measured.body_height[:, None].expand_as(truth)
    add("flat", flat, torch.full_like(flat, 0.1))
    for method, (heights, state, around, map_settings) in told_by.items():
        offset = turn_by_yaw(points, shot.believed_yaw) + around.base[:, None, :2]
        at = fine_cell_positions(offset, state.corner, map_settings)
        height = sample_bilinear(heights.height, at) - around.base[:, 2:]
        add(method, height, sample_bilinear(heights.half_width, at))


def write_results(scores: list[ScanScore], path: Path) -> None:
    """Writes all scores to a JSON file."""
    path.write_text(json.dumps([vars(score) for score in scores], indent=0), encoding="utf-8")


def table_of(scores: list[ScanScore]) -> str:
    """Mean errors [mm] by group, shares and half-widths, for people."""
    found: dict[tuple[str, str, str], dict[str, ScanScore]] = {}
    for score in scores:
        if score.family == "every":
            found.setdefault((score.row, score.grid, score.method), {})[score.group] = score
    lines = [
        f"{'row':26} {'grid':4} {'method':21} " + "  ".join(f"{group:^24}" for group in GROUPS)
    ]
    for (row, grid, method), by_group in found.items():
        lines.append(
            f"{row:26} {grid:4} {method:21} " + "  ".join(_cell(by_group.get(g)) for g in GROUPS)
        )
    lines += ["", "by family, scan, usual: seen / never [mm]"]
    kept: dict[str, dict[str, Any]] = {}
    for score in scores:
        if (score.row, score.grid) == ("usual", "scan") and score.group in ("seen", "never"):
            kept.setdefault(score.family, {})[f"{score.method} {score.group}"] = score.error_mm
    for family, errors in kept.items():
        pairs = []
        for method in ("network", "map 2 cm, drift, feet"):
            seen, never = (errors.get(f"{method} {group}", math.nan) for group in ("seen", "never"))
            pairs.append(f"{method} {seen:.1f} / {never:.0f}")
        lines.append(f"{family:14} " + "   ".join(pairs))
    return "\n".join(lines)


def _cell(score: ScanScore | None) -> str:
    if score is None:
        return " " * 24
    return (
        f"{score.error_mm:6.1f} {100 * score.inside:3.0f}% {score.half_width_mm:5.0f} "
        f"{100 * score.share:4.0f}%"
    )
