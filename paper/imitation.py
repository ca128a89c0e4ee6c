"""The imitation baseline as it runs: a network that plans from images, without heights between.

Like the heightmap service it gets late images, and like the policy it knows what the robot knows of
itself. In a roll-out it stands where the predictor stands: its plan travels in the place of
heights, and a planner passes it on.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from paper.training import IMITATOR_FORMAT, IMITATOR_INPUTS, IMITATOR_OUTPUTS
from saltus.arrays import Floats, Reals, Singles
from saltus.errors import ModelError
from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.data.predicted import PredictedHeights
from saltus.heightmap.service.sight import NetworkOutputs
from saltus.loop.planner import Observation, observe
from saltus.model_file import ModelFile
from saltus.plan import Plan
from saltus.policy.bounds import ACTIONS, ActionBounds, plan_from_values
from saltus.policy.policy_features import PROPRIOCEPTION_SIZE, policy_features
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.states import ProprioceptionArrays


class ImitationNetwork:
    """A file of `paper.networks.write_imitator` in ONNX Runtime.

    Called as a predictor's network is.

    Raises:
        ModelError: the file is unreadable, or is something else.
    """

    def __init__(self, path: Path) -> None:
        file = ModelFile(path)
        robot = load_robot(DEFAULT_ROBOT)
        for name, wanted in {
            "format": IMITATOR_FORMAT,
            "robot": robot.name,
            "actions": list(ACTIONS),
        }.items():
            if file.field(name) != wanted:
                raise ModelError(
                    f"{path}: '{name}' is {file.field(name)!r}, this program needs {wanted!r}"
                )
        self.legs, self._session = LegKinematics(robot), file.session
        self.bounds = ActionBounds(low=tuple(file.field("low")), high=tuple(file.field("high")))
        shapes = {value.name: list(value.shape[1:]) for value in self._session.get_inputs()}
        hidden: Any = next(iter(shapes.get("hidden", [])), None)
        file.check(
            {name: shapes.get(name, []) for name in IMITATOR_INPUTS},
            {"plan": [len(ACTIONS)], "hidden_out": [hidden]},
        )
        self.hidden_size, self.points = int(hidden), len(HEIGHTMAP_X)

    def tick(
        self, image: Singles, age_s: Floats, new: NDArray[np.bool_], state: Singles, hidden: Singles
    ) -> NetworkOutputs:
        """One tick of many robots: normalised plans,
        zeros behind them, and widths that say nothing.
        """
        values = (image, age_s, new, state, hidden)
        given = {
            name: np.asarray(value, np.float32)
            for name, value in zip(IMITATOR_INPUTS, values, strict=True)
        }
        plan, hidden_out = self._session.run(list(IMITATOR_OUTPUTS), given)
        rows = np.zeros((len(plan), len(HEIGHTMAP_X)), np.float32)
        rows[:, : len(ACTIONS)] = plan
        return NetworkOutputs.of(rows, np.ones_like(rows), hidden_out)


class ImitatedPlans(PredictedHeights):
    """Plans in the place of heights."""

    def _features(self, states: ProprioceptionArrays) -> Singles:
        observation = observe(states, self._network.legs)
        blank = np.zeros((len(observation.pitch), len(HEIGHTMAP_X)))
        return policy_features(observation, blank)[:, :PROPRIOCEPTION_SIZE].astype(np.float32)


class PassOn:
    """Obeys what stands in the place of heights."""

    def __init__(self, bounds: ActionBounds) -> None:
        self._bounds = bounds

    def step(
        self, observation: Observation, heights: Reals, fresh: NDArray[np.bool_] | bool = False
    ) -> Plan:
        """The plan; see `saltus.policy.planner.Planner`."""
        del observation, fresh
        return plan_from_values(
            self._bounds.clipped(self._bounds.denormalised(heights[..., : len(ACTIONS)]))
        )
