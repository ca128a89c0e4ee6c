"""A process that publishes robot states at 100 Hz, as a controller does, until the time limit of the run."""

import sys

import numpy as np

from saltus import go1
from saltus.runtime.process import ProcessContext, run_process
from saltus.runtime.ticker import Ticker
from saltus.wire.messages import ControllerMode, RobotState


def state_at(step: int, time_ns: int) -> RobotState:
    return RobotState(
        time_ns=time_ns,
        step=step,
        quaternion_base_in_world=np.array([1.0, 0.0, 0.0, 0.0]),
        angular_velocity_base=np.zeros(3),
        acceleration_base=np.array([0.0, 0.0, 9.81]),
        joint_position=go1.STAND_POSE,
        joint_velocity=np.zeros(12),
        joint_torque=np.zeros(12),
        velocity_base_in_world=np.zeros(3),
        base_height=go1.STAND_HEIGHT,
        leg_contact=np.ones(4, dtype=bool),
        leg_progress=np.zeros(4),
        leg_trusted=np.zeros(4, dtype=bool),
        cycle=0,
        mode=ControllerMode.STAND,
        depth_due=-1,
    )


def body(context: ProcessContext) -> None:
    states = context.bus.publisher("controller/state")
    context.ready()
    ticker = Ticker(100.0, clock=context.clock)
    while not context.stopped and ticker.ticks < 100 * context.config.time_limit_s:
        ticker.wait()
        context.beat(ticks=ticker.ticks, overruns=ticker.overruns)
        states.put(state_at(ticker.ticks, context.clock.now_ns()))


if __name__ == "__main__":
    sys.exit(run_process("states", body))
