"""Forces on the feet of a robot by its own measurements, and what of its motion they leave over."""

import mujoco
import numpy as np

from saltus.arrays import Floats
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.sim import robot_model
from saltus.terrain import flat


class FootForces:
    """Inverse dynamics of a robot that touches the ground with its feet alone.

    Torques and motion of the legs give the force on each foot, and all of them together should move
    the robot as it is measured to move. Levers of the legs end in the feet's middle.
    """

    def __init__(self, robot: Robot) -> None:
        self._legs, self._radius = LegKinematics(robot), robot.foot_radius
        self._model = robot_model.build_spec(robot, flat.make()).compile()
        self._model.opt.gravity[:] = 0.0  # an accelerometer feels it
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self._data = mujoco.MjData(self._model)

    def left_over(self, joints: Floats, base: Floats) -> Floats:
        """Force and moment on the base that no foot exerts, base frame [N, Nm], shape (n, 6).

        Args:
            joints: Angle, velocity, acceleration and torque of the joints [rad, rad/s, rad/s^2,
                Nm], shape (n, 4, 12).
            base: Acceleration as an accelerometer feels it, angular acceleration and angular
                velocity, base frame [m/s^2, rad/s^2, rad/s], shape (3, 3).
        """
        needed = np.array([self._needed(each, base) for each in joints])
        feet, jacobian = self._legs.position_and_jacobian(joints[:, 0])
        feet = feet - np.array([0.0, 0.0, self._radius])
        legs = (needed[:, 6:] - joints[:, 3]).reshape(-1, 4, 3, 1)
        force = np.linalg.solve(jacobian.mT, legs)[..., 0]
        moment = np.cross(feet, force)
        return needed[:, :6] - np.concatenate([force.sum(axis=1), moment.sum(axis=1)], axis=-1)

    def _needed(self, joints: Floats, base: Floats) -> Floats:
        """Force and moment on the base, and torques of the joints,
        that make a motion in the air, shape (18,).
        """
        data = self._data
        data.qpos[:] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, *joints[0]]
        data.qvel[:] = [0.0, 0.0, 0.0, *base[2], *joints[1]]
        data.qacc[:] = [*base[0], *base[1], *joints[2]]
        mujoco.mj_inverse(self._model, data)
        return data.qfrc_inverse.copy()
