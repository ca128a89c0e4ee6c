"""The balance of a robot that jumps: the effects that it has leave nothing but noise,
and each of them counts.
"""

from dataclasses import replace

import numpy as np
import pytest
from moving_robot import jumping_log

from saltus.effects.body import BaseInertia, ComOffset, PayloadMass
from saltus.effects.delay_line import CommandDelay, FeedforwardDelay
from saltus.effects.joint_loads import Armature, CoulombFriction, JointSpring, ViscousFriction
from saltus.effects.motors import ActuatorLag, TorqueGain, TorqueSaturation, TorqueSpeedLimit
from saltus.effects.profile import Profile
from saltus.errors import RecordingError
from saltus.real2sim.problem.jumps.problem import NOT_SHOWN, JumpProblem
from saltus.real2sim.sensors import SENSORS
from saltus.real2sim.stacked_problem import RebasedProblem
from saltus.recordings.run_log import RunLog

CALVES = [1.0, 1.0, 0.9] * 4
HIDDEN = Profile(
    actuator=(
        CommandDelay(delay=0.003),
        FeedforwardDelay(delay=0.003),
        ActuatorLag(time_constant=0.002),
        TorqueSpeedLimit(corner=5.0, no_load=25.0),
        TorqueSaturation(curve=((5.0, 5.0), (10.0, 9.8), (20.0, 17.2), (35.0, 25.7))),
        TorqueGain(gain=CALVES),
        ViscousFriction(coefficient=0.05),
        CoulombFriction(torque=0.2),
        JointSpring(torque=0.3, stiffness=0.2),
        Armature(added=0.002),
    ),
    body=(PayloadMass(mass=0.5), ComOffset(x=0.01), BaseInertia(scale=1.3)),
)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> RunLog:
    # with other seeds a foot may strike the edge of the step, which no effect is to explain
    return jumping_log(tmp_path_factory.mktemp("jump"), profile=HIDDEN, seed=5)


@pytest.fixture(scope="module")
def problem(log: RunLog) -> RebasedProblem:
    return RebasedProblem(JumpProblem(log), HIDDEN)


def _power(problem: RebasedProblem) -> float:
    return float(np.mean(problem.residuals(problem.absent[None, None]) ** 2))


def test_effects_that_a_robot_has_explain_how_it_jumps(problem: RebasedProblem) -> None:
    assert _power(problem) < 1.0


@pytest.mark.sample(4)
@pytest.mark.parametrize("effect", [effect.name for effect in (*HIDDEN.actuator, *HIDDEN.body)])
def test_each_effect_of_drives_and_body_counts(problem: RebasedProblem, effect: str) -> None:
    assert effect not in NOT_SHOWN
    leaner = problem.leaner()[effect]
    assert isinstance(leaner, RebasedProblem)
    assert _power(leaner) > 1.1 * _power(problem)


def test_an_effect_is_searched_for_or_called_untestable(log: RunLog) -> None:
    problem = JumpProblem(log)
    known = {candidate.effect for candidate in problem.candidates} | problem.untestable.keys()
    assert known >= {
        effect
        for sensor in SENSORS
        if sensor.name in ("joints", "body")
        for effect in sensor.effects
    }


def test_rates_of_another_instant_are_refused(log: RunLog) -> None:
    assert log.imu is not None
    late = np.concatenate([log.imu.values[:1], log.imu.values[:-1]])
    with pytest.raises(RecordingError, match="late"):
        JumpProblem(replace(log, imu=replace(log.imu, values=late)))
    assert "no IMU" in next(sensor for sensor in SENSORS if sensor.name == "body").lacks(
        replace(log, imu=None)
    )
