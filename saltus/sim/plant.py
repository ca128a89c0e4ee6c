"""One robot on a terrain: joint commands in, states out, 2 ms at a time."""

from collections.abc import Sequence
from math import isfinite

import mujoco
import numpy as np

from saltus.arrays import Array, Floats
from saltus.effects.body import claimed_body
from saltus.effects.chain import ActuatorChain, BodyChain, ImuChain, Torques
from saltus.effects.compiled_chain import compiled_step
from saltus.errors import SaltusError
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import LEGS, Robot
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix
from saltus.sim import robot_model
from saltus.sim.driven_robots import DrivenMotion, DrivenRobots
from saltus.sim.model_layout import ModelLayout
from saltus.sim.plant_state import PlantState
from saltus.terrain.terrain import Terrain
from saltus.terrain.terrain_stack import TerrainStack

CLEARANCE = 0.01  # feet above the ground at a reset [m]: falls 45 ms, too short to turn
HELD_HEIGHT = 1.0  # of the base of a held robot [m]: no foot reaches the ground
HELD_INERTIA = (
    1e9  # [kg, kg m^2]: its base moves by less than 0.1 mm in 30 s under the robot's weight
)
ROLL = 3  # the base's degree of freedom about its own x axis
HELD_TOLERANCE = (
    1e-16  # of the solver: the engine's 1e-8 times what the base is heavier than a leg is felt by
)


def standing_pose(
    robot: Robot,
    terrain: Terrain | TerrainStack,
    position_x: Floats,
    yaw: Floats,
    clearance: float = CLEARANCE,
) -> Floats:
    """`qpos` of robots in their stand pose with their feet
    `clearance` above the highest ground under them.

    Args:
        robot: Its kind.
        terrain: Ground; where it is a stack, one for each robot.
        position_x: Of the base [m], shape (...).
        yaw: Of the base [rad], shape (...).
        clearance: Of the lowest foot [m].

    Returns:
        Shape (..., 19).
    """
    yaw, zero = np.asarray(yaw, dtype=np.float64), np.zeros(np.shape(yaw))
    quaternion = quaternion_from_roll_pitch_yaw(zero, zero, yaw)
    standing = LegKinematics(robot).position(robot.stand_pose)
    feet = standing @ rotation_matrix(quaternion).mT  # (..., 4, 3), yaw applied
    foot_x, foot_y = position_x[..., None] + feet[..., 0], feet[..., 1]
    # (..., 8)
    sole_x = np.concatenate([foot_x - robot.foot_radius, foot_x + robot.foot_radius], axis=-1)
    ground = terrain.height_at(sole_x, np.concatenate([foot_y, foot_y], axis=-1)).max(axis=-1)
    # The legs give about 1 cm of it under load
    drop = robot.foot_radius - float(standing[:, 2].min())
    position = np.stack([position_x, zero, ground + drop + clearance], axis=-1)
    joints = np.broadcast_to(robot.stand_pose, (*zero.shape, 12))
    return np.concatenate([position, quaternion, joints], axis=-1)


class Plant(DrivenRobots):
    """One simulated robot with its drives, which are ideal by default.

    Args:
        robot: Which one.
        terrain: What it stands on.
        friction: Coefficient of friction between robot and terrain.
        payload_kg: Mass on top of the trunk [kg].
        com_shift: Added to the trunk's centre of mass [m], base frame.
        chain: What the drives do to a command.
        body: What is otherwise than claimed about the robot's body and the ground.
        imu: What the IMU makes of the motion of the base.
        held: Whether the base is held in the air: the legs move, gravity acts. Without contacts the
            joints are then integrated to a higher order, so that the time step shows in no log.
        compiled: Whether the drives are computed by `compiled_step`: equal but for rounding.
    """

    def __init__(
        self,
        robot: Robot,
        terrain: Terrain,
        *,
        friction: float = robot_model.FRICTION,
        payload_kg: float = 0.0,
        com_shift: Sequence[float] = (0.0, 0.0, 0.0),
        chain: ActuatorChain | None = None,
        body: BodyChain | None = None,
        imu: ImuChain | None = None,
        held: bool = False,
        compiled: bool = False,
    ) -> None:
        super().__init__(robot, (), chain, imu)
        if compiled:
            self._drive = compiled_step(self._chain)
        self.terrain = terrain
        body = body or BodyChain()
        self.model = robot_model.build_spec(
            robot,
            terrain,
            friction=friction,
            payload_kg=payload_kg,
            com_shift=com_shift,
            dimensions=body.contact_dimensions,
        ).compile()
        self._layout = ModelLayout(robot, self.model)
        self._held = held
        if held:
            self.model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
            self.model.dof_armature[:6] = HELD_INERTIA
            # relative to a base that heavy, friction of a joint is small enough for the solver to
            # leave it out
            self.model.opt.tolerance = HELD_TOLERANCE
        if body.effects:
            changed = body.apply(
                claimed_body(friction=friction, payload_kg=payload_kg, com_shift=com_shift)
            )
            self._layout.write_bodies(self._field, changed, robots=())
            if held and changed.roll_give > 0.0:
                self.model.dof_armature[ROLL] = 0.0
                self.model.dof_damping[ROLL] = changed.roll_damping
                # The base is too heavy to feel it in other ways
                self.model.jnt_stiffness[0] = 1.0 / changed.roll_give
            mujoco.mj_setConst(self.model, mujoco.MjData(self.model))
        self.data = mujoco.MjData(self.model)
        self._feet = [self.model.geom(f"{leg}_foot").id for leg in LEGS]
        self.reset()

    def reset(
        self,
        position_x: float = 0.0,
        yaw: float = 0.0,
        clearance: float = CLEARANCE,
    ) -> PlantState:
        """Puts the robot at rest in its stand pose, its feet just above the ground.

        Time starts over.
        """
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = standing_pose(
            self.robot,
            self.terrain,
            np.asarray(position_x),
            np.asarray(yaw),
            clearance,
        )
        if self._held:
            self.data.qpos[2] = HELD_HEIGHT
            self.model.qpos_spring[:7] = self.data.qpos[:7]
        self._forget()
        mujoco.mj_forward(self.model, self.data)
        return self._look(np.zeros(12))

    def push(self, force: float) -> None:
        """Pushes the trunk's centre of mass along the world's y from now on [N]; 0 ends it."""
        self.data.xfrc_applied[self._layout.trunk, 1] = force

    def _advance(self, torque: Torques) -> None:
        total = torque.believed + torque.applied
        if not isfinite(total.dot(total)):  # the engine would take it for zero
            raise SaltusError(
                f"the joint command at {self._now:.3f} s is not finite: torque {torque.believed}"
            )
        self.data.ctrl[:] = torque.applied
        if (
            resistance := torque.resistance
        ) is not None:  # friction, which the engine integrates implicitly
            values = resistance.friction, resistance.damping, resistance.armature
            self._layout.write_joints(self._field, *values, robots=())
        mujoco.mj_step(self.model, self.data)
        if not isfinite(self.data.qvel.dot(self.data.qvel)):
            raise SaltusError(
                f"the simulation diverged at {self._now:.3f} s: torque {torque.applied}"
            )
        mujoco.mj_kinematics(self.model, self.data)

    def _motion(self) -> DrivenMotion:
        data = self.data
        rotation, feet = data.xmat[1].reshape(3, 3), data.geom_xpos[self._feet]
        return (
            float(data.time),
            data.qpos.copy(),
            data.qvel.copy(),
            feet,
            rotation,
            data.qacc,
            data.sensordata,
        )

    def _field(self, name: str) -> Array:
        return getattr(self.model, name)
