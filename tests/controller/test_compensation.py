"""What is known of the drives is taken out of the commands."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from samples import setups_of

from saltus.arrays import Array
from saltus.controller.compensation import KNOWN, LEAST_GAIN, MOST_OF_KD, compensation_of
from saltus.effects.joint_loads import CoulombFriction, ViscousFriction
from saltus.effects.motors import TorqueGain
from saltus.effects.profile import IDEAL, SHIPPED, Profile, load_profile
from saltus.errors import ConfigError
from saltus.grid import LINE
from saltus.joint_command import JointCommand
from saltus.loop.loop import Loop
from saltus.policy.scripted import ScriptedPlanner
from saltus.robots.loading import load_robot
from saltus.terrain import flat
from saltus.trial import Trial

ROBOT = load_robot("go1")


def joint_torque(
    command: JointCommand, position: Array, velocity: Array, gain: Array, damping: Array
) -> Array:
    """What a joint gets from a drive of that gain, less what its own friction takes [Nm]."""
    asked = (
        command.kp * (command.position - position)
        + command.kd * (command.velocity - velocity)
        + command.torque
    )
    return gain * asked - damping * velocity


@pytest.mark.parametrize("library", ["numpy", "torch"])
@pytest.mark.parametrize("seed", range(5))
def test_a_joint_does_what_is_asked_of_an_ideal_one(library: str, seed: int) -> None:
    """Any gain, any friction below the law's own damping; within the limits of the drives."""
    rng = np.random.default_rng(seed)
    gain, damping = rng.uniform(LEAST_GAIN, 1.5, 12), rng.uniform(0.0, 0.8, 12)
    profile = IDEAL.having(
        TorqueGain(gain=tuple(gain)), ViscousFriction(coefficient=tuple(damping))
    )
    compensation = compensation_of(profile, ROBOT)
    assert compensation is not None
    make = np.asarray if library == "numpy" else torch.as_tensor
    values = {
        name: make(rng.normal(size=(7, 12))) for name in ("position", "velocity", "kp", "torque")
    }
    command = JointCommand(**values, kd=make(rng.uniform(1.0, 4.0, (7, 12))))
    state = make(rng.normal(size=(7, 12))), make(rng.normal(size=(7, 12)))
    got = joint_torque(compensation(command), *state, make(gain), make(damping))
    wanted = joint_torque(command, *state, make(np.ones(12)), make(np.zeros(12)))
    np.testing.assert_allclose(np.asarray(got), np.asarray(wanted), rtol=1e-12, atol=1e-12)


def test_a_drive_is_asked_for_what_it_can_give() -> None:
    """The torque stays within its limit, and some damping stays the drive's own.

    No kd stays none.
    """
    profile = IDEAL.having(TorqueGain(gain=0.5), ViscousFriction(coefficient=2.0))
    compensation = compensation_of(profile, ROBOT)
    assert compensation is not None
    one = np.ones(12)
    command = JointCommand(
        position=one, velocity=one, kp=one, kd=one, torque=0.8 * ROBOT.torque_limit
    )
    changed = compensation(command)
    np.testing.assert_array_equal(changed.torque, ROBOT.torque_limit)
    np.testing.assert_allclose(changed.kd, (1.0 - MOST_OF_KD) / 0.5)
    limp = compensation(replace(command, kd=np.zeros(12)))
    np.testing.assert_array_equal(limp.kd * limp.velocity, np.zeros(12))


def test_what_is_not_known_is_not_made_up_for() -> None:
    """Nothing is known of a robot as it is shipped; other effects of the joints stay.

    A broken motor is refused.
    """
    assert compensation_of(load_profile(SHIPPED, ROBOT), ROBOT) is None
    assert compensation_of(IDEAL.having(CoulombFriction(torque=0.4)), ROBOT) is None
    assert {effect.name for effect in KNOWN} == {"torque_gain", "viscous_friction"}
    with pytest.raises(ConfigError, match="torque_gain"):
        compensation_of(IDEAL.having(TorqueGain(gain=0.5 * LEAST_GAIN)), ROBOT)


def test_a_weak_robot_that_is_known_moves_as_a_strong_one() -> None:
    """For the first steps, until small differences have grown:
    a joint that is known moves as an ideal one.
    """
    weak = IDEAL.having(TorqueGain(gain=0.65), ViscousFriction(coefficient=0.5))

    def way(profile: Profile, **known: object) -> np.ndarray:
        rollout = Loop(
            setups_of([flat.make()], [Trial()], profile),
            ScriptedPlanner(ROBOT, LINE),
            stand_steps=5,
            **known,
        )  # type: ignore[arg-type]
        return np.array([rollout.step().truth.position_base_in_world[0] for _ in range(25)])

    strong, unknown = way(profile=IDEAL), way(profile=weak)
    known = way(profile=weak, compensation=compensation_of(weak, ROBOT))
    assert np.abs(known - strong).max() < 0.2 * np.abs(unknown - strong).max()
