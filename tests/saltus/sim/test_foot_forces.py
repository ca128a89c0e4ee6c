"""Forces and moments of a robot's motion that its feet do not exert."""

import numpy as np
import pytest

from saltus.constants import PHYSICS_DT
from saltus.joint_command import JointCommand
from saltus.robots.loading import load_robot
from saltus.sim.foot_forces import FootForces
from saltus.sim.plant import Plant
from saltus.terrain import flat

ROBOT = load_robot("go2")
FORCES = FootForces(ROBOT)
TICKS, SPAN = 300, 10


def swaying(tick: int) -> JointCommand:
    """A robot on its feet whose joints move by up to 0.1 rad, each another way."""
    one, phase = np.ones(12), np.arange(12.0)
    sway = 0.05 * np.sin(2.0 * np.pi * 2.0 * tick * PHYSICS_DT + phase)
    return JointCommand(
        position=ROBOT.stand_pose + sway, velocity=0.0 * one, torque=0.0 * one,
        kp=60.0 * one, kd=2.0 * one,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_what_is_left_over_is_what_pushes_the_trunk(seed: int) -> None:
    """Within an eighth: levers end in the feet's middle, a radius above the ground."""
    rng = np.random.default_rng(seed)
    plant, push = Plant(ROBOT, flat.make()), float(rng.uniform(-40.0, 40.0))
    plant.push(push)
    rows = []
    for tick in range(TICKS):
        state = plant.step(swaying(tick))
        sensed = plant.sensed
        rows.append((
            sensed.joint_position, sensed.joint_velocity, state.joint_torque,
            sensed.acceleration_base, sensed.angular_velocity_base,
        ))  # fmt: skip
    left = []
    for end in range(100, TICKS, SPAN):
        position, velocity, torque, specific_force, turn = (
            np.array(each) for each in zip(*rows[end - SPAN : end + 1], strict=True)
        )
        over_s = SPAN * PHYSICS_DT
        joints = np.array([
            position[SPAN // 2], velocity[1:].mean(axis=0), (velocity[-1] - velocity[0]) / over_s,
            torque[1:].mean(axis=0),
        ])  # fmt: skip
        base = np.array(
            [specific_force[1:].mean(axis=0), (turn[-1] - turn[0]) / over_s, turn.mean(axis=0)]
        )
        left.append(FORCES.left_over(joints[None], base)[0])
    force, moment = np.split(np.mean(left, axis=0), 2)
    assert np.abs(force - [0.0, push, 0.0]).max() < abs(push) / 8.0 + 1.5
    assert np.abs(moment).max() < 2.0
