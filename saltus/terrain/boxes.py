"""Boxes that may be turned: one as a value, and many as arrays
with the height of what lies under a point.

A box is turned about its centre: by `pitch` about y (nose down positive, as of a body), then by
`yaw` about z.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Array, BoxAngles, BoxQuaternions, BoxRotations, BoxVectors, namespace
from saltus.errors import ConfigError

Point = tuple[float, float, float]

UPRIGHT = 1e-9  # a face whose normal has a smaller share along z is upright, and no top
ROUNDING = (
    256  # units in the last place of 1 m: an edge belongs to its box although its place is rounded
)
MOST_PITCH, MOST_YAW = 1.6, 6.3
"""A quarter turn and a whole one, rounded up [rad]: what is beyond them is meant in degrees."""


@dataclass(frozen=True, kw_only=True)
class Box:
    """One box in the world frame.

    Raises:
        ConfigError: a number is not finite, an upper corner is not above its lower one, or it is
            turned too far.
    """

    low: Point
    """Least x, y, z [m] before it is turned."""
    high: Point
    """Greatest x, y, z [m] before it is turned."""
    pitch: float = 0.0
    """About y, nose down positive [rad]."""
    yaw: float = 0.0
    """About z, after the pitch [rad]."""

    def __post_init__(self) -> None:
        for name, value in (
            ("low", self.low),
            ("high", self.high),
            ("angles", (self.pitch, self.yaw)),
        ):
            if not all(map(math.isfinite, value)):
                raise ConfigError(
                    f"a box has {name} = {value}: every number of a terrain must be finite"
                )
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)):
            raise ConfigError(
                f"a box reaches from {self.low} to {self.high}: its size must be more than 0 m "
                "along x, y, z"
            )
        for name, angle, most in (("pitch", self.pitch, MOST_PITCH), ("yaw", self.yaw, MOST_YAW)):
            if abs(angle) > most:
                raise ConfigError(
                    f"a box has {name} = {angle:g}: it is in radians, from {-most} to {most}"
                )

    @classmethod
    def at(
        cls, center: Sequence[float], size: Sequence[float], pitch: float = 0.0, yaw: float = 0.0
    ) -> "Box":
        """A box of its centre and full edge lengths [m], as run logs have them."""
        low, high = (
            tuple(c + side * s for c, s in zip(center, size, strict=True)) for side in (-0.5, 0.5)
        )
        return cls(low=low, high=high, pitch=pitch, yaw=yaw)  # type: ignore[arg-type]

    @classmethod
    def ramp(
        cls,
        start: tuple[float, float],
        end: tuple[float, float],
        width: float,
        thickness: float = 1.0,
    ) -> "Box":
        """A slope along x: its upper face leads from one x and z to another, further ahead [m].

        Y = 0 is its middle.

        Raises:
            ConfigError: the end is not ahead of the start.
        """
        ahead, up = end[0] - start[0], end[1] - start[1]
        if not ahead > 0.0:
            raise ConfigError(
                f"a ramp leads from x = {start[0]} to x = {end[0]} m: its end must be ahead of its "
                "start"
            )
        length = math.hypot(ahead, up)
        center_x = 0.5 * (start[0] + end[0] + thickness * up / length)
        center_z = 0.5 * (start[1] + end[1] - thickness * ahead / length)
        return cls.at(
            (center_x, 0.0, center_z), (length, width, thickness), pitch=-math.atan2(up, ahead)
        )

    @property
    def is_level(self) -> bool:
        """True where its edges are along the axes of the world."""
        return self.pitch == 0.0 and self.yaw == 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Boxes:
    """Boxes as arrays; with a leading dimension each robot has its own."""

    center: BoxVectors
    """World frame [m], shape (..., n, 3)."""
    half_size: BoxVectors
    """Half edge lengths [m], shape (..., n, 3)."""
    turn: BoxAngles | None = None
    """Pitch and yaw [rad], shape (..., n, 2); None where all are level, which is less work."""

    @classmethod
    def of(cls, boxes: Sequence[Box]) -> "Boxes":
        """Boxes as numpy arrays, of a list of `Box`."""
        low, high = (
            np.array([getattr(box, side) for box in boxes]).reshape(-1, 3)
            for side in ("low", "high")
        )
        turn = (
            None
            if all(box.is_level for box in boxes)
            else np.array([(box.pitch, box.yaw) for box in boxes])
        )
        return cls(center=0.5 * (high + low), half_size=0.5 * (high - low), turn=turn)

    @classmethod
    def from_tables(cls, tables: Sequence[Mapping[str, object]]) -> "Boxes":
        """Boxes as numpy arrays, of those of a run log: `center` and full `size` [m],
        `pitch` and `yaw` [rad] where they are not 0.
        """
        center, size = (
            np.array([t[key] for t in tables], dtype=np.float64).reshape(-1, 3)
            for key in ("center", "size")
        )
        turn = np.array(
            [[t.get("pitch", 0.0), t.get("yaw", 0.0)] for t in tables], dtype=np.float64
        ).reshape(-1, 2)
        return cls(center=center, half_size=0.5 * size, turn=turn if turn.any() else None)

    def to_tables(self) -> list[dict[str, object]]:
        """Returns what `from_tables` reads, of numpy arrays without leading dimensions."""
        rows = zip(
            self.center.tolist(), (2.0 * self.half_size).tolist(), self.angles.tolist(), strict=True
        )
        return [
            {"center": c, "size": s} | ({"pitch": a[0], "yaw": a[1]} if any(a) else {})
            for c, s, a in rows
        ]

    @property
    def angles(self) -> BoxAngles:
        """Pitch and yaw [rad], shape (..., n, 2)."""
        return (
            namespace(self.half_size).zeros_like(self.half_size[..., :2])
            if self.turn is None
            else self.turn
        )

    @property
    def quaternion(self) -> BoxQuaternions:
        """Box to world (w, x, y, z), shape (..., n, 4)."""
        sp, cp, sy, cy = self._sines(0.5)
        return namespace(sp).stack([cp * cy, -sp * sy, sp * cy, cp * sy], -1)

    @property
    def rotation(self) -> BoxRotations:
        """Box to world, shape (..., n, 3, 3)."""
        sp, cp, sy, cy = self._sines(1.0)
        xp = namespace(sp)
        entries = [cy * cp, -sy, cy * sp, sy * cp, cy, sy * sp, -sp, 0.0 * sp, cp]
        return xp.reshape(xp.stack(entries, -1), (*sp.shape, 3, 3))

    @property
    def extent(self) -> BoxVectors:
        """How far each reaches from its centre along the axes of the world [m],
        shape (..., n, 3).
        """
        if self.turn is None:
            return self.half_size
        return (namespace(self.half_size).abs(self.rotation) @ self.half_size[..., None])[..., 0]

    @property
    def top_ends(self) -> Array:
        """Where the upper face of each begins and ends along the world's x [m],
        shape (2, ..., n).
        """
        xp, half = namespace(self.half_size), self.rotation[..., 0, :] * self.half_size
        middle, reach = self.center[..., 0] + half[..., 2], xp.sum(xp.abs(half[..., :2]), axis=-1)
        return xp.stack([middle - reach, middle + reach])

    def of_robot(self, robot: int | Array) -> "Boxes":
        """Boxes of one robot of a batch, without the leading dimension;
        of several, by an array of their indices.
        """
        turn = None if self.turn is None else self.turn[robot]
        return Boxes(center=self.center[robot], half_size=self.half_size[robot], turn=turn)

    def like(self, array: Array) -> "Boxes":
        """A copy of the boxes in the library, dtype and device of `array`."""
        xp = namespace(array)

        def converted(value: Array | None) -> Array | None:
            return (
                None if value is None else xp.asarray(value, dtype=array.dtype, device=array.device)
            )

        return Boxes(
            center=converted(self.center),
            half_size=converted(self.half_size),
            turn=converted(self.turn),
        )

    def height_at(self, x: Array, y: Array) -> Array:
        """The highest point of any box above or below a place.

        Exact, and an edge is part of its box.

        Beyond the rectangle around all boxes its rim goes on; where there is no box within it, the
        lowest underside.

        Args:
            x: World x [m], of the library and dtype of the boxes, shape (..., points).
            y: World y [m], the same shape.

        Returns:
            [m], shape (..., points).
        """
        xp = namespace(x)
        low, high = self.center - self.extent, self.center + self.extent
        place = [
            xp.clip(
                value,
                xp.min(low[..., i], axis=-1)[..., None],
                xp.max(high[..., i], axis=-1)[..., None],
            )
            for i, value in enumerate((x, y))
        ]
        top = self._tops(
            *(value[..., None] - self.center[..., None, :, i] for i, value in enumerate(place))
        )
        floor = xp.min(low[..., 2], axis=-1)[..., None]
        return xp.maximum(xp.max(top, axis=-1), floor)

    def covers(self, x: float, y: float) -> bool:
        """True where any box lies above or below a place [m].

        Of numpy arrays without leading dimensions.
        """
        top = self._tops(x - self.center[None, :, 0], y - self.center[None, :, 1])
        return bool(np.isfinite(top).any())

    def _tops(self, x: Array, y: Array) -> Array:
        """Upper end of each box over places relative to its centre, -inf beside it.

        Shapes (..., points, n).
        """
        xp = namespace(x)
        slack = ROUNDING * float(xp.finfo(x.dtype).eps)
        half = self.half_size[..., None, :, :]
        never = xp.full_like(x, -math.inf)
        if self.turn is None:
            covered = (xp.abs(x) <= half[..., 0] + slack) & (xp.abs(y) <= half[..., 1] + slack)
            return xp.where(covered, self.center[..., None, :, 2] + half[..., 2], never)
        sine, cosine, sine_yaw, cosine_yaw = (value[..., None, :] for value in self._sines(1.0))
        ahead, aside = cosine_yaw * x + sine_yaw * y, cosine_yaw * y - sine_yaw * x
        # upright line through the place: (cos ahead - sin z) between the ends, (sin ahead + cos z)
        # between the faces
        low_x, high_x = _between(-sine, cosine * ahead, half[..., 0], slack)
        low_z, high_z = _between(cosine, sine * ahead, half[..., 2], slack)
        low, high = xp.maximum(low_x, low_z), xp.minimum(high_x, high_z)
        covered = (xp.abs(aside) <= half[..., 1] + slack) & (low <= high + slack)
        return xp.where(covered, self.center[..., None, :, 2] + high, never)

    def _sines(self, share: float) -> tuple[Array, ...]:
        """Sine and cosine of that share of the pitch, and of the yaw, each of shape (..., n)."""
        xp, turn = namespace(self.half_size), share * self.angles
        return (
            xp.sin(turn[..., 0]),
            xp.cos(turn[..., 0]),
            xp.sin(turn[..., 1]),
            xp.cos(turn[..., 1]),
        )


def _between(slope: Array, offset: Array, half: Array, slack: float) -> tuple[Array, Array]:
    """Least and greatest z with |slope z + offset| <= half.

    Nothing or everything where the slope is none.
    """
    xp = namespace(offset)
    is_upright = xp.abs(slope) < UPRIGHT
    safe = xp.where(is_upright, xp.ones_like(slope), slope)
    ends = (-half - offset) / safe, (half - offset) / safe
    anywhere = xp.where(
        xp.abs(offset) <= half + slack,
        xp.full_like(offset, math.inf),
        xp.full_like(offset, -math.inf),
    )
    low = xp.where(is_upright, -anywhere, xp.minimum(*ends))
    return low, xp.where(is_upright, anywhere, xp.maximum(*ends))
