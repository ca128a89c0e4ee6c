"""Faults that a robot's states show while it runs: of motors and battery, by their own word, and of
encoders and IMU, where a state contradicts the one before.
"""

import numpy as np

from saltus.controller.robot.unitree.drives import MS
from saltus.controller.robot.unitree.messages import MOTORS, OFF, UnitreeMessage
from saltus.robots.robot import JOINTS, Robot

HOT_C, EMPTY_PERCENT = 85, 10
"""A robot that begins passes the preflight at 70 degrees and 20 %. Choices: no source says where a
Go2 itself switches off."""
FASTEST_TURN = np.deg2rad(2000.0)
"""Turns that gyroscopes of such robots measure, 2,000 degrees a second (BMI088, ICM-20602): an
attitude that turns faster has leapt [rad/s]."""


def hardware_trouble(message: UnitreeMessage) -> str:
    """Names a motor that is off or hot, or an empty battery, in a state of shape ()."""
    motors = message["motor_state"][:MOTORS]
    if (motors["mode"] == OFF).any():
        return f"the motor of {JOINTS[int(np.argmax(motors['mode'] == OFF))]} says that it is off"
    hottest = int(np.argmax(motors["temperature"]))
    if motors["temperature"][hottest] >= HOT_C:
        return f"the motor of {JOINTS[hottest]} is at {motors['temperature'][hottest]} degrees"
    charge = int(message["bms_state"]["soc"])
    return f"its battery is at {charge} %" if charge <= EMPTY_PERCENT else ""


def state_contradiction(message: UnitreeMessage, before: UnitreeMessage, robot: Robot) -> str:
    """Names a joint or an attitude that leaps between two states of shape ().

    An angle may be off the mean of both speeds by what the joint can do in that time, an attitude
    turns no faster than gyroscopes follow.
    """
    passed_s = MS * (int(message["tick"]) - int(before["tick"]))
    now, then = message["motor_state"][:MOTORS], before["motor_state"][:MOTORS]
    moved = np.asarray(now["q"], np.float64) - then["q"]
    speed = 0.5 * (np.asarray(now["dq"], np.float64) + then["dq"])
    share = np.abs(moved / passed_s - speed) / robot.speed_limit
    worst = int(np.argmax(share))
    if share[worst] > 1.0:
        return f"{JOINTS[worst]} leaps by {moved[worst]:+.2f} rad in {passed_s / MS:.0f} ms"
    one, other = (each["imu_state"]["quaternion"].astype(np.float64) for each in (message, before))
    cosine = float(abs(one @ other) / (np.linalg.norm(one) * np.linalg.norm(other)))
    turned = 2.0 * float(np.arccos(min(cosine, 1.0)))
    if turned > FASTEST_TURN * passed_s:
        return f"its attitude leaps by {np.rad2deg(turned):.0f} degrees in {passed_s / MS:.0f} ms"
    return ""
