"""True where a robot stands on its legs: the weight that its drives' torques carry."""

import numpy as np

from saltus.constants import GRAVITY
from saltus.real2sim.problem.log import drive_torque, robot_of
from saltus.recordings.run_log import RunLog
from saltus.robots.legs import LegKinematics
from saltus.rotations import rotation_matrix

LEAST_SHARE = 0.5
"""Least share of the robot's weight. In the mean over a log the ground gives all of it; motors a
third weaker than claimed seem to give two thirds."""
EVERY = 5
"""Rows of which one is looked at: drives follow legs, which move below 20 Hz."""


def carried_by(log: RunLog) -> float:
    """Share of the claimed weight that the commanded torques put on the ground,
    in the mean over a log.

    In the mean the forces on a body that ends as it began are its weight, in jumps too; a robot
    that is carried, or hangs, puts none on its feet. Legs are taken as light.

    Args:
        log: With base "free", its pose measured, and the joints of a quadruped in the order of
            `JOINTS`.
    """
    robot, joints, base = robot_of(log), log.joints, log.base
    if base is None:
        raise ValueError("the log has no base.csv")
    part = slice(None, None, EVERY)
    torque = drive_torque(log)[part]
    jacobian = np.asarray(LegKinematics(robot).jacobian(joints.q[part])).swapaxes(-1, -2)
    # On the robot, base frame
    pushed = -np.einsum("nlij,nlj->nli", np.linalg.pinv(jacobian), torque.reshape(-1, 4, 3))
    row = np.clip(np.searchsorted(base.time_s, joints.time_s[part]), 0, len(base.time_s) - 1)
    up = rotation_matrix(base.values[row, 3:7])[:, 2]  # the world's vertical in the base frame
    weight = GRAVITY * (robot.mass + float(log.meta.get("payload_kg") or 0.0))
    return float(np.mean(np.einsum("nli,ni->n", pushed, up)) / weight)
