"""Where a planner in a loop gets its heights from."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Array, Floats
from saltus.effects.heightmap_shift import refuse_shift
from saltus.grid import HeightGrid
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.setup import Setup
from saltus.sim.plant_state import PlantState
from saltus.states import ProprioceptionArrays
from saltus.terrain.terrain_stack import TerrainStack
from saltus.wire.messages import Heightmap, HeightmapStatus

TRUE_MODEL = "true"
"""Name of a model in the messages of heights that come from no network but are the ground
itself."""


class HeightSource(Protocol):
    """Terrain profiles for a batch of robots, asked for once a policy step,
    from step 0 on and without gaps.
    """

    def heights(
        self, states: ProprioceptionArrays, truth: PlantState, fresh: NDArray[np.bool_]
    ) -> Floats:
        """Terrain relative to the base on the grid of the robots' setups.

        Args:
            states: What the robots know.
            truth: What is; a predictor renders its images from it and reads nothing else of it.
            fresh: Robots that were just put back to the start, bool, shape (n,): their hidden
                states are void.

        Returns:
            [m], shape (n, points).
        """
        ...


class AnyTerrain(Protocol):
    """A terrain, or one for each robot of a batch."""

    def height_at(self, x: Array, y: Array) -> Array:
        """Height at places in the world [m]; shapes (..., m)."""
        ...


def true_heights(
    ground: AnyTerrain,
    position: Array,
    quaternion: Array,
    grid: HeightGrid,
    ahead: Array | float = 0.0,
) -> Array:
    """The ground relative to the base [m], numpy or torch.

    Shapes (..., 3), (..., 4) -> (..., grid.size).

    It is read `ahead` of the right place, see `HeightGrid.points_in_world`.
    """
    _, _, yaw = roll_pitch_yaw(rotation_matrix(quaternion))
    return ground.height_at(*grid.points_in_world(position, yaw, ahead)) - position[..., 2:]


def true_heightmap(
    x: Sequence[float] | Floats,
    y: Sequence[float] | Floats,
    height: Sequence[float] | Floats,
    *,
    time_ns: int,
    step: int,
) -> Heightmap:
    """The message of a service that knows the ground: heights as they are, sure, and new.

    Args:
        x: Rows of their grid [m].
        y: Its columns [m].
        height: Relative to the base [m], shape (rows * columns,).
        time_ns: Of the state that is answered.
        step: The same.
    """
    heights = np.asarray(height, np.float64)
    return Heightmap(
        time_ns=time_ns, step=step, x=np.asarray(x), y=np.asarray(y), height=heights,
        half_width_90=np.zeros_like(heights), status=HeightmapStatus.OK, depth_age_s=0.0,
        frame_id=-1, model_id=TRUE_MODEL, seen_share=1.0, age_s=np.zeros_like(heights),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueHeights:
    """The terrains themselves, read with a shift that stays the same for the whole trial."""

    terrains: TerrainStack
    grid: HeightGrid
    shift_x: Floats | float = 0.0
    """How far ahead of the right place heights are read [m], shape (n,)."""
    shift_z: Floats | float = 0.0
    """How much too high they come out [m], shape (n, 1)."""

    def heights(
        self, states: ProprioceptionArrays, truth: PlantState, fresh: NDArray[np.bool_]
    ) -> Floats:
        """Reads the terrain on the grid of each robot; shape (n, grid.size)."""
        del states, fresh
        pose = truth.position_base_in_world, truth.quaternion_base_in_world
        return np.asarray(
            true_heights(self.terrains, *pose, self.grid, self.shift_x) + self.shift_z
        )


HeightsFactory = Callable[[Sequence[Setup]], HeightSource]
"""Makes a source of heights for a batch of robots of one kind."""


def shifted_heights(setups: Sequence[Setup]) -> HeightSource:
    """True heights with the shift of each trial."""
    x, z = np.array([setup.trial.height_shift(setup.profile) for setup in setups]).T
    return replace(_true_heights(setups), shift_x=x, shift_z=z[:, None])


def exact_heights(setups: Sequence[Setup]) -> HeightSource:
    """True heights as they are; `ConfigError` for a profile that shifts them."""
    refuse_shift(setups[0].profile.heightmap, "a planner that is given them as they are")
    return _true_heights(setups)


def _true_heights(setups: Sequence[Setup]) -> TrueHeights:
    return TrueHeights(
        terrains=TerrainStack([setup.terrain for setup in setups]), grid=setups[0].grid
    )
