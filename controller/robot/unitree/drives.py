"""A robot's joints in messages and out of them:
twelve motors of twenty, counted the robot's way.
"""

import numpy as np

from saltus.arrays import Floats
from saltus.controller.robot.backend import RobotReading
from saltus.controller.robot.unitree.messages import (
    LOW_COMMAND,
    LOW_STATE,
    MOTORS,
    OFF,
    SERVO,
    UnitreeMessage,
)
from saltus.joint_command import JointCommand
from saltus.robots.robot import Robot
from saltus.states import SensorArrays

MS = 1e-3
"""Unit of a state's `tick` [s]."""


def command_message(command: JointCommand, robot: Robot) -> UnitreeMessage:
    """A command of all joints; slots beyond the robot's motors stay off."""
    message, sign = LOW_COMMAND.blank(), robot.joint_sign
    motors = message["motor_cmd"][:MOTORS]
    motors["mode"] = SERVO
    motors["q"], motors["dq"] = sign * command.position, sign * command.velocity
    motors["tau"], motors["kp"], motors["kd"] = sign * command.torque, command.kp, command.kd
    return message


def unitree_command(message: UnitreeMessage, robot: Robot) -> JointCommand:
    """The command in a message of shape (); motors that are off have neither gains nor torque."""
    motors, sign = message["motor_cmd"][:MOTORS], robot.joint_sign
    on = (motors["mode"] != OFF).astype(np.float64)
    return JointCommand(
        position=sign * motors["q"],
        velocity=sign * motors["dq"],
        kp=on * motors["kp"],
        kd=on * motors["kd"],
        torque=on * sign * motors["tau"],
    )


def unitree_state_message(
    sensed: SensorArrays, joint_torque: Floats, robot: Robot
) -> UnitreeMessage:
    """Joints and IMU of a healthy robot: what else a state holds is left at zero."""
    message, sign = LOW_STATE.blank(), robot.joint_sign
    motors, imu = message["motor_state"][:MOTORS], message["imu_state"]
    motors["mode"] = SERVO
    motors["q"] = motors["q_raw"] = sign * sensed.joint_position
    motors["dq"] = motors["dq_raw"] = sign * sensed.joint_velocity
    motors["tau_est"] = sign * joint_torque
    imu["quaternion"] = sensed.quaternion_base_in_world
    imu["gyroscope"] = sensed.angular_velocity_base
    imu["accelerometer"] = sensed.acceleration_base
    return message


def reading_of(message: UnitreeMessage, robot: Robot) -> RobotReading:
    """Measurements in a message of shape ()."""
    motors, imu, sign = message["motor_state"][:MOTORS], message["imu_state"], robot.joint_sign
    sensed = SensorArrays(
        quaternion_base_in_world=imu["quaternion"].astype(np.float64),
        angular_velocity_base=imu["gyroscope"].astype(np.float64),
        acceleration_base=imu["accelerometer"].astype(np.float64),
        joint_position=sign * motors["q"],
        joint_velocity=sign * motors["dq"],
    )
    return RobotReading(measurement=sensed, joint_torque=sign * motors["tau_est"])
