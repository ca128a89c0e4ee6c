"""Where a planner in a roll-out gets its heights from."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.grid import HeightGrid
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.sim.state import PlantState
from saltus.states import RobotStates
from saltus.terrain.stack import TerrainStack


class HeightSource(Protocol):
    """Terrain profiles for a batch of robots, asked for once a policy step, from step 0 on and without gaps."""

    def heights(self, states: RobotStates, truth: PlantState, fresh: NDArray[np.bool_]) -> Floats:
        """Terrain relative to the base on the grid of the robots' setups.

        Args:
            states: What the robots know.
            truth: What is; a predictor renders its images from it and reads nothing else of it.
            fresh: Robots that were just put back to the start, bool, shape (n,): their hidden states are void.

        Returns:
            [m], shape (n, points).
        """
        ...


class TrueHeights:
    """The terrain itself, read with a shift that stays the same for the whole trial.

    Args:
        terrains: Terrain of each robot.
        grid: Of the heights.
        shift_x: How far ahead of the right place the heights are read [m], shape (n,).
        shift_z: How much too high they come out [m], shape (n,).
    """

    def __init__(
        self,
        terrains: TerrainStack,
        grid: HeightGrid,
        shift_x: Floats | float = 0.0,
        shift_z: Floats | float = 0.0,
    ) -> None:
        count = len(terrains.terrains)
        self._terrains, self._grid = terrains, grid
        self._x = np.broadcast_to(shift_x, (count,))
        self._z = np.broadcast_to(shift_z, (count,))[:, None]

    def heights(self, states: RobotStates, truth: PlantState, fresh: NDArray[np.bool_]) -> Floats:
        """Reads the terrain on the grid of each robot; shape (n, grid.size)."""
        del states, fresh
        _, _, yaw = roll_pitch_yaw(rotation_matrix(truth.quaternion_base_in_world))
        position = truth.position_base_in_world
        points = self._grid.points_in_world(position, yaw, ahead=self._x)
        heights: Floats = self._terrains.height_at(*points) - position[:, 2:] + self._z
        return heights
