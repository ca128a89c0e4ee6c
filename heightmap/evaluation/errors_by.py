"""Errors of predicted heights by what they may depend on,
and whether the stated intervals hold them.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.heightmap.evaluation.comparison import PHASES, HeightComparison
from saltus.heightmap.service.quantiles import half_width, negative_log_likelihood

PROGRESS_BINS = 5
SPEED_BIN_MPS = 0.25
AGE_BIN_MS = 10.0  # one tick
LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
WIDTH_BINS = 10
VISIBLE, REMEMBERED = "visible", "remembered"


@dataclass(frozen=True, kw_only=True)
class ErrorRow:
    """Errors of one group of points [m]."""

    group: str
    detail: str
    """Second level, e.g. the part of a gait phase; empty where there is none."""
    count: int
    mae_m: float
    p90_m: float
    """90 % of the absolute errors are below."""
    bias_m: float
    """Mean of predicted less true."""
    half_width_90_m: float
    """Median of half of the 90 % intervals as stated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class IntervalFit:
    """True where stated intervals fit the errors, see `saltus.heightmap.service.quantiles`."""

    level: Floats
    """Expected coverage of central intervals."""
    coverage: Floats
    """Observed."""
    stated_m: Floats
    """Mean (RMS) of half of the stated 90 % intervals in bins of equal counts."""
    observed_m: Floats
    """Half-width that should have been stated there: the error that 90 % are below."""
    nll: float
    """Mean negative log-likelihood of the true heights, in nats, heights in metres."""

    @property
    def coverage90(self) -> float:
        """Observed coverage of 90 % intervals."""
        return float(self.coverage[LEVELS.index(0.9)])


class GroupedErrors:
    """The points of several comparisons of one predictor, with what they can be grouped by."""

    def __init__(self, comparisons: Sequence[HeightComparison]) -> None:
        self._ahead_m = comparisons[0].x
        points = len(self._ahead_m)
        error = np.concatenate([c.error for c in comparisons])
        known = np.isfinite(error)
        self.error = error[known]
        self.half_width_90 = np.concatenate([c.half_width_90 for c in comparisons])[known]
        self._x = np.tile(np.arange(points), (len(error), 1))[known]
        self._visible = np.concatenate([c.visible for c in comparisons])[known]
        step = np.repeat(np.arange(len(error)), points).reshape(-1, points)[known]
        self._phase = np.concatenate([c.phase for c in comparisons])[step]
        self._progress = np.concatenate([c.progress for c in comparisons])[step]
        self._speed = np.concatenate([c.speed_mps for c in comparisons])[step]
        self._age_ms = 1e3 * np.concatenate([c.age_s for c in comparisons])[step]
        self._terrain = np.concatenate(
            [np.full(len(c.step), c.terrain, dtype=object) for c in comparisons]
        )[step]

    def overall(self) -> ErrorRow | None:
        """All points; None where the reference knows none."""
        return self._row("all", "", np.ones(len(self.error), np.bool_))

    def by_distance(self) -> list[ErrorRow]:
        """One row for each point of the grid, named by its distance ahead in metres."""
        return self._rows((f"{x:.3f}", "", self._x == i) for i, x in enumerate(self._ahead_m))

    def by_terrain(self) -> list[ErrorRow]:
        """One row for each kind of terrain."""
        return self._rows((kind, "", self._terrain == kind) for kind in sorted(set(self._terrain)))

    def by_view(self) -> list[ErrorRow]:
        """Points inside the field of view when the image was taken, and all others."""
        return self._rows(((VISIBLE, "", self._visible), (REMEMBERED, "", ~self._visible)))

    def by_phase(self) -> list[ErrorRow]:
        """Scheduled contact, each in five parts."""
        part = np.minimum((self._progress * PROGRESS_BINS).astype(np.int64), PROGRESS_BINS - 1)
        wide = 100 // PROGRESS_BINS
        return self._rows(
            (phase, f"{wide * i}-{wide * (i + 1)} %", (self._phase == phase) & (part == i))
            for phase in PHASES
            for i in range(PROGRESS_BINS)
        )

    def by_speed(self) -> list[ErrorRow]:
        """Horizontal speed as estimated, in bins of 0.25 m/s."""
        return self._binned(self._speed, SPEED_BIN_MPS, "{:.2f}-{:.2f}")

    def by_age(self) -> list[ErrorRow]:
        """Age of the image in use, in bins of 10 ms."""
        # Ages are whole ticks in lockstep: a hair more puts 60 ms into the bin that begins there.
        return self._binned(self._age_ms + 1e-6, AGE_BIN_MS, "{:.0f}-{:.0f}")

    def calibration(self) -> IntervalFit:
        """Coverage by level, and error against half of the stated 90 % interval."""
        width = self.half_width_90
        score = np.abs(self.error) / width
        limits = [half_width(level) for level in LEVELS]
        bins = [
            part
            for part in np.array_split(np.argsort(width, kind="stable"), WIDTH_BINS)
            if len(part)
        ]
        return IntervalFit(
            level=np.array(LEVELS),
            coverage=np.array([np.mean(score <= limit) for limit in limits]),
            stated_m=np.array([np.sqrt(np.mean(width[part] ** 2)) for part in bins]),
            observed_m=np.array([np.quantile(np.abs(self.error[part]), 0.9) for part in bins]),
            nll=float(np.mean(negative_log_likelihood(self.error, width))),
        )

    def _binned(self, values: Floats, width: float, name: str) -> list[ErrorRow]:
        index = np.floor(values / width).astype(np.int64)
        return self._rows(
            (name.format(width * i, width * (i + 1)), "", index == i) for i in np.unique(index)
        )

    def _rows(self, groups: Iterable[tuple[str, str, NDArray[np.bool_]]]) -> list[ErrorRow]:
        rows = (self._row(group, detail, mask) for group, detail, mask in groups)
        return [row for row in rows if row is not None]

    def _row(self, group: str, detail: str, mask: NDArray[np.bool_]) -> ErrorRow | None:
        error = self.error[mask]
        if not len(error):
            return None
        return ErrorRow(
            group=group,
            detail=detail,
            count=len(error),
            mae_m=float(np.abs(error).mean()),
            p90_m=float(np.quantile(np.abs(error), 0.9)),
            bias_m=float(error.mean()),
            half_width_90_m=float(np.median(self.half_width_90[mask])),
        )
