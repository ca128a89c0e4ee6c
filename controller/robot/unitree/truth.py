"""Truth about a simulated robot, which no real one says:
beside its states, for camera and judge of a run.
"""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.controller.robot.unitree.messages import ENCAPSULATION, MessageLayout
from saltus.recordings import ros_messages as ros
from saltus.sim.plant_state import PlantState
from saltus.terrain.terrain import Terrain

NAME = "saltus_msgs/msg/SimulatedRobot"
SHAPES = {
    "position_base_in_world": 3, "quaternion_base_in_world": 4, "velocity_base_in_world": 3,
    "angular_velocity_base": 3, "joint_position": 12, "foot_force": 4,
}  # fmt: skip
"""Fields of `PlantState` that are sent, and their sizes."""
FINGERPRINT = 16
ros.add_types({
    NAME: f"uint32 tick\nuint32 contacts\nuint8[{FINGERPRINT}] terrain\n"
    + "".join(f"float64[{size}] {name}\n" for name, size in SHAPES.items())
})  # fmt: skip
TRUTH = MessageLayout(NAME)


@dataclass(frozen=True, kw_only=True, eq=False)
class TruthSample:
    """The truth about a simulated robot at one instant (motion, contacts, terrain), as it sends it
    beside its states.
    """

    tick: int
    """Clock of the state that was said at the same instant [ms]."""
    contacts: int
    """Steps of 2 ms so far in which the trunk touched anything."""
    terrain: str
    """Fingerprint of the ground on which it is simulated."""
    motion: dict[str, Floats]
    """Values of `SHAPES`."""


def truth_payload(state: PlantState, terrain: Terrain, *, tick: int, contacts: int) -> bytes:
    """Truth as it travels; arguments as the fields of `TruthSample`."""
    message = np.zeros((), TRUTH.dtype)
    message["tick"], message["contacts"] = tick, contacts
    message["terrain"] = np.frombuffer(terrain.fingerprint.encode("ascii"), np.uint8)
    for name in SHAPES:
        message[name] = getattr(state, name)
    return TRUTH.payload(message)


def tick_of(payload: bytes) -> int:
    """`TruthSample.tick` alone; 0 of what is too short for one."""
    return int.from_bytes(payload[len(ENCAPSULATION) :][:4], "little")


def read_truth(payload: bytes) -> TruthSample:
    """The truth that a payload holds.

    Raises:
        MessageError: it is of another size or encoding.
    """
    message = TRUTH.read([payload])[0]
    return TruthSample(
        tick=int(message["tick"]), contacts=int(message["contacts"]),
        terrain=message["terrain"].tobytes().decode("ascii", "replace"),
        motion={name: message[name].astype(np.float64) for name in SHAPES},
    )  # fmt: skip
