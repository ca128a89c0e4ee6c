"""The exported network behind ONNX Runtime: checked when loaded, called once per tick."""

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saltus import depth
from saltus.arrays import Floats, Singles
from saltus.errors import ModelError
from saltus.grid import HeightGrid, grid_metadata
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.heightmap.service.quantiles import INTERVAL90
from saltus.heightmap.service.sight import NetworkOutputs
from saltus.model_file import ModelFile, Session
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot

FORMAT = "saltus-heightmap-1"
INPUTS = ("image", "age", "new", "proprioception", "hidden")
OUTPUTS = ("height", "std", "hidden_out")
KEPT_CALLS = (
    32  # sizes of batches, 8 kB a robot: as many as one process has robots, each with two models
)
MOUNT_POSITION_ERROR_M, MOUNT_PITCH_ERROR = 0.01, np.deg2rad(1.5)
"""Distance of a camera from the place it was made for that is allowed, along each axis and in pitch
[rad]: a printed mount and its screws. Training data are drawn with it, or with more
(`saltus.heightmap.data.randomisation`)."""
_TOLERANCE = 1e-6  # of a number that went through text


def camera_metadata(robot: Robot) -> dict[str, object]:
    """The model's camera, on a robot; a model that was made for another place of it is refused."""
    return {
        **asdict(depth.MODEL_CAMERA),
        "range_m": depth.RANGE_M,
        "position_m": robot.camera_position.tolist(),
        "pitch_rad": robot.camera_pitch,
        **{f"{name}_rad": angle for name, angle in _other_angles(robot).items() if angle},
    }


def _other_angles(robot: Robot) -> dict[str, float]:
    """Roll and yaw of the camera [rad].

    Files leave out those that are 0, as those of before knew none.
    """
    return {"roll": robot.camera_roll, "yaw": robot.camera_yaw}


class HeightmapNetwork:
    """A model file in ONNX Runtime, on one thread that sleeps between calls.

    To be called from one thread.

    Args:
        robot: Whose heights are wanted.
        path: Of the file.
        grid: Where they are wanted; by default where the model tells them.

    Raises:
        ModelError: the file is unreadable, or does not fit the robot or this program; the message
            names the field.
    """

    def __init__(self, robot: Robot, path: Path, grid: HeightGrid | None = None) -> None:
        file = ModelFile(path)
        self.robot, self.legs = robot, LegKinematics(robot)
        self.model_id = file.model_id
        self._session = file.session
        self.grid = grid or file.grid
        self.x = self.grid.points[:, 0]
        """Place of each point ahead of the base [m], shape (points,)."""
        _check_metadata(file, robot, self.grid)
        self.points = self.grid.size
        self.hidden_size = _checked_hidden_size(file, self.points)
        self.warmup_frames = int(file.field("warmup_frames"))
        self._calls: dict[int, _Call] = {}

    def tick(
        self,
        image: Singles,
        age_s: Floats,
        new: NDArray[np.bool_],
        features: Singles,
        hidden: Singles,
    ) -> NetworkOutputs:
        """Runs one tick of many robots; see `saltus.heightmap.service.sight.NetworkInputs`."""
        return self._call(len(image)).run((image, age_s, new, features, hidden))

    def _call(self, robots: int) -> "_Call":
        if robots not in self._calls:
            if len(self._calls) >= KEPT_CALLS:
                self._calls.clear()
            self._calls[robots] = _Call(self._session, robots, self.hidden_size, self.points)
        return self._calls[robots]


class _Call:
    """Calls of the network for so many robots, in memory that is bound to it once:
    half the cost of arguments.

    What is returned of all outputs is one new array. After the network, whose weights fill the
    caches, each operation on arrays takes several times as long.
    """

    def __init__(self, session: Session, robots: int, hidden_size: int, points: int) -> None:
        shapes = _shapes(hidden_size, points)
        self._session, self._binding = session, session.io_binding()
        self._inputs = [np.zeros((robots, *shapes[name]), np.float32) for name in INPUTS]
        for name, array in zip(INPUTS, self._inputs, strict=True):
            self._binding.bind_input(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        self._outputs = [np.zeros((robots, *shapes[name]), np.float32) for name in OUTPUTS]
        for name, array in zip(OUTPUTS, self._outputs, strict=True):
            self._binding.bind_output(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        sizes = [array.shape[1] for array in self._outputs]
        factors = [INTERVAL90 if name == "std" else 1.0 for name in OUTPUTS]
        self._factors = np.repeat(np.array(factors, np.float32), sizes)

    def run(self, values: Iterable[ArrayLike]) -> NetworkOutputs:
        """Takes what `INPUTS` names."""
        for array, value in zip(self._inputs, values, strict=True):
            array[...] = value
        self._session.run_with_iobinding(self._binding)
        told = np.concatenate(self._outputs, axis=1)
        told *= self._factors
        return NetworkOutputs(told, self._outputs[0].shape[1])


def _shapes(hidden_size: Any, points: int) -> dict[str, list[Any]]:
    """Shapes of all inputs and outputs, without the dimension of robots."""
    return {
        "image": [2, depth.MODEL_CAMERA.height, depth.MODEL_CAMERA.width],
        "age": [],
        "new": [],
        "proprioception": [len(PROPRIOCEPTION)],
        "hidden": [hidden_size],
        "height": [points],
        "std": [points],
        "hidden_out": [hidden_size],
    }


def _check_metadata(file: ModelFile, robot: Robot, grid: HeightGrid) -> None:
    """Refuses a model whose meaning differs from what this program would feed and read."""
    camera, made_for = file.field("camera"), file.field("robot")
    if made_for != robot.name:
        raise ModelError(
            f"model {file.path} does not fit: its 'robot' is {made_for!r}, and heights are wanted "
            "for "
            f"{robot.name!r}. Train one for it (saltus heightmap collect cpu --loop.learned 0 "
            "--loop.robot ...), or "
            "take 187 heights of any robot (saltus heightmap serve --grid scan); true heights need "
            "no model (saltus "
            "policy eval --planner scripted): docs/robots.md"
        )
    expected: dict[str, object] = {
        "format": FORMAT,
        **grid_metadata(grid),
        "camera": camera_metadata(robot) | _mount(camera),
        "proprioception": list(PROPRIOCEPTION),
    }
    for name, wanted in expected.items():
        found = file.field(name)
        for where, left, right in _leaves(name, found, wanted):
            if not _same(left, right):
                raise ModelError(
                    f"model {file.path} does not fit: '{where}' is {left!r}, this program needs "
                    f"{right!r}"
                )
    _check_mount(file.path, camera, robot)
    for name, low, high in (("warmup_frames", 1, 500), ("nominal_delay_s", 0.0, 0.5)):
        found = file.field(name)
        if (
            isinstance(found, bool)
            or not isinstance(found, int | float)
            or not low <= found <= high
        ):
            raise ModelError(
                f"model {file.path} does not fit: '{name}' is {found!r}, expected {low} to {high}"
            )
    if not isinstance(file.field("warmup_frames"), int):
        raise ModelError(f"model {file.path} does not fit: 'warmup_frames' must be a whole number")


def _mount(camera: object) -> dict[str, object]:
    """Where a model's camera sat, as far as it says so: it is compared by itself."""
    known = camera if isinstance(camera, dict) else {}
    return {name: known[name] for name in ("position_m", "pitch_rad") if name in known}


def _check_mount(path: Path, camera: dict[str, Any], robot: Robot) -> None:
    """Refuses a model whose camera sat elsewhere than the robot's does,
    by more than training covers.
    """
    try:
        off = robot.camera_position - np.array(camera["position_m"], np.float64)
        turned = robot.camera_pitch - float(camera["pitch_rad"])
        aside = [
            abs(angle - float(camera.get(f"{name}_rad", 0.0)))
            for name, angle in _other_angles(robot).items()
        ]
    except (TypeError, ValueError):
        raise ModelError(
            f"model {path} does not fit: 'camera' does not say where it sits"
        ) from None
    if not (
        np.abs(off).max() <= MOUNT_POSITION_ERROR_M
        and max(abs(turned), *aside) <= MOUNT_PITCH_ERROR
    ):
        ahead, left, up = 100.0 * off
        steeper = f"{abs(np.rad2deg(turned)):.1f} deg {'more' if turned > 0.0 else 'less'} down"
        steeper += (
            f" and rolled or turned by {np.rad2deg(max(aside)):.1f} deg" if max(aside) > 0.0 else ""
        )
        raise ModelError(
            f"model {path} was made for a camera elsewhere: the robot's sits {ahead:+.1f} cm "
            f"ahead, {left:+.1f} cm to "
            f"the left and {up:+.1f} cm up of it, {steeper}, and training covers "
            f"{100.0 * MOUNT_POSITION_ERROR_M:g} cm and {np.rad2deg(MOUNT_PITCH_ERROR):.1f} deg; "
            "give one that was "
            "trained for this camera (--heightmap-model, see docs/tutorials/camera.md)"
        )


def _leaves(where: str, found: object, wanted: object) -> list[tuple[str, object, object]]:
    """Pairs of values to compare; a structure that differs is one unequal pair."""
    if isinstance(wanted, dict) and isinstance(found, dict) and wanted.keys() == found.keys():
        return [
            leaf for key in wanted for leaf in _leaves(f"{where}.{key}", found[key], wanted[key])
        ]
    if isinstance(wanted, list) and isinstance(found, list) and len(wanted) == len(found):
        pairs = enumerate(zip(found, wanted, strict=True))
        return [
            leaf for i, (left, right) in pairs for leaf in _leaves(f"{where}[{i}]", left, right)
        ]
    return [(where, found, wanted)]


def _same(found: object, wanted: object) -> bool:
    if isinstance(wanted, float) and isinstance(found, int | float):
        return abs(found - wanted) <= _TOLERANCE
    return type(found) is type(wanted) and found == wanted


def _checked_hidden_size(file: ModelFile, points: int) -> int:
    """Size of the hidden state; every input and output must be what the service feeds and reads."""
    given = {value.name: value.shape for value in file.session.get_inputs()}
    shapes = _shapes(next(iter(given.get("hidden", [])[1:]), None), points)
    file.check({name: shapes[name] for name in INPUTS}, {name: shapes[name] for name in OUTPUTS})
    return int(shapes["hidden"][0])
