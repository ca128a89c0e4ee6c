import numpy as np
import pytest
from samples import ROBOT

from saltus.config import TerrainConfig
from saltus.constants import POLICY_DT, POLICY_STEPS
from saltus.joint_command import JointCommand
from saltus.loop.loop import PUSH_STEPS, Pushes
from saltus.policy.evaluation.evaluate import EvaluationSettings
from saltus.sim.batch_plant import BatchPlant
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Trial

STAIRS = make_terrain(TerrainConfig(terrain="stairs"))
SEEDS = range(40)


def forces(impulse_ns: float) -> np.ndarray:
    """On robots that go over the stairs at 1 m/s, shape (steps, seeds)."""
    pushes = Pushes(impulse_ns, [STAIRS] * len(SEEDS), [Trial.draw(seed) for seed in SEEDS])
    way = np.arange(0.0, STAIRS.finish_x + 1.0, POLICY_DT)
    return np.array([pushes.step(np.full(len(SEEDS), x)) for x in way])


def test_each_robot_gets_its_impulse_once_from_either_side_on_the_course() -> None:
    force = forces(15.0)
    np.testing.assert_allclose(np.abs(force).sum(0) * POLICY_DT, 15.0)
    assert ((force != 0.0).sum(0) == PUSH_STEPS).all()
    side = np.sign(force.sum(0))
    assert 10 < (side > 0).sum() < 30
    begin = np.argmax(force != 0.0, axis=0) * POLICY_DT
    assert STAIRS.timing_x <= begin.min() < STAIRS.timing_x + 0.8
    assert STAIRS.edges_x[-1] - 0.8 < begin.max() <= STAIRS.edges_x[-1] + POLICY_DT
    np.testing.assert_array_equal(force, forces(15.0))
    assert not forces(0.0).any()


def test_a_push_moves_a_robot_in_the_air_by_its_impulse() -> None:
    plant = BatchPlant(ROBOT, STAIRS, 2, threads=1)
    plant.reset(clearance=1.0)
    one = np.ones((2, 12))
    hold = JointCommand(
        position=ROBOT.stand_pose * one, velocity=0 * one, kp=50 * one, kd=1 * one, torque=0 * one
    )
    trial = Trial()
    pushes = Pushes(15.0, [STAIRS] * 2, [trial, trial])
    for _ in range(2 * PUSH_STEPS):
        plant.push(pushes.step(np.array([STAIRS.finish_x, 0.0])))
        for _ in range(POLICY_STEPS):
            state = plant.step(hold)
    pushed, left_alone = state.velocity_base_in_world[:, 1]
    assert abs(pushed) == pytest.approx(15.0 / ROBOT.mass, rel=0.15)
    assert left_alone == pytest.approx(0.0, abs=1e-3)


def test_friction_that_is_given_wins_over_what_trials_draw() -> None:
    course = TerrainConfig(terrain="flat")
    drawn, given = (
        EvaluationSettings(robot="go1", grid="line", course=course),
        EvaluationSettings(robot="go1", grid="line", course=course, friction=0.35),
    )
    assert [given.trial(seed).friction for seed in SEEDS] == [0.35] * len(SEEDS)
    assert len({drawn.trial(seed).friction for seed in SEEDS}) == len(SEEDS)
    assert [given.trial(seed).payload_kg for seed in SEEDS] == [
        drawn.trial(seed).payload_kg for seed in SEEDS
    ]
