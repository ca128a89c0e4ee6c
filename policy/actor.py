"""The learned policy as a planner: an ONNX file in ONNX Runtime, checked when loaded."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Reals
from saltus.errors import ConfigError, ModelError
from saltus.grid import HeightGrid
from saltus.loop.planner import Observation
from saltus.model_file import ModelFile
from saltus.plan import Plan
from saltus.policy.bounds import ACTIONS, ActionBounds, plan_from_values
from saltus.policy.policy_features import (
    PROPRIOCEPTION_SIZE,
    RECALLED,
    check_past_steps,
    feature_layout,
    next_past,
    policy_features,
    size_with,
    with_past,
)
from saltus.robots.robot import Robot
from saltus.wire.messages import MotionPlan
from saltus.wire.schemas import FIELDS

FORMAT = "saltus-policy-1"
_TOLERANCE = 1e-6  # of a number that went through text
_SAME_RANGE_M = 1e-4
"""Ranges of two models of one robot differ by so much: feet of published Go2s lie 2 mm beside the
end of the calf, or not, and its leg is 4 um longer then."""


class PolicyActor:
    """Plans for any batch of robots, with the interface of the scripted planner,
    by a file of `policy.training.export`.

    One thread that sleeps between calls. A plan follows from one observation, one heightmap, and,
    if the policy was trained to recall them, from the calls before: see `past_steps`.

    Raises:
        ModelError: the file is unreadable or made for another robot, features or actions; the
            message names which.
    """

    def __init__(self, robot: Robot, grid: HeightGrid, path: Path) -> None:
        file = ModelFile(path)
        self.model_id = file.model_id
        self._session = file.session
        _check(robot, grid, file)
        self._size = size_with(grid, _past_steps(file))
        self.past_steps = _past_steps(file)
        """Which earlier calls the policy recalls, 1 is the last one.

        None where it was trained without a past.
        """
        file.check({"features": [self._size]}, {"plan": [len(ACTIONS)]})
        self._bounds = ActionBounds(low=tuple(file.field("low")), high=tuple(file.field("high")))
        self._past = np.zeros((0, max(self.past_steps, default=0), RECALLED))
        self._latest = np.zeros((0, RECALLED))

    def step(
        self, observation: Observation, heights: Reals, fresh: NDArray[np.bool_] | bool = False
    ) -> Plan:
        """Plans the next 10 ms, within the bounds; see `saltus.policy.planner.Planner`."""
        vector = policy_features(observation, heights)
        if not self.past_steps:
            return plan_from_values(self.values(vector))
        batch = vector.shape[:-1]
        if self._latest.shape[:-1] != batch:  # others than before
            fresh, self._latest = True, np.zeros((*batch, RECALLED))
            self._past = np.zeros((*batch, *self._past.shape[-2:]))
        self._past = next_past(self._past, self._latest, vector, np.broadcast_to(fresh, batch))
        values = self.values(with_past(vector, self._past, self.past_steps))
        self._latest = np.concatenate(
            [vector[..., :PROPRIOCEPTION_SIZE], self._bounds.normalised(values)], axis=-1
        )
        return plan_from_values(values)

    def values(self, given: Reals) -> Floats:
        """Values of `ACTIONS`, shape (..., 10),
        for vectors of `saltus.policy.policy_features.with_past`, (..., some).
        """
        flat = np.ascontiguousarray(given.reshape(-1, self._size), dtype=np.float32)
        plan = np.asarray(self._session.run(["plan"], {"features": flat})[0], dtype=np.float64)
        return plan.reshape((*given.shape[:-1], len(ACTIONS)))


def _check(robot: Robot, grid: HeightGrid, file: ModelFile) -> None:
    """Refuses a policy that was made for other features,
    actions or limits than this program has.
    """
    expected = {"format": FORMAT, "features": feature_layout(grid), "actions": list(ACTIONS)}
    for name, value in expected.items():
        found = file.field(name)
        if found != value:
            raise ModelError(
                f"{file.path}: '{name}' is {found!r}, this program needs {value!r}: export the "
                "policy again"
            )
    made_for = file.field("robot")
    if made_for != robot.name:
        raise ModelError(
            f"{file.path}: it plans for the robot {made_for!r}, not for '{robot.name}': train a "
            "policy for this robot, "
            "or let rules plan (--planner scripted)"
        )
    if not file.grid.equals(grid):
        raise ModelError(
            f"{file.path}: 'grid_m' is not the grid of the heights that it would be given"
        )
    swing = _numbers(file, "swing_foot_z_range_m", 2)
    if np.abs(swing - robot.swing_foot_z).max() > _SAME_RANGE_M:
        raise ModelError(
            f"{file.path}: 'swing_foot_z_range_m' is {swing.tolist()}, the leg controller's is "
            f"{robot.swing_foot_z.tolist()}: train the policy again"
        )
    low, high = (_numbers(file, name, len(ACTIONS)) for name in ("low", "high"))
    _check_bounds(file.path, low, high)


def grid_of(path: Path) -> HeightGrid:
    """The grid of the heights that a policy is given; `ModelError` where the file is none."""
    return ModelFile(path).grid


def _past_steps(file: ModelFile) -> tuple[int, ...]:
    """Returns what the policy recalls; files that do not say recall nothing."""
    found = file.field("past_steps") if "past_steps" in file.metadata else []
    try:
        check_past_steps(tuple(found))
    except (TypeError, ConfigError) as error:
        raise ModelError(
            f"{file.path}: 'past_steps' is {found!r}: export the policy again"
        ) from error
    return tuple(found)


def _check_bounds(path: Path, low: Floats, high: Floats) -> None:
    """The leg controller must accept every plan within the policy's bounds."""
    fields = {field.name: field for field in FIELDS[MotionPlan]}
    scalars = [fields[name] for name in ACTIONS[:4]]
    allowed = [*scalars, *3 * [fields["foot_residual_front"]], *3 * [fields["foot_residual_rear"]]]
    for name, field, lowest, highest in zip(ACTIONS, allowed, low, high, strict=True):
        if not field.low <= lowest < highest <= field.high:
            raise ModelError(
                f"{path}: '{name}' goes from {lowest:g} to {highest:g}, the leg controller takes "
                f"{field.low:g} to "
                f"{field.high:g}"
            )


def _numbers(file: ModelFile, name: str, count: int) -> Floats:
    found = file.field(name)
    try:
        numbers = np.asarray(found, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ModelError(f"{file.path}: '{name}' is {found!r}, this program needs {count} numbers")
    return numbers
