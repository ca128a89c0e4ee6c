"""Whether stairs that a policy cannot climb are beyond the robot, or only beyond its training so far.

    python benchmarks/training_reach.py [--rises 0.15 0.16 0.17 0.18 0.19 0.20] [--generations 20] [--out reach.json]

CMA-ES looks for 16 numbers that are added to the actions of a policy in proportion to the slope ahead: a faster gait,
velocities and pitch rates by contact mode, where feet go early and late in their swing. If so little brings robots up
stairs in the plant, with the drives' effects and the deployed leg controller, nothing in controller, drives or bounds
forbids what training has not found yet. Robots are nominal and see true heights. Four steps make a course. Ends with
one JSON object: for each rise the share of the last generation's robots that came up, and the centre of the search.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from cmaes import CMA

from policy.action import Action
from policy.actor import PolicyActor
from policy.bounds import action_from_values
from policy.features import features
from policy.observation import Observation
from policy.profile import slope
from policy.rollout import Rollout, exact_heights
from saltus.config import TerrainConfig
from saltus.messages import Floats
from saltus.resources import resource
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Trial

CHANGES = {
    "frequency_hz": 0.4, "velocity_x": 0.5, "front_velocity_z": 0.5, "rear_velocity_z": 0.5, "velocity_z_slope": 1.0,
    "front_pitch_rate": 1.5, "rear_pitch_rate": 1.5, "flight_pitch_rate": 1.5,
    "front_x_early": 0.08, "front_x_late": 0.08, "front_z_early": 0.12, "front_z_late": 0.12,
    "rear_x_early": 0.08, "rear_x_late": 0.08, "rear_z_early": 0.12, "rear_z_late": 0.12,
}  # fmt: skip
"""What is looked for, and the size of one unit of the search: about a tenth of each action's range."""
FULL_SLOPE = 0.5  # at which a change counts whole; stairs of 0.20 by 0.25 m have 0.8
STEEPEST = 1.6  # changes grow no further
SLOPE_FROM, SLOPE_TO = -0.3, 0.6  # where the slope is measured [m ahead]
STEPS = 4
STAND_STEPS = 20
START_X = (0.2, 0.4)  # of the first and the last robot of a rise: they meet the first edge at different phases [m]
TIME_LIMIT_S = 4.0
SUCCESS_SCORE = 0.6  # beside the share of the way
FIRST_SIGMA = 0.35
FRONT, REAR = 0, 2


class ChangedPolicy:
    """A policy with something added to its actions.

    Args:
        actor: The policy.
        changes: In the order of `CHANGES`, shape (n, 16).
    """

    def __init__(self, actor: PolicyActor, changes: Floats) -> None:
        self._actor = actor
        self._changes = dict(zip(CHANGES, changes.T, strict=True))

    def step(self, observation: Observation, heights: Floats) -> Action:
        """Plans the next 10 ms."""
        values = self._actor.values(features(observation, heights))
        share = np.clip(slope(heights, SLOPE_FROM, SLOPE_TO) / FULL_SLOPE, 0.0, STEEPEST)
        return action_from_values(values + share[:, None] * self._added(observation))

    def _added(self, observation: Observation) -> Floats:
        """Shape (n, 10), in the order of `policy.bounds.ACTIONS`."""
        c = self._changes
        front, rear = observation.contact[:, FRONT], observation.contact[:, REAR]
        only_front, only_rear, flight = front & ~rear, rear & ~front, ~front & ~rear
        moment = only_front * (observation.progress[:, FRONT] - 0.5) + only_rear * (observation.progress[:, REAR] - 0.5)
        columns = [
            c["frequency_hz"],
            c["velocity_x"],
            only_front * c["front_velocity_z"] + only_rear * c["rear_velocity_z"] + moment * c["velocity_z_slope"],
            only_front * c["front_pitch_rate"] + only_rear * c["rear_pitch_rate"] + flight * c["flight_pitch_rate"],
        ]
        for pair, leg in (("front", FRONT), ("rear", REAR)):
            swings, late = ~observation.contact[:, leg], observation.progress[:, leg]
            x = c[f"{pair}_x_early"] * (1.0 - late) + c[f"{pair}_x_late"] * late
            z = c[f"{pair}_z_early"] * (1.0 - late) + c[f"{pair}_z_late"] * late
            columns += [swings * x, 0.0 * x, swings * z]
        return np.stack(columns, axis=-1)


def climb(actor: PolicyActor, candidates: Floats, rises: Sequence[float]) -> tuple[Floats, Floats]:
    """Runs every candidate once on every rise.

    Returns:
        Scores, shape (candidates,), and who came up, shape (candidates, rises).
    """
    courses = [make_terrain(TerrainConfig(terrain="stairs", rise_m=rise, run_m=0.25, steps=STEPS)) for rise in rises]
    starts = np.linspace(*START_X, len(candidates))
    trials = [Trial(position_x=float(x)) for x in starts for _ in rises]
    rollout = Rollout(
        courses * len(candidates),
        trials,
        ChangedPolicy(actor, np.repeat(candidates, len(rises), axis=0)),
        heights=exact_heights,
        time_limit_s=TIME_LIMIT_S,
        stand_steps=STAND_STEPS,
    )
    for _ in rollout.run():
        pass
    outcomes = [outcome for outcome in rollout.outcomes if outcome is not None]
    goals = [course.finish_x for course in courses] * len(candidates)
    way = np.array([trial.position_x + o.distance_m for trial, o in zip(trials, outcomes, strict=True)]) / goals
    came_up = np.array([float(o.success) for o in outcomes])
    scores = np.clip(way, 0.0, 1.0) + SUCCESS_SCORE * came_up
    shape = (len(candidates), len(rises))
    return scores.reshape(shape).mean(axis=1), came_up.reshape(shape)


def main(arguments: Sequence[str] | None = None) -> None:
    """Searches."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, help="ONNX file; the shipped policy where it is not given")
    parser.add_argument("--rises", type=float, nargs="+", default=[0.15, 0.16, 0.17, 0.18, 0.19, 0.20])
    parser.add_argument("--generations", type=int, default=20)
    parser.add_argument("--population", type=int, default=12)
    parser.add_argument("--out", type=Path, help="file for the result of every generation")
    given = parser.parse_args(arguments)
    actor = PolicyActor(given.model or resource("models/policy.onnx"))
    scale = np.array(list(CHANGES.values()))
    optimiser = CMA(mean=np.zeros(len(CHANGES)), sigma=FIRST_SIGMA, seed=1, population_size=given.population)
    result: dict[str, object] = {}
    for generation in range(given.generations):
        candidates = np.array([optimiser.ask() for _ in range(given.population)])
        scores, came_up = climb(actor, candidates * scale, given.rises)
        optimiser.tell([(x, -float(score)) for x, score in zip(candidates, scores, strict=True)])
        share = dict(zip(map(str, given.rises), np.round(came_up.mean(axis=0), 2).tolist(), strict=True))
        best = int(np.argmax(scores))
        print(f"{generation + 1}: score {scores.mean():.2f}, came up {share}, best {came_up[best].astype(int)}")
        centre = dict(zip(CHANGES, np.round(optimiser.mean * scale, 4).tolist(), strict=True))
        result = {"generation": generation + 1, "came_up": share, "best": came_up[best].tolist(), "changes": centre}
        if given.out:
            given.out.write_text(json.dumps(result))
    print(json.dumps(result))


if __name__ == "__main__":
    main()
