"""Heights that the service of each robot of a loop would give:
rendered images, late as in each trial, one network.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Singles
from saltus.effects.heightmap_shift import refuse_shift
from saltus.effects.signals import DepthImage
from saltus.grid import HeightGrid
from saltus.heightmap.data.robot_cameras import robot_cameras
from saltus.heightmap.data.scan_heights import ScanHeights
from saltus.heightmap.scan.predictor import ScanNetwork, is_scan
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.proprioception_vector import proprioception_of_states
from saltus.heightmap.service.sight import Network, Sight
from saltus.render.stereo.camera import StereoConfig
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.setup import Setup
from saltus.sim.plant_state import PlantState
from saltus.states import ProprioceptionArrays
from saltus.used_networks import model_path


@dataclass(frozen=True, kw_only=True)
class PredictedHeightsFactory:
    """Makes `PredictedHeights` for a batch; can be sent to another process."""

    model: Path | None = None
    """ONNX file; by default the one that is shipped for the robot."""

    def __call__(self, setups: Sequence[Setup]) -> "PredictedHeights | ScanHeights":
        """A source of heights for one batch; errors of stereo matching are made by the fast chain.

        Raises:
            ConfigError: the profile shifts true heights.
            ModelError: the model cannot be used.
        """
        return predicted_heights(model_path("heightmap", self.model, setups[0].robot.name), setups)


def load_predictor(
    path: Path, robot: Robot, grid: HeightGrid | None = None
) -> HeightmapNetwork | ScanNetwork:
    """The network of a file, which says itself whether it is of the line or of the scan.

    Args:
        path: An ONNX file.
        robot: Whose heights are wanted.
        grid: Where; None where the model says it. A scan has heights everywhere.

    Raises:
        ModelError: the file cannot be read, or fits neither robot nor program.
    """
    if is_scan(path):
        return ScanNetwork(path)
    return HeightmapNetwork(robot, path, grid)


def predicted_heights(
    path: Path,
    setups: Sequence[Setup],
    errors: StereoConfig | None = None,
    rngs: Sequence[np.random.Generator] | None = None,
) -> "PredictedHeights | ScanHeights":
    """Heights by the network of a file; `errors` and `rngs` are those of `robot_cameras`.

    Raises:
        ConfigError: the profile shifts true heights.
        ModelError: the model cannot be used.
    """
    network = load_predictor(path, setups[0].robot, setups[0].grid)
    if isinstance(network, ScanNetwork):
        return ScanHeights(network, setups, errors, rngs)
    return PredictedHeights(network, setups, errors, rngs)


class LeggedNetwork(Network, Protocol):
    """A line's heightmap network that takes the joints of robots with these legs."""

    legs: LegKinematics


class PredictedHeights:
    """Eyes, the links that carry their images, and the `Sight` of a batch,
    see `saltus.loop.heights.HeightSource`.

    A robot gets the very images, at the very steps, that the camera process gives to it in
    lockstep. The network runs on all robots in one call. `errors` and `rngs` are those of
    `robot_cameras`.
    """

    def __init__(
        self,
        network: LeggedNetwork,
        setups: Sequence[Setup],
        errors: StereoConfig | None = None,
        rngs: Sequence[np.random.Generator] | None = None,
    ) -> None:
        refuse_shift(setups[0].profile.heightmap, "a predictor")
        self._network = network
        self._eyes, self._images = robot_cameras(setups, errors, rngs)
        self._sight = Sight(network, self._images.in_hand.depth)
        self.given: DepthImage | None = None
        """The images given out at this step [mm], shape (n, 48, 16); None where it was not the
        time."""

    def heights(
        self, states: ProprioceptionArrays, truth: PlantState, fresh: NDArray[np.bool_]
    ) -> Floats:
        """One tick of all services; shape (n, points)."""
        self.given = self._eyes.expose(truth, states.step, fresh)
        arrived = self._images.step(self.given, states.time_s, fresh)
        features = self._features(states)
        return np.asarray(
            self._sight.step(arrived, self._images.in_hand, states.time_s, features, fresh),
            np.float64,
        )

    def _features(self, states: ProprioceptionArrays) -> Singles:
        """Inputs of the network about the robots besides their images, shape (n, some)."""
        vectors: Singles = proprioception_of_states(states, self._network.legs)
        return vectors

    @property
    def half_width_90(self) -> Floats:
        """Half of the 90 % interval of the newest heights [m], shape (n, points)."""
        return np.asarray(self._sight.half_width_90, np.float64)

    @property
    def captured_s(self) -> Floats:
        """Capture time of the image in use of each robot [s], shape (n,);
        minus infinity before the first.
        """
        return np.asarray(self._sight.captured_s)
