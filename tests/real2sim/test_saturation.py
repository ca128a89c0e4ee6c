"""A saturation as a curve: from a robot to its log,
and from a profile to the simulator that a log is compared with.
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from samples import CURVE, PROFILE, ROBOT

from saltus.effects.motors import TorqueSaturation, TorqueSpeedLimit
from saltus.effects.profile import Profile
from saltus.real2sim.experiments import motions
from saltus.real2sim.experiments.menu import EXPERIMENTS
from saltus.real2sim.experiments.run import run_experiment
from saltus.real2sim.pipeline import find_in_logs
from saltus.real2sim.problem.joints.problem import JointProblem
from saltus.real2sim.stacked_problem import RebasedProblem
from saltus.recordings.run_log import write_run_log

STEPS = dataclasses.replace(
    EXPERIMENTS["large_steps"],
    sections=lambda robot: motions.repeat_motion(
        "steps", 2, motions.steps(robot, 2.2, 0.6, (0.48, 0.48, 0.8))
    ),
)
SHORT_TOUR = dataclasses.replace(
    EXPERIMENTS["joint_tour"],
    sections=lambda robot: (
        *motions.repeat_motion("chirp", 2, motions.sweep(robot, 2.0, 0.5, 8.0, 0.35)),
        *motions.repeat_motion(
            "large steps", 2, motions.steps(robot, 2.0, 0.5, (0.35, 0.35, 0.55))
        ),
    ),
)
"""What of it shows when drives answer, and how strongly."""
CALVES_ONLY = tuple((asked, *((asked, asked, given) * 4)) for asked, given in CURVE)
"""The same table at the calves, nothing elsewhere."""


@pytest.mark.parametrize("curve", [CURVE, CALVES_ONLY], ids=["all joints", "calves"])
def test_a_simulator_with_the_curve_of_the_robot_leaves_noise(
    curve: tuple[tuple[float, ...], ...],
) -> None:
    robot = Profile(actuator=(TorqueSaturation(curve=curve),))
    inner = JointProblem(run_experiment(STEPS, ROBOT, robot, seed=2))
    nothing = np.zeros((1, len(inner.blocks), sum(len(c.unknowns) for c in inner.candidates)))
    with_curve = RebasedProblem(inner, robot)
    assert np.mean(with_curve.residuals(nothing) ** 2) == pytest.approx(1.0, abs=0.12)
    assert np.mean(inner.residuals(nothing) ** 2) > 4.0
    calf = next(
        c for c in with_curve.candidates if (c.effect, c.where) == ("torque_saturation", "calf")
    )
    told = calf.parameters(np.array([0.0, 10.0, 1.0]))
    assert told["knee"].value == pytest.approx(13.4, abs=0.1)
    assert told["plateau"].value == pytest.approx(25.9, abs=0.1)


def test_a_simulator_with_the_speed_limit_of_the_robot_leaves_noise() -> None:
    robot = Profile(
        actuator=(TorqueSpeedLimit(corner=0.0, no_load=12.0), TorqueSaturation(curve=CURVE))
    )
    inner = JointProblem(run_experiment(STEPS, ROBOT, robot, seed=2))
    limited = RebasedProblem(inner, robot)
    assert np.mean(
        limited.residuals(limited.absent * np.ones((1, len(inner.blocks), 1))) ** 2
    ) == pytest.approx(1.0, abs=0.12)


def test_nothing_is_missing_of_a_robot_with_the_profile_that_it_has(tmp_path: Path) -> None:
    write_run_log(run_experiment(SHORT_TOUR, ROBOT, PROFILE, seed=70000), tmp_path / "log", ROBOT)
    assert (
        find_in_logs(
            [tmp_path / "log"], tmp_path / "found", profile=PROFILE, report=False
        ).verdict.verdict
        == "no_gap"
    )


def test_a_curve_of_each_joint_has_as_many_columns_as_joints() -> None:
    torque = np.linspace(-40.0, 40.0, 41)[:, None] * np.ones(12)
    given = TorqueSaturation(curve=CALVES_ONLY).fitted(ROBOT).delivered(torque)
    whole, calf = TorqueSaturation(curve=CURVE).fitted(ROBOT), np.arange(12) % 3 == 2
    np.testing.assert_array_equal(given[:, ~calf], torque[:, ~calf])
    np.testing.assert_allclose(given[:, calf], whole.delivered(torque)[:, calf], rtol=1e-12)
