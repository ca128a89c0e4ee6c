"""Faults that a simulated robot shows on demand,
in what it does with commands and what it says of itself.
"""

import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from saltus.constants import PHYSICS_DT
from saltus.controller.robot.unitree.messages import LOW_STATE, OFF, UnitreeMessage
from saltus.controller.robot.unitree.states import BUTTONS
from saltus.errors import ConfigError, nearest_hint
from saltus.robots.robot import JOINTS
from saltus.rotations import quaternion_from_roll_pitch_yaw, quaternion_product

KINDS = {
    "lost": "three of ten states do not come",
    "silent": "no state comes any more",
    "late": "states come 30 ms late",
    "slow": "only every second state comes",
    "frozen": "the same state comes again and again",
    "stuck": "the clock of states goes on, and all else in them stands still",
    "crc": "states have a wrong checksum",
    "tick": "the clock of states leaps by 50 ms five times a second",
    "sign": "the drive of a joint counts the other way",
    "offset": "the encoder of a joint is off by 0.5 rad",
    "dead": "the motor of a joint gives no torque, and says that it is off",
    "hot": "the motor of a joint is at 95 degrees",
    "battery": "the battery is at 4 %",
    "imu": "the IMU is pitched by 20 degrees",
    "foreign": "another program commands the robot, too",
    "mode": "the robot's own motion service moves it, until it is released",
    "kept": "the same, and it is not released",
    "button": "a button of the remote is pressed, which is no fault but ends a run",
}
"""Kinds of faults."""
AT_A_JOINT = ("sign", "offset", "dead", "hot")
# Sizes are choices: large enough to be told from a healthy robot, small enough to be overlooked
LOST_SHARE = 0.3
LATE_TICKS = round(0.030 / PHYSICS_DT)
LEAP_MS, LEAP_TICKS = 50, round(0.2 / PHYSICS_DT)
OFFSET_RAD = 0.5
HOT_C = 95
EMPTY_PERCENT = 4
IMU_PITCH_RAD = np.deg2rad(20.0)
_TEXT = re.compile(r"(?P<kind>\w+)(:(?P<joint>\w+))?(@(?P<start>[\d.]+))?")


@dataclass(frozen=True, kw_only=True)
class PlantedFault:
    """One fault of a simulated robot's hardware or link, from some time on."""

    kind: str
    joint: str = JOINTS[0]
    """Joint of a fault at a joint."""
    start_s: float = 0.0
    """When it begins, since the start of the simulation [s]."""

    @classmethod
    def parse(cls, text: str) -> Self:
        """A fault as KIND, KIND@SECONDS, KIND:JOINT or KIND:JOINT@SECONDS.

        Raises:
            ConfigError: there is no such kind or joint.
        """
        match = _TEXT.fullmatch(text)
        kind = match["kind"] if match else text
        if match is None or kind not in KINDS:
            raise ConfigError(
                f"fault '{text}': {nearest_hint(kind, KINDS)}; "
                "KIND:JOINT@SECONDS names joint and start"
            )
        joint = match["joint"] or JOINTS[0]
        if joint not in JOINTS or (match["joint"] and kind not in AT_A_JOINT):
            raise ConfigError(
                f"fault '{text}': a joint is one of {', '.join(JOINTS)}, of a fault "
                f"{', '.join(AT_A_JOINT)}"
            )
        return cls(kind=kind, joint=joint, start_s=float(match["start"] or 0.0))


class PlantedFaults:
    """Turns commands and states of a simulated robot into those of faulty hardware, tick by tick.

    Args:
        faults: All of them; they add up.
        seed: Seed of which states are lost.
    """

    def __init__(self, faults: Sequence[PlantedFault], seed: int = 0) -> None:
        self._faults = tuple(faults)
        self._draws = np.random.default_rng(seed)
        self._waiting: deque[bytes | None] = deque([None] * LATE_TICKS)
        self._kept: dict[str, bytes] = {}

    def active(self, kind: str, time_s: float) -> list[int]:
        """Joints of all faults of a kind that have begun; of one at no joint, the first joint."""
        return [
            JOINTS.index(fault.joint)
            for fault in self._faults
            if fault.kind == kind and time_s >= fault.start_s
        ]

    def on_command(self, message: UnitreeMessage, time_s: float) -> None:
        """Changes a command, shape (), as faulty drives read it."""
        motors = message["motor_cmd"]
        for joint in self.active("sign", time_s):
            for field in ("q", "dq", "tau"):
                motors[field][joint] *= -1.0
        for joint in self.active("offset", time_s):
            motors["q"][joint] -= OFFSET_RAD
        motors["mode"][self.active("dead", time_s)] = OFF

    def on_state(self, message: UnitreeMessage, time_s: float) -> None:
        """Changes what the robot says of itself, shape ()."""
        motors, imu = message["motor_state"], message["imu_state"]
        for joint in self.active("sign", time_s):
            for field in ("q", "dq", "tau_est", "q_raw", "dq_raw"):
                motors[field][joint] *= -1.0
        for joint in self.active("offset", time_s):
            motors["q"][joint] += OFFSET_RAD
        motors["mode"][self.active("dead", time_s)] = OFF
        motors["temperature"][self.active("hot", time_s)] = HOT_C
        if self.active("button", time_s):
            message["wireless_remote"][BUTTONS.start] = 1
        if self.active("battery", time_s):
            message["bms_state"]["soc"] = EMPTY_PERCENT
        if self.active("imu", time_s):
            self._pitch(imu)
        tick = int(message["tick"])
        if self.active("tick", time_s):
            message["tick"] = tick + LEAP_MS * (round(time_s / PHYSICS_DT) // LEAP_TICKS)
        if self.active("stuck", time_s):
            kept = LOW_STATE.read([self._kept.setdefault("stuck", LOW_STATE.payload(message))])[0]
            message[...] = kept
            message["tick"] = tick

    def on_way(self, payload: bytes, time_s: float) -> list[bytes]:
        """The payloads that come when the robot sends one."""
        if self.active("frozen", time_s):
            payload = self._kept.setdefault("frozen", payload)
        if self.active("crc", time_s):
            payload = payload[:-1] + bytes([payload[-1] ^ 0x55])
        self._waiting.append(payload)
        earlier = self._waiting.popleft()
        if self.active("late", time_s):
            return [] if earlier is None else [earlier]
        odd = round(time_s / PHYSICS_DT) % 2 == 1
        if (
            self.active("silent", time_s)
            or (self.active("slow", time_s) and odd)
            or (self.active("lost", time_s) and self._draws.random() < LOST_SHARE)
        ):
            return []
        return [payload]

    def _pitch(self, imu: UnitreeMessage) -> None:
        """Turns readings into those of an IMU that is mounted nose down."""
        zero, pitch = np.zeros(()), np.asarray(IMU_PITCH_RAD)
        turn = quaternion_from_roll_pitch_yaw(zero, pitch, zero)
        imu["quaternion"] = quaternion_product(imu["quaternion"].astype(np.float64), turn)
        cos, sin = np.cos(pitch), np.sin(pitch)
        into = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
        imu["gyroscope"] = into @ imu["gyroscope"]
        imu["accelerometer"] = into @ imu["accelerometer"]
