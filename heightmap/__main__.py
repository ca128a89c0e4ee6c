"""The heightmap process: answers every robot state with a heightmap."""

import sys
from pathlib import Path

from heightmap.service import HeightmapService
from saltus.bus import Sample
from saltus.messages import DepthFrame, Done, Heightmap, HeightmapStatus, RobotState
from saltus.process import ProcessContext, run_process
from saltus.resources import resource
from saltus.ticker import freshness

WAIT_S = 0.1


class HeightmapProcess:
    """Wires the service to bus and clock."""

    def __init__(self, context: ProcessContext) -> None:
        chosen = context.config.heightmap_model
        self._context = context
        self._service = HeightmapService(Path(chosen) if chosen else resource("models/heightmap.onnx"))
        self._states = context.bus.latest("controller/state")
        self._frames = context.bus.latest("camera/depth")
        self._heightmaps = context.bus.publisher("heightmap/heightmap")
        self._done = context.bus.publisher("done", context.name)
        self._robot: bytes | None = None
        self._frame_id = -1
        self._status = HeightmapStatus.WARMING
        self.ticks = 0

    def run(self) -> None:
        """Answers until the process is told to stop. Without robot states it only shows that it is alive."""
        pending: Sample | None = None
        while not self._context.stopped:
            self._context.beat(ticks=self.ticks)
            sample = pending or self._states.wait(WAIT_S)
            pending = self._answer(sample) if sample is not None else None

    def _answer(self, sample: Sample) -> Sample | None:
        """Answers one state; returns a newer one that came while it waited for the image of this one."""
        state: RobotState = sample.message
        if sample.envelope.boot_id != self._robot:  # another robot, or one that has started anew
            self._robot = sample.envelope.boot_id
            self._service.reset()
            self._frame_id = -1
        if self._context.config.pace == "lockstep":
            self._context.clock.set(state.time_ns)
            frame, newer = self._due_frame(state)
            if newer is not None or self._context.stopped:
                return newer
        elif freshness(self._states.topic, state.time_ns, self._context.clock.now_ns()).usable:
            frame = self._take_frame()
        else:
            return None
        heightmap = self._service.step(state, frame, self._context.clock.now_ns())
        self._heightmaps.put(heightmap)
        self._done.put(Done(time_ns=state.time_ns, step=state.step, process=self._context.name))
        self._tell(heightmap)
        self.ticks += 1
        return None

    def _take_frame(self) -> DepthFrame | None:
        sample = self._frames.take()
        if sample is None:
            return None
        self._frame_id = sample.message.frame_id
        return sample.message

    def _due_frame(self, state: RobotState) -> tuple[DepthFrame | None, Sample | None]:
        """Lockstep: the frame that is due with `state`, waited for; or a newer state that ends the waiting."""
        frame = self._take_frame()
        while self._frame_id < state.depth_due and not self._context.stopped:
            self._context.beat(ticks=self.ticks)
            sample = self._frames.wait(WAIT_S)
            if sample is not None:
                frame, self._frame_id = sample.message, sample.message.frame_id
                continue
            newer = self._states.take()
            if newer is not None and newer.message.step != state.step:
                return None, newer
        return frame, None

    def _tell(self, heightmap: Heightmap) -> None:
        """Says once when the status changes."""
        if heightmap.status == self._status:
            return
        self._status = heightmap.status
        late = heightmap.depth_age_s > self._frames.topic.degraded_age_s
        lost = late and heightmap.status == HeightmapStatus.INVALID
        code = "depth_lost" if lost else f"heightmap_{heightmap.status.name.lower()}"
        self._context.event(code, f"step {heightmap.step}, image {heightmap.depth_age_s * 1e3:.0f} ms old")


def body(context: ProcessContext) -> None:
    """Runs the process; see `saltus.process`."""
    process = HeightmapProcess(context)
    context.ready()
    process.run()


if __name__ == "__main__":
    sys.exit(run_process("heightmap", body))
