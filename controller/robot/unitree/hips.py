"""Hips that count the other way, while the robot stands, walks or jumps.

A hip at zero says the same angle both ways. But its torque then holds the robot the wrong way
round: forces on the feet, by torques and motion of the legs, do not move the trunk as it moves, and
do so once the angles, speeds and torques of that hip are turned round.
"""

from collections import deque

import numpy as np

from saltus.arrays import Floats
from saltus.constants import GRAVITY
from saltus.controller.robot.unitree.drives import MS
from saltus.controller.robot.unitree.messages import MOTORS, UnitreeMessage
from saltus.robots.robot import JOINTS, Robot
from saltus.sim.foot_forces import FootForces

HIPS = tuple(range(0, MOTORS, 3))
SPAN, HOP = 10, 5
"""States that are averaged, and from one average to the next: impacts last shorter, a stance in
bounding lasts seven times longer."""
LONGEST_S = 0.03
"""Averages over more, as of a robot whose states are lost, tell nothing."""
ROWS = (1, 3, 5)  # force to the left, moments about ahead and up
USUAL = np.array([15.0, 2.0, 5.0])
"""Rest of these when a healthy Go2 walks over rubble, stairs and hurdles [N, Nm, Nm]: payload,
friction of joints, shins and trunk that touch, other forces of motors than told. Where it turns on
the spot the last is largest: feet twist on the ground."""
MOST = 12.0
"""Squares of what is left over, by what is usual, count no more than this: a trunk that lies on an
edge is held by more. With 4, small rests counted for almost as much as large ones: a healthy robot
on stairs came to 0.78 of what named a hip."""
HELD_UP, HELD_AHEAD = 0.5, 0.35
"""Forces from outside the feet, as shares of the weight. If one lifts the robot by more than the
first, all evidence is forgotten; if one presses it down by as much, or pushes it ahead or back by
more than the second, no evidence is taken. A leg that was caught behind a hurdle held a healthy Go2
back by half of its weight; its evidence (below) came to 141, and comes to 20 with this limit. Legs
at the ends of their joints, in a stop on rubble, pressed two down by 1 to 2.3 weights, for 40 and
47. Flipped hips are named as soon with limits ahead from 0.3 to 0.45, in walks and while it
bounds."""
MOVES_RPS = 3.0
"""Evidence counts in full where a joint turns as fast as this [rad/s], and less the slower all of
them are: however long a robot stands, it shows one state. A healthy Go2 that stood on rubble after
a turn on the spot, with 16 Nm about up that its feet did not tell, came to 63; another that sank
into its stand there, with 9 Nm, to 62."""
DRIFT, ENOUGH = 0.3, 54.0
"""Evidence that is forgotten with each average, and that names a hip: healthy Go2 come to 35.9 in
walks, turns on the spot, jumps, stops and pushes, with a flipped hip 64 of 64 to 105 or more in 0.4
s while they bound. In walks, drills and stops a flipped hip comes to 45 in 0.14 s at the median."""


class HipWatch:
    """Evidence that a hip's sign is flipped, for each hip, gathered from state to state."""

    def __init__(self, robot: Robot) -> None:
        self._forces, self._sign = FootForces(robot), robot.joint_sign
        self._weight = GRAVITY * float(robot.trunk_mass + robot.link_mass.sum())
        self._recent: deque[Floats] = deque(maxlen=SPAN + 1)
        self._taken = 0
        self._against = np.zeros(len(HIPS))
        turned = np.ones((1 + len(HIPS), MOTORS))
        turned[np.arange(len(HIPS)) + 1, HIPS] = -1.0
        self._turned = turned[:, None]  # as told, and with each hip turned round

    @property
    def evidence(self) -> float:
        """Evidence against the worst hip."""
        return float(self._against.max())

    def take(self, message: UnitreeMessage) -> str:
        """Takes in a state of shape (); names a hip that counts the other way, or returns ""."""
        motors, imu = message["motor_state"][:MOTORS], message["imu_state"]
        self._recent.append(np.concatenate([
            motors["q"], motors["dq"], motors["tau_est"], imu["gyroscope"], imu["accelerometer"],
            [message["tick"]],
        ], dtype=np.float64))  # fmt: skip
        self._taken += 1
        if len(self._recent) <= SPAN or self._taken % HOP:
            return ""
        states = np.array(self._recent)
        if MS * (states[-1, -1] - states[0, -1]) > LONGEST_S:
            return ""
        moves = min(1.0, float(np.abs(states[1:, 12:24].mean(axis=0)).max()) / MOVES_RPS)
        left = self._left_over(states)
        ahead, _, up = left[0, :3] / self._weight
        if up > HELD_UP:  # somebody or something else holds it
            self._against[:] = 0.0
        if abs(up) > HELD_UP or abs(ahead) > HELD_AHEAD:
            return ""
        squares = ((left[:, ROWS] / USUAL) ** 2).sum(axis=-1)
        told, *others = np.minimum(squares, MOST)
        self._against = np.maximum(0.0, self._against + moves * (told - np.array(others)) - DRIFT)
        if self.evidence < ENOUGH:
            return ""
        worst = JOINTS[HIPS[int(np.argmax(self._against))]]
        return f"{worst} moves the robot as if it counted the other way"

    def _left_over(self, states: Floats) -> Floats:
        """Force and moment of the mean motion that feet do not exert, as told and with each hip
        turned round, shape (5, 6).
        """
        mean, change = states[1:].mean(axis=0), states[-1] - states[0]
        grows = change / (MS * change[-1])
        position, speed, torque = states[SPAN // 2, :12], slice(12, 24), slice(24, 36)
        turn, specific_force = slice(36, 39), slice(39, 42)
        joints = self._sign * np.array([position, mean[speed], grows[speed], mean[torque]])
        base = np.array([mean[specific_force], grows[turn], mean[turn]])
        return self._forces.left_over(self._turned * joints, base)
