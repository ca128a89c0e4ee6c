"""An operator pushes a robot: for so long, with that impulse, and nothing else changes."""

import numpy as np
import pytest
from memory_bus import MemoryBus
from samples import setup_of

from saltus.config import TerrainConfig
from saltus.constants import POLICY_DT, POLICY_STEPS, PUSH_STEPS
from saltus.controller.robot.mujoco import MujocoRobot
from saltus.controller.shove import HARDEST_NS, TrunkShove
from saltus.joint_command import JointCommand
from saltus.robots.loading import load_robot
from saltus.wire.messages import OPERATOR, Event

MASS_KG = 12.74  # of the Go1
PUSHES = {
    "15": 15.0, "-7.5": -7.5, "0": 0.0, "1e9": HARDEST_NS, "-inf": -HARDEST_NS, "nan": 0.0, "": 0.0,
    "hard": 0.0,
}  # fmt: skip


def ask(bus: MemoryBus, code: str, detail: str) -> None:
    bus.publisher("event", OPERATOR).put(
        Event(time_ns=0, process=OPERATOR, code=code, detail=detail)
    )


@pytest.mark.parametrize(("detail", "impulse"), PUSHES.items())
def test_the_impulse_is_the_one_that_is_named(detail: str, impulse: float) -> None:
    bus = MemoryBus("robot/0")
    shove = TrunkShove(bus)
    assert shove.step() == 0.0
    ask(bus, "push", detail)
    forces = [shove.step() for _ in range(PUSH_STEPS)]
    assert sum(forces) * POLICY_DT == pytest.approx(impulse)
    assert len(set(forces)) == 1
    assert shove.step() == 0.0


def test_another_push_takes_the_place_of_the_first() -> None:
    bus = MemoryBus("robot/0")
    shove = TrunkShove(bus)
    operator = bus.publisher("event", OPERATOR)
    operator.put(Event(time_ns=0, process=OPERATOR, code="push", detail="10"))
    assert shove.step() > 0.0
    operator.put(Event(time_ns=0, process=OPERATOR, code="push", detail="-10"))
    assert [np.sign(shove.step()) for _ in range(PUSH_STEPS + 1)] == [-1.0] * PUSH_STEPS + [0.0]


@pytest.mark.parametrize("code", ["stop", "kill", "blind", ""])
def test_other_events_push_nobody(code: str) -> None:
    bus = MemoryBus("robot/0")
    shove = TrunkShove(bus)
    ask(bus, code, "15")
    assert shove.step() == 0.0


@pytest.mark.parametrize("impulse", [4.0, -4.0])
def test_a_robot_that_is_pushed_goes_to_that_side(impulse: float) -> None:
    """With limp legs all of the impulse is the robot's,
    but for what its feet on the ground take or give.
    """
    kind, none = load_robot("go1"), np.zeros(12)
    limp = JointCommand(position=none, velocity=none, kp=none, kd=none, torque=none)
    speed = []
    for force in (0.0, impulse / (PUSH_STEPS * POLICY_DT)):
        robot = MujocoRobot(setup_of(TerrainConfig(terrain="flat"), robot=kind))
        robot.reset()
        robot.push(force)
        for _ in range(PUSH_STEPS * POLICY_STEPS):
            robot.write(limp)
        speed.append(float(robot.state.velocity_base_in_world[1]))
    assert (speed[1] - speed[0]) / impulse == pytest.approx(1.0 / MASS_KG, rel=0.1)
