"""Stand-ins for camera, heightmap service and planner of a controller process,
over a memory bus.
"""

import threading
from contextlib import contextmanager

import numpy as np
from memory_bus import MemoryBus

from saltus.wire.messages import Done, MotionPlan, PlanStatus

PREFIX = "robot/0"


def make_plan(step, time_ns, status=PlanStatus.GO):
    return MotionPlan(
        time_ns=time_ns,
        step=step,
        status=status,
        stepping_frequency_hz=2.0,
        velocity_x=0.0,
        velocity_z=0.0,
        pitch_rate=0.0,
        foot_residual_front=np.array([0.0, 0.0, 0.05]),
        foot_residual_rear=np.array([0.0, 0.0, 0.05]),
        reason="",
    )


class StandIns:
    """Answers as camera, heightmap service and planner would; may be deaf to some questions."""

    def __init__(self, hub, alive=("render", "heightmap", "policy"), deaf_to_first=False):
        self._bus = MemoryBus(PREFIX, hub)
        self._truths = self._bus.latest("plant/truth")
        self._states = self._bus.latest("controller/state")
        self._plans = self._bus.publisher("policy/plan")
        self._done = {name: self._bus.publisher("done", name) for name in ("render", "heightmap")}
        self._alive = alive
        self._deaf_to = {"truth": set(), "state": set()} if deaf_to_first else None
        self._stop = threading.Event()

    @contextmanager
    def running(self):
        thread = threading.Thread(target=self._answer)
        thread.start()
        try:
            yield
        finally:
            self._stop.set()
            thread.join()

    def _hears(self, kind, step):
        if self._deaf_to is None or step in self._deaf_to[kind] or step % 20:
            return True
        self._deaf_to[kind].add(step)
        return False

    def _answer(self):
        while not self._stop.is_set():
            if (truth := self._truths.wait(0.001)) is not None and "render" in self._alive:
                step, now = truth.message.step, truth.message.time_ns
                if self._hears("truth", step):
                    self._done["render"].put(
                        Done(time_ns=now, step=step, process="render", frame_id=step // 2)
                    )
            if (state := self._states.wait(0.001)) is not None:
                step, now = state.message.step, state.message.time_ns
                if not self._hears("state", step):
                    continue
                if "heightmap" in self._alive:
                    self._done["heightmap"].put(Done(time_ns=now, step=step, process="heightmap"))
                if "policy" in self._alive:
                    self._plans.put(make_plan(step, now, PlanStatus.STAND))


def of(samples, kind):
    return [message for _, message in samples if isinstance(message, kind)]
