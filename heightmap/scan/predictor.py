"""Heights around one robot as they are deployed: the map in numpy, the network in ONNX Runtime."""

from pathlib import Path

import numpy as np

from saltus.arrays import Floats, Singles
from saltus.errors import ConfigError, ModelError
from saltus.grid import HeightGrid
from saltus.heightmap.scan.cells import places, sampled
from saltus.heightmap.scan.elevation import Measurement, Pose, advanced, new_map
from saltus.heightmap.scan.planes import MEASURED, MEMORY, NUMBERS, Heights, Inputs, inputs_of, remembered
from saltus.heightmap.scan.settings import MapSettings
from saltus.model_file import ModelFile

FORMAT = "saltus scan 1"
INPUTS = ("filled", "measured", "memory", "numbers")
OUTPUTS = ("height", "half_width")
_NAMES = {"measured": MEASURED, "memory": MEMORY, "numbers": NUMBERS}


class ScanNetwork:
    """The network of a model file.

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
            raise ModelError(f"model {path} does not fit: its format is {found!r}, this program needs {FORMAT!r}")
        for name, known in _NAMES.items():
            if tuple(file.field(name)) != known:
                raise ModelError(f"model {path} does not fit: its '{name}' are other planes: export it again")
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

    def __call__(self, inputs: Inputs) -> tuple[Singles, Singles]:
        """Height above `inputs.filled` and half-width [m], each of shape (batch, side, side)."""
        fed = {name: np.ascontiguousarray(getattr(inputs, name), np.float32) for name in self._inputs}
        height, half_width = self._session.run(list(OUTPUTS), fed)
        return height, half_width


class ScanPredictor:
    """Heights of the ground around one robot, from images of any depth cameras and somebody's odometry.

    `see` takes each image once; `heights` answers for any grid, at every state.
    """

    def __init__(self, network: ScanNetwork) -> None:
        self._network = network
        self._map = new_map(1, network.settings, np.zeros(1, np.float32))
        self._told: Heights | None = None

    @property
    def images(self) -> int:
        """How many images the map was made from since the last `reset`."""
        return int(self._map.images[0])

    def reset(self) -> None:
        """Forgets everything: the robot was carried elsewhere, or its odometry jumped."""
        self._map = new_map(1, self._network.settings, np.zeros(1, np.float32))
        self._told = None

    def see(self, measured: Measurement, now_s: float) -> None:
        """Takes an image; arrays of `measured` are numpy's, of one robot, in single precision."""
        state, around = advanced(self._map, measured, self._network.settings)
        now = np.full(1, now_s, np.float32)
        height, half_width = self._network(inputs_of(state, around, now, measured.body_height))
        self._told = Heights(around.filled + height, half_width)
        self._map = remembered(state, self._told)

    def heights(self, pose: Pose, yaw: float, grid: HeightGrid) -> tuple[Floats, Floats]:
        """Height relative to the base and half-width [m] of each point of a grid, each of shape (points,).

        Args:
            pose: Of the base by the same odometry, now.
            yaw: Of the base by the odometry [rad].
            grid: In the base's yaw frame.

        Raises:
            ModelError: no image has come yet.
        """
        if self._told is None:
            raise ModelError("no image has come yet: heights are told from the first one on")
        base = pose.position + self._map.correction
        x, y = grid.points_in_world(base[0, :2].astype(np.float64), np.asarray(yaw))
        place = places(np.stack([x, y], -1)[None], self._map.corner, self._network.settings)
        height = sampled(self._told.height, place)[0] - base[0, 2]
        return np.asarray(height, np.float64), np.asarray(sampled(self._told.half_width, place)[0], np.float64)
