"""The robot's side of a Unitree's protocol: the plant answers commands with states."""

import numpy as np

from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT
from saltus.controller.robot.unitree.drives import (
    MS,
    command_message,
    unitree_command,
    unitree_state_message,
)
from saltus.controller.robot.unitree.faults import PlantedFaults
from saltus.controller.robot.unitree.messages import (
    LOW_COMMAND,
    LOW_STATE,
    UnitreeMessage,
    is_intact,
)
from saltus.controller.robot.unitree.motion_service import SimulatedMotionService
from saltus.controller.robot.unitree.truth import truth_payload
from saltus.effects.motors import VoltageSag
from saltus.errors import MessageError
from saltus.joint_command import JointCommand
from saltus.robots.robot import Robot
from saltus.sim.plant import Plant

CELLS, CELL_MV = 8, 3700
"""Battery of a Go2: 29.6 V nominal (Unitree's data sheet), which is eight cells of lithium."""
MODE = "mcf"
"""Mode in which a Go2 of today moves itself."""
CHARGE_PERCENT, MOTOR_C, BOARD_C = 90, 35, 45
"""Values of a healthy robot at rest."""
GYRO_NOISE = 0.001
"""Noise of the gyroscope [rad/s]: that of a usual one, 0.004 deg/s per root of a Hz, over 250 Hz.
No state of a real robot equals the one before."""


class SimulatedUnitree:
    """A robot in the plant that hears commands and says states, 2 ms at a time.

    Until the first command it holds its stand pose, as its own motion service or a person would.
    Then it goes on with its last one, whoever falls silent. A command with a wrong checksum is not
    obeyed.

    Args:
        plant: Robot and ground, with the effects of its hardware.
        faults: Faults on demand.
        seed: Seed of the noise.
        sag: Fall of the battery's voltage, which it also tells; the plant's own effect.
    """

    def __init__(
        self,
        plant: Plant,
        faults: PlantedFaults | None = None,
        seed: int = 0,
        sag: VoltageSag | None = None,
    ) -> None:
        self._sag = sag or VoltageSag()
        self._noise = np.random.default_rng(seed)
        self._plant, self._faults = plant, faults or PlantedFaults(())
        self._command = _holding(plant.robot)
        self._service = SimulatedMotionService()
        self._ticks = self._contacts = 0
        self.commands = 0
        """Commands that were taken."""
        self.refused = 0
        """Commands with a wrong checksum or of a wrong size."""

    @property
    def time_s(self) -> float:
        """Since the start [s]."""
        return self._ticks * PHYSICS_DT

    @property
    def position(self) -> Floats:
        """Place of the base in the world [m], shape (3,), which no robot knows."""
        return self._plant.state.position_base_in_world

    @property
    def is_commanded_by_others(self) -> bool:
        """True while another program is to command the robot,
        too, or its own motion service does.
        """
        return bool(self._faults.active("foreign", self.time_s) or self.mode)

    @property
    def mode(self) -> str:
        """Mode in which its own motion service moves it; empty if it does not."""
        keeps = self._faults.active("kept", self.time_s)
        moves = self._faults.active("mode", self.time_s) and not self._service.released
        return MODE if keeps or moves else ""

    def answer(self, payload: bytes) -> list[bytes]:
        """The answers of its motion service to a request, as they travel."""
        keeps = bool(self._faults.active("kept", self.time_s))
        return self._service.answer(payload, self.mode, keeps=keeps)

    def hear(self, payload: bytes) -> None:
        """Takes one command."""
        try:
            message = LOW_COMMAND.read([payload])[0]
        except MessageError:
            self.refused += 1
            return
        if not is_intact(message):
            self.refused += 1
            return
        self._faults.on_command(message, self.time_s)
        self._command = unitree_command(message, self._plant.robot)
        self.commands += 1

    def step(self) -> list[bytes]:
        """Advances by 2 ms; returns what is sent then: a state, or what faults make of it.

        Raises:
            SaltusError: the command is not finite, or the simulation diverges.
        """
        self._contacts += bool(self._plant.step(self._command).trunk_contact)
        self._ticks += 1
        return self.said()

    def said(self) -> list[bytes]:
        """The present state, or what faults make of it."""
        message = self._state()
        self._faults.on_state(message, self.time_s)
        return self._faults.on_way(LOW_STATE.sealed(message), self.time_s)

    def truth(self) -> bytes:
        """Truth about the present state, as it travels; no fault touches it."""
        plant, tick = self._plant, round(self.time_s / MS)
        return truth_payload(plant.state, plant.terrain, tick=tick, contacts=self._contacts)

    def _state(self) -> UnitreeMessage:
        plant = self._plant
        message = unitree_state_message(plant.sensed, plant.state.joint_torque, plant.robot)
        message["imu_state"]["gyroscope"] += GYRO_NOISE * self._noise.standard_normal(3)
        message["tick"] = round(self.time_s / MS)
        message["motor_state"]["temperature"][:12] = MOTOR_C
        message["foot_force"] = np.clip(plant.state.foot_force, 0, np.iinfo(np.int16).max)
        message["bms_state"]["soc"] = CHARGE_PERCENT
        message["bms_state"]["cell_vol"][:CELLS] = CELL_MV
        # Of the joints alone: what motors and computers lose is not simulated
        power_w = plant.state.joint_torque * plant.state.joint_velocity
        left = float(self._sag.left(power_w.clip(min=0.0).sum()))
        message["power_v"] = left * CELLS * CELL_MV * 1e-3
        message["power_a"] = max(float(power_w.sum()), 0.0) / (CELLS * CELL_MV * 1e-3)
        message["imu_state"]["temperature"] = BOARD_C
        message["temperature_ntc1"] = message["temperature_ntc2"] = BOARD_C
        return message


def holding_message(robot: Robot) -> bytes:
    """A command to hold the stand pose, as it travels."""
    return LOW_COMMAND.sealed(command_message(_holding(robot), robot))


def _holding(robot: Robot) -> JointCommand:
    one = np.ones(12)
    return JointCommand(
        position=robot.stand_pose, velocity=0.0 * one, torque=0.0 * one,
        kp=robot.gains.stand_kp * one, kd=robot.gains.stand_kd * one,
    )  # fmt: skip
