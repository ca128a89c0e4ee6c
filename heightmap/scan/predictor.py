"""Heights around one robot as they are deployed: the map in numpy, the network in ONNX Runtime."""

import json
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from saltus.arrays import Floats, Singles
from saltus.errors import ConfigError, ModelError
from saltus.grid import HeightGrid
from saltus.heightmap.scan.cells import fine_cell_positions, sample_bilinear
from saltus.heightmap.scan.elevation import (
    NEVER_S,
    ElevationMap,
    MapUpdate,
    OdometryPoses,
    advance_map,
    new_map,
)
from saltus.heightmap.scan.network_inputs import (
    MEASURED,
    MEMORY,
    NUMBERS,
    REACH_M,
    MapHeights,
    ScanInputs,
    inputs_of,
    remember_told,
)
from saltus.heightmap.scan.prism import Prism
from saltus.heightmap.scan.settings import MapSettings
from saltus.model_file import ModelFile

FORMAT = "saltus scan 1"
INPUTS = ("filled", "measured", "memory", "numbers")
OUTPUTS = ("height", "half_width")
FARTHEST_M = 2.0 * REACH_M
"""From a filled height no plausible one is farther, and no half-width is larger."""
_NAMES = {"measured": MEASURED, "memory": MEMORY, "numbers": NUMBERS}


class GridHeights(NamedTuple):
    """Heights, half-widths of their intervals and what was seen, at the points of a grid, each of
    shape (points,).
    """

    height: Floats
    """Relative to the base [m]."""
    half_width: Floats
    """Half of the 90 % interval [m]."""
    seen_s: Floats
    """Exposure of the last image with a point within 3 cm [s].

    Minus infinity where there was none.
    """


class _Known(NamedTuple):
    """Outcome of the newest image; what states ask for again and again is made once."""

    state: ElevationMap
    told: Singles | None
    """Heights and half-widths by the network [m], shape (2, side, side)."""
    shown: Singles
    """Heights of the map where an image showed them, else NaN [m], shape (1, side, side)."""
    seen_s: Singles
    """When a point last fell into each cell, or one beside it [s], shape (side, side)."""
    prism: Prism | None
    """Profile of ground that is the same to the side; None where it is not, or nobody asks."""

    @classmethod
    def of(cls, state: ElevationMap, told: Singles | None, *, extends: bool = False) -> Self:
        """From a map and what the network told of it; `extends` as `ScanPredictor` takes it."""
        seen = state.seen_s > 0.5 * NEVER_S
        shown = np.where(seen, state.height, np.nan)
        newest = state.seen_s[0]
        for _ in range(2):  # along columns, then along rows
            beside = newest.copy(order="K")
            np.maximum(beside[1:], newest[:-1], out=beside[1:])
            np.maximum(beside[:-1], newest[1:], out=beside[:-1])
            newest = beside.T
        prism = Prism.of(told[0], seen[0]) if extends and told is not None else None
        return cls(state, told, shown, newest, prism)


def is_scan(path: Path) -> bool:
    """True where a file says that it is a network of any grid;
    `ModelError` where it is unreadable.
    """
    return ModelFile(path).metadata.get("format") == json.dumps(FORMAT)


class ScanNetwork:
    """The scan's network as a model file holds it, with its description.

    Attributes:
        model_id: Of the file.
        settings: Of the map that feeds it.

    Raises:
        ModelError: the file cannot be read, or does not fit this program; the message names what
            differs.
    """

    def __init__(self, path: Path) -> None:
        file = ModelFile(path)
        if (found := file.field("format")) != FORMAT:
            raise ModelError(
                f"model {path} does not fit: its format is {found!r}, this program needs {FORMAT!r}"
            )
        for name, known in _NAMES.items():
            if tuple(file.field(name)) != known:
                raise ModelError(
                    f"model {path} does not fit: its '{name}' are other planes: export it again"
                )
        try:
            self.settings = MapSettings.from_toml(file.field("map"))
        except ConfigError as error:
            raise ModelError(f"model {path} does not fit: its map: {error}") from error
        self.model_id = file.model_id
        self._session = file.session
        wanted = sorted(i.name for i in self._session.get_inputs())
        self._inputs = [name for name in INPUTS if name in wanted]
        if wanted != sorted(self._inputs):
            raise ModelError(f"model {path} does not fit: its inputs are {', '.join(wanted)}")

    def __call__(self, inputs: ScanInputs) -> tuple[Singles, Singles]:
        """Height above `inputs.filled` and half-width [m], each of shape (batch, side, side)."""
        fed = {
            name: np.ascontiguousarray(getattr(inputs, name), np.float32) for name in self._inputs
        }
        height, half_width = self._session.run(list(OUTPUTS), fed)
        return height, half_width


class ScanPredictor:
    """Heights of the ground around one robot,
    from images of any depth cameras and somebody's odometry.

    `see` takes each image once; `heights` answers for any grid, at every state, also from another
    thread while an image is taken in: then it tells what was known before.

    Args:
        network: Tells heights and half-widths.
        settings: Of the map; None: those with which the network was trained. Others of the same
            window are those of a robot whose odometry is unlike that of the training.
        extends: Where no image showed the ground, it is told as beside it, if all that was seen is
            the same to the side (`Prism`).
    """

    def __init__(
        self,
        network: ScanNetwork,
        settings: MapSettings | None = None,
        *,
        extends: bool = False,
    ) -> None:
        self._network, self._settings = network, settings or network.settings
        self._extends = extends
        self.reset()

    @property
    def images(self) -> int:
        """How many images the map was made from since the last `reset`."""
        return int(self._known.state.images[0])

    @property
    def correction(self) -> Singles:
        """Added to the odometry's positions, by images and feet [m], shape (3,)."""
        return self._known.state.correction[0]

    def reset(self) -> None:
        """Forgets everything: the robot was carried elsewhere, or its odometry jumped."""
        self._known = _Known.of(new_map(1, self._settings, np.zeros(1, np.float32)), None)

    def see(self, measured: MapUpdate, now_s: float) -> bool:
        """Takes an image; arrays of `measured` are numpy's, of one robot, in single precision.

        Returns:
            False where the network's answer was not plausible: the image is then forgotten.
        """
        state, around = advance_map(self._known.state, measured, self._settings)
        now = np.full(1, now_s, np.float32)
        height, half_width = self._network(inputs_of(state, around, now, measured))
        # no comparison with NaN is true, so that this also asks for finite numbers
        if not (
            np.abs(height).max() <= FARTHEST_M
            and half_width.min() > 0.0
            and half_width.max() <= FARTHEST_M
        ):
            return False
        told = MapHeights(around.filled + height, half_width)
        self._known = _Known.of(
            remember_told(state, told), np.concatenate(told), extends=self._extends
        )
        return True

    def heights(self, pose: OdometryPoses, yaw: float, grid: HeightGrid) -> tuple[Floats, Floats]:
        """Height relative to the base and half-width [m] of each point of a grid,
        each of shape (points,).

        Args:
            pose: Of the base by the same odometry, now.
            yaw: Of the base by the odometry [rad].
            grid: In the base's yaw frame.

        Raises:
            ModelError: no image has come yet.
        """
        found = self.ground(pose, yaw, grid)
        return found.height, found.half_width

    def ground(self, pose: OdometryPoses, yaw: float, grid: HeightGrid) -> GridHeights:
        """The same as `heights`, and when each point was last seen."""
        state, told, _, newest, prism = self._known
        if told is None:
            raise ModelError("no image has come yet: heights are told from the first one on")
        base = pose.position + state.correction
        x, y = grid.points_in_world(base[0, :2].astype(np.float64), np.asarray(yaw))
        place = fine_cell_positions(np.stack([x, y], -1)[None], state.corner, self._settings)
        height, half_width = np.asarray(sample_bilinear(told, place), np.float64)
        seen_s = _last_seen(newest, place[0])
        if prism is not None:
            beside, beside_width = prism.at(place[0])
            is_told = np.isinf(seen_s) & np.isfinite(beside)
            height = np.where(is_told, beside, height)
            half_width = np.where(is_told, beside_width, half_width)
        return GridHeights(height - base[0, 2], half_width, seen_s)

    def above(self, pose: OdometryPoses, points: Singles) -> Floats:
        """Height of the ground that images showed above points, by the map alone [m], shape (n,).

        NaN where no image showed it.

        Args:
            pose: Of the base by the same odometry, now.
            points: In the base frame [m], shape (n, 3).
        """
        state, _, shown, _, _ = self._known
        there = points @ pose.rotation[0].T + pose.position[0] + state.correction[0]
        place = fine_cell_positions(there[None, :, :2], state.corner, self._settings)
        return np.asarray(sample_bilinear(shown, place)[0] - there[:, 2], np.float64)


def _last_seen(seen_s: Singles, place: Floats) -> Floats:
    """Times of `_Known.seen_s` at places [s]; minus infinity where none ever was seen."""
    cell = np.floor(place + 0.5).astype(np.int64)
    row, column = cell.clip(0, len(seen_s) - 1).T
    newest = seen_s[row, column].astype(np.float64)
    inside = ((cell >= 0) & (cell < len(seen_s))).all(-1)
    return np.where(inside & (newest > 0.5 * NEVER_S), newest, -np.inf)
