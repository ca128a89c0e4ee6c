"""One robot on the bus, as the heightmap process sees it."""

from collections.abc import Sequence

from saltus.heightmap.service.fleet import RobotRequest
from saltus.runtime.process import ProcessContext
from saltus.wire.bus import Sample
from saltus.wire.messages import Done, Heightmap, HeightmapStatus, RobotState
from saltus.wire.topics import Staleness, Topic, staleness_of

UNANSWERED_NS = (
    500_000_000  # so that a clock that differs is reported within 1 s of the robot's first state
)


class RobotInbox:
    """Takes a robot's states and frames, whose limits of age `depth` says,
    and publishes its heightmaps.

    They are under `heightmap/heightmap`, or `scan/heightmap` where the process has that name.

    Further cameras have names: their frames come below the first one's key.
    """

    def __init__(self, context: ProcessContext, depth: Topic, cameras: Sequence[str] = ()) -> None:
        self.context, self._depth = context, depth
        self.ticks = 0
        """Heightmaps so far."""
        self._lockstep = context.config.pace == "lockstep"
        self._states = context.bus.latest("controller/state")
        # In real time they are looked at when a state asks
        self._frames, *others = (
            context.bus.latest("camera/depth", name, rings=self._lockstep)
            for name in ("", *cameras)
        )
        self._others = dict(zip(cameras, others, strict=True))
        self._other_frames: dict[str, Sample] = {}
        self._heightmaps = context.bus.publisher(f"{context.name}/heightmap")
        self._done = context.bus.publisher("done", context.name)
        self._robot: bytes | None = None
        self._asked: Sample | None = None
        self._frame: Sample | None = None
        self._frame_id = -1
        self._status = HeightmapStatus.WARMING
        self._refused_ns: int | None = None
        """Since when no state could be answered."""
        self._told = False

    @property
    def name(self) -> str:
        """Prefix of the robot's keys."""
        return self.context.bus.prefix

    def take(self) -> RobotRequest | None:
        """Returns what the robot asks now, if it does; never waits.

        In lockstep a state asks only when the frame that is due with it has come, or not at all if
        a newer one comes first. In real time a state that is too old to be used asks nothing.
        """
        self._asked = self._states.take() or self._asked
        if self._asked is None:
            return None
        state: RobotState = self._asked.message
        boot = self._asked.envelope.boot_id
        if boot != self._robot:  # another robot, or one that has started anew
            self._robot = boot
            if self._lockstep:  # an image of the last run is not the one that is due
                self._frame, self._frame_id = None, -1
                self._other_frames.clear()
        self._take_frame()
        if self._lockstep:
            if self._frame_id < state.depth_due:
                return None
            self.context.clock.set(state.time_ns)
        self._asked = None
        now_ns = self.context.clock.now_ns()
        fresh = staleness_of(self._states.topic, state.time_ns, now_ns)
        if not fresh.usable:
            self._refuse(state, fresh, now_ns)
            return None
        self._refused_ns, self._told = None, False
        frame, self._frame = self._frame, None
        others, self._other_frames = self._other_frames, {}
        return RobotRequest(
            state=state,
            robot_boot=boot,
            frame=None if frame is None else frame.message,
            camera_boot=None if frame is None else frame.envelope.boot_id,
            now_ns=now_ns,
            others=others,
        )

    def _refuse(self, state: RobotState, why: Staleness, now_ns: int) -> None:
        """Counts a state that is not answered; says so once where that goes on."""
        self.context.bus.rejected[f"{self._states.topic.name}/{why.value}"] += 1
        self._refused_ns = now_ns if self._refused_ns is None else self._refused_ns
        if self._told or now_ns - self._refused_ns < UNANSWERED_NS:
            return
        self._told = True
        ahead_s = 1e-9 * (state.time_ns - now_ns)
        where = "ahead of" if ahead_s > 0.0 else "behind"
        detail = (
            f"states are {abs(ahead_s):.3f} s {where} the clock of this computer, "
            "by which they must be dated"
        )
        self.context.event("states_refused", detail)

    def _take_frame(self) -> None:
        newest = self._frames.take()
        if newest is not None:
            self._frame, self._frame_id = newest, newest.message.frame_id
        for name, frames in self._others.items():
            other = frames.take()
            if other is not None:
                self._other_frames[name] = other

    def answer(self, heightmap: Heightmap) -> None:
        """Publishes; says once when the status changes."""
        self._heightmaps.put(heightmap)
        if self._lockstep:
            self._done.put(
                Done(time_ns=heightmap.time_ns, step=heightmap.step, process=self.context.name)
            )
        self.ticks += 1
        if heightmap.status == self._status:
            return
        self._status = heightmap.status
        late = heightmap.depth_age_s > self._depth.degraded_age_s
        lost = late and heightmap.status == HeightmapStatus.INVALID
        code = "depth_lost" if lost else f"heightmap_{heightmap.status.name.lower()}"
        self.context.event(
            code, f"step {heightmap.step}, image {heightmap.depth_age_s * 1e3:.0f} ms old"
        )
