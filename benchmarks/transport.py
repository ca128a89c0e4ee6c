"""What the bus costs: codec times, and latency from one process to another through a router on loopback.

    saltus bench transport

The sender publishes at 100 Hz from a process of its own; latency is the monotonic time from before `put` to after
`wait`, so it holds encoding, two hops of TCP, the receiver's polling and decoding. Prints one JSON object.
"""

import argparse
import json
import multiprocessing
import time
import timeit
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from saltus import go1
from saltus.bus import ZenohBus
from saltus.codec import decode, encode
from saltus.messages import ControllerMode, DepthFrame, Message, MotionPlan, PlanStatus, RobotState
from saltus.stack import open_router
from saltus.ticker import Ticker

PREFIX = "bench"
RATE_HZ = 100.0
WARM_UP = 20
REPEATS = 7
NUMBER = 300


def sample_messages() -> dict[str, Message]:
    """One message a topic, in the sizes that travel."""
    depth = np.random.default_rng(0).integers(0, 3000, (240, 424), dtype=np.uint16)
    frame = DepthFrame(time_ns=0, frame_id=0, depth=depth, depth_unit_m=0.001, fx=213.0, fy=213.0, cx=212.0, cy=120.0)
    state = RobotState(
        time_ns=0,
        step=0,
        quaternion_base_in_world=np.array([1.0, 0.0, 0.0, 0.0]),
        angular_velocity_base=np.zeros(3),
        acceleration_base=np.zeros(3),
        joint_position=go1.STAND_POSE,
        joint_velocity=np.zeros(12),
        joint_torque=np.zeros(12),
        velocity_base_in_world=np.zeros(3),
        base_height=go1.STAND_HEIGHT,
        leg_contact=np.ones(4, dtype=bool),
        leg_progress=np.zeros(4),
        leg_trusted=np.ones(4, dtype=bool),
        cycle=0,
        mode=ControllerMode.STAND,
        depth_due=-1,
    )
    plan = MotionPlan(
        time_ns=0,
        step=0,
        status=PlanStatus.GO,
        stepping_frequency_hz=3.0,
        velocity_x=1.0,
        velocity_z=0.0,
        pitch_rate=0.0,
        foot_residual_front=np.zeros(3),
        foot_residual_rear=np.zeros(3),
        reason="",
    )
    return {"policy/plan": plan, "controller/state": state, "camera/depth": frame}


def send(endpoint: str, topic: str, count: int) -> None:
    """The sending process."""
    message = sample_messages()[topic]
    ticker = Ticker(RATE_HZ)
    with ZenohBus(endpoint, PREFIX) as bus:
        publisher = bus.publisher(topic)
        for _ in range(count):
            ticker.wait()
            publisher.put(replace(message, time_ns=time.monotonic_ns()))


def latencies_ms(endpoint: str, topic: str, count: int) -> list[float]:
    """Receives what another process sends."""
    sender = multiprocessing.get_context("spawn").Process(target=send, args=(endpoint, topic, count))
    times: list[float] = []
    with ZenohBus(endpoint, PREFIX) as bus:
        latest = bus.latest(topic)
        sender.start()
        while sender.is_alive():
            sample = latest.wait(0.1)
            if sample is not None:
                times.append(1e-6 * (time.monotonic_ns() - sample.message.time_ns))
    sender.join()
    return times[WARM_UP:]


def microseconds(call: Callable[[], object]) -> float:
    """Median over repeats of the mean time of a call."""
    return float(np.median(timeit.repeat(call, number=NUMBER, repeat=REPEATS))) / NUMBER * 1e6


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="messages of each topic")
    options = parser.parse_args()
    endpoint, router = open_router()
    table = {}
    for topic, message in sample_messages().items():
        data, kind = encode(message), type(message)
        times = latencies_ms(endpoint, topic, options.count)
        p50, p99 = np.percentile(times, [50, 99])
        table[topic] = {
            "bytes": len(data),
            "encode_us": round(microseconds(lambda m=message: encode(m)), 1),  # type: ignore[misc]
            "decode_us": round(microseconds(lambda k=kind, d=data: decode(k, d)), 1),  # type: ignore[misc]
            "latency_p50_ms": round(float(p50), 3),
            "latency_p99_ms": round(float(p99), 3),
            "received": len(times) + WARM_UP,
            "sent": options.count,
        }
    router.close()
    print(json.dumps({"transport": table}))


if __name__ == "__main__":
    main()
