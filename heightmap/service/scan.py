"""The service of any grid: states and images of any depth cameras in,
one heightmap with a status for every state out.

No robot, camera or grid is named in it: what is known of them stands in `ScanRig`.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np

from saltus.arrays import Singles
from saltus.dialects import dialect_of
from saltus.grid import HeightGrid
from saltus.heightmap.scan.elevation import MapUpdate
from saltus.heightmap.scan.odometry_trail import OdometryTrail, TrailPose
from saltus.heightmap.scan.own_body import NoBody, OwnBody
from saltus.heightmap.scan.predictor import GridHeights, ScanNetwork, ScanPredictor
from saltus.heightmap.scan.scan_camera import ScanCamera
from saltus.heightmap.service.image_watch import DEPTH, NO_FRAME, ImageWatch, less_trusted
from saltus.heightmap.service.quantiles import UNKNOWN_HALF_WIDTH_M
from saltus.heightmap.service.rolling_feet import RollingFeet
from saltus.heightmap.service.sight import BAD_OUTPUTS_TO_FORGET, BLIND_INVALID_PIXELS
from saltus.loop.shadows import deepen_shadows
from saltus.robots.robot import Robot
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus, RobotState
from saltus.wire.topics import Topic

WARM_IMAGES = 10
"""Images until heights are as good as models/scan.md says: its figures are of what came after a
second, in which the slowest cameras of training take ten."""
LEGS_SLOPE = 1.0
"""`MapSettings.matched_slope` where the odometry is a robot's legs, whose feet are corrected for
rolling: up stairs of 0.25 m they were 9 mm off after 0.4 s, and 16 mm with what matching makes of
their edges (docs/scan.md)."""
LEGS_STEP_M = 0.002
"""`MapSettings.step_m` there: by an image, 20 ms, the odometry of legs is 0.2 to 0.7 mm off along
its way (1 to 3 % of it), and of bounding legs 1 to 2 mm in height (0.05 to 0.09 m/s in real-time
runs: with 1 mm the ground of such a run was 11 to 13 mm off, with 2 mm 5 to 6, with 4 mm 4 to 5).
With the 4 mm of odometry of any kind matching made jumps in height of 12 mm within 0.05 s on
stairs, with 2 mm of 6 (98 % of them)."""
LEGS_ODOMETRY_ERROR = 0.3
"""`MapUpdate.odometry_error` there: they are 1 to 3 % off along their way, but know the attitude
better than training's odometry does. Of 0, 0.1, 0.3 and 0.6 in six runs (seed 8) the smallest with
which 89 % of the points that were never seen are inside their half-widths."""
LEGS_CLIMB_GAIN = 2.0
"""Velocity that is added to the odometry of legs for what images and feet raise it by [1/s]: what
they do again and again for half a second is an error of its velocity. Legs of a robot that bounds
climb by up to 0.07 m/s too little, so that images of 60 ms ago are 4 mm off (docs/scan.md)."""
LEGS_FOOT_GAIN = 0.15
"""`MapSettings.foot_gain` there: feet that sink are below the ground of images, and those near
edges beside it."""
FIRST = ""
"""Name of the camera whose images come under `camera/depth` itself."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanRig:
    """Everything that is known of a robot whose ground is asked for: cameras, mounts, body; and the
    form of the answer.
    """

    grid: HeightGrid
    cameras: Mapping[str, ScanCamera]
    """By name: images of `FIRST` come under `camera/depth`, of others under `camera/depth/NAME`."""
    dialect: str = ""
    """Name of the dialect of the observation (`saltus.dialects`); empty: none is sent."""
    robot: Robot | None = None
    """Robot whose legs say where the feet are that stand (`leg_trusted`); None: states tell
    `standing_feet`."""
    body: OwnBody = field(default_factory=NoBody)
    shadows: bool = False
    """Heights are for a planner of jumps, which reads them alone: ground that no image showed is
    told as beside it, where all is the same to the side (`Prism`), and then ground in doubt that
    leads down is told lower (`saltus.loop.shadows`)."""


class PredictionWorker(Protocol):
    """Anything that runs the scan's network: at once, or in a thread of its own."""

    def submit(self, work: "Callable[[], _Look]", /) -> "Future[_Look]":
        """Begins with it."""
        ...


class AtOnce:
    """Runs the scan's network before it returns, so that answers repeat to the bit."""

    def submit(self, work: "Callable[[], _Look]", /) -> "Future[_Look]":
        """See `PredictionWorker`."""
        done: Future[_Look] = Future()
        done.set_result(work())
        return done


class _Shown(NamedTuple):
    """An image that waits to be looked at, or was."""

    camera: str
    frame: DepthFrame
    arrival_ns: int
    exposed: TrailPose


class _Look(NamedTuple):
    """Outcome of looking at some images."""

    shown: list[_Shown]
    missing: list[float]
    """Share of pixels without depth that should have one, of each."""
    plausible: bool
    raised_m: float = 0.0
    """By how much they raised the place that the odometry tells [m]."""


class ScanService:
    """Predicts the ground of one robot on any grid; one call of `step` for each robot state.

    Images that have come are looked at together, moved to where the newest was taken. While a
    `worker` looks at some, states are answered from what was known before, and the newest image of
    each camera waits. Ages and statuses are those of `ImageWatch`, the best of all cameras; where
    one of several is lost, heights are DEGRADED.

    Raises:
        ConfigError: an unknown dialect.
    """

    def __init__(
        self,
        network: ScanNetwork,
        rig: ScanRig,
        depth: Topic = DEPTH,
        worker: PredictionWorker | None = None,
    ) -> None:
        self._network, self._rig, self._depth = network, rig, depth
        self._worker: PredictionWorker = worker or AtOnce()
        self._map = network.settings
        self._odometry_error = 1.0 if rig.robot is None else LEGS_ODOMETRY_ERROR
        if rig.robot is not None:
            self._map = replace(
                self._map, matched_slope=LEGS_SLOPE, step_m=LEGS_STEP_M, foot_gain=LEGS_FOOT_GAIN
            )
        self._dialect = dialect_of(rig.dialect) if rig.dialect else None
        self._x, self._y = np.array(rig.grid.x), np.array(rig.grid.y)
        self.reset()

    @property
    def last(self) -> Heightmap | None:
        """The newest answer."""
        return self._last

    @property
    def sole(self) -> float:
        """Height of a standing foot's centre above the ground as images show it [m]: its radius,
        less what it sinks by; 0 of a robot without legs.
        """
        return 0.0 if self._rolling is None else self._rolling.sole

    def reset(self) -> None:
        """Forgets everything: for a robot that has started anew."""
        self._watches = {name: ImageWatch(self._depth, moved=True) for name in self._rig.cameras}
        self._trail = OdometryTrail()
        self._rolling = None if self._rig.robot is None else RollingFeet(self._rig.robot)
        self._waiting: dict[str, _Shown] = {}
        self._last: Heightmap | None = None
        self._started_ns = 0
        self._forget()

    def new_camera(self, camera: str) -> None:
        """Counts the images of a camera anew that has started anew; what was seen holds on."""
        self._watches[camera].new_camera()

    def step(
        self, state: RobotState, frames: DepthFrame | Mapping[str, DepthFrame] | None, now_ns: int
    ) -> Heightmap:
        """Goes on to a state.

        Returns the heightmap at its time, an old answer for a state that has one.

        Args:
            state: Of the robot.
            frames: Frames that have arrived since the last call, by camera, or that of the only
                one.
            now_ns: The run's clock.
        """
        if self._last is not None and state.step <= self._last.step:
            return self._last
        if self._last is None:
            self._started_ns = now_ns
        missing = None
        if self._rolling is not None:
            missing = self._rolling.missing(state) + np.array([0.0, 0.0, self._climb_mps])
        if self._trail.add(state, missing):
            self._waiting.clear()
            self._forget()
        for watch in self._watches.values():
            watch.begin(now_ns)
        by_camera = {FIRST: frames} if isinstance(frames, DepthFrame) else frames or {}
        for camera, frame in by_camera.items():
            self._accept(camera, frame, now_ns)
        feet = self._feet(state)
        self._look(state, feet)
        self._stand(state, feet)
        self._last = self._heightmap(state, self._status(state, now_ns))
        return self._last

    def _forget(self) -> None:
        """Empties the map; what is being looked at counts no more."""
        self._predictor = ScanPredictor(self._network, self._map, extends=self._rig.shadows)
        self._looking: Future[_Look] | None = None
        self._bad_outputs, self._climb_mps = 0, 0.0

    def _accept(self, camera: str, frame: DepthFrame, now_ns: int) -> None:
        exposed = self._trail.at(frame.time_ns)
        before = self._waiting.get(camera)
        newer = before is None or frame.time_ns > before.frame.time_ns
        if exposed is not None and newer and self._watches[camera].is_news(frame, now_ns):
            self._waiting[camera] = _Shown(camera, frame, now_ns, exposed)

    def _look(self, state: RobotState, feet: Singles) -> None:
        """Takes in what was seen, and looks at what has come; at once where nobody else does it."""
        self._take_in()
        if self._looking is None and self._waiting:
            shown = sorted(self._waiting.values(), key=lambda each: each.frame.time_ns)
            self._waiting.clear()
            predictor, now = self._predictor, self._trail.now
            self._looking = self._worker.submit(
                lambda: self._seen(predictor, shown, feet, now, state)
            )
            self._take_in()

    def _take_in(self) -> None:
        if self._looking is None or not self._looking.done():
            return
        look, self._looking = self._looking.result(), None
        for shown, missing in zip(look.shown, look.missing, strict=True):
            used = missing <= BLIND_INVALID_PIXELS and look.plausible
            self._watches[shown.camera].take(shown.frame, missing, shown.arrival_ns, used=used)
        self._climb_mps += LEGS_CLIMB_GAIN * look.raised_m
        self._bad_outputs = 0 if look.plausible else self._bad_outputs + 1
        if self._bad_outputs >= BAD_OUTPUTS_TO_FORGET:
            self._forget()

    def _seen(
        self,
        predictor: ScanPredictor,
        shown: list[_Shown],
        feet: Singles,
        now: TrailPose,
        state: RobotState,
    ) -> _Look:
        """Looks at images with a robot's map; changes nothing else."""
        newest, missing = shown[-1].exposed, []
        points: list[Singles] = []
        depths: list[Singles] = []
        viewpoints: list[Singles] = []
        mount_error = max(self._rig.cameras[each.camera].mount_error for each in shown)
        height = _body_height(self._rig.robot, state)
        for each in shown:
            there = each.exposed
            found = self._rig.cameras[each.camera].points(each.frame, there.rotation[2], height)
            kept = np.flatnonzero(~self._rig.body.holds(found.points, there.joint_position))
            turn = (newest.rotation.T @ there.rotation).astype(np.float32)
            away = (newest.rotation.T @ (there.position - newest.position)).astype(np.float32)
            missing.append(found.missing)
            if found.missing <= BLIND_INVALID_PIXELS:
                points.append(turn @ found.points.T.take(kept, axis=1) + away[:, None])
                depths.append(found.depth[kept])
                viewpoint = self._rig.cameras[each.camera].position @ turn.T + away
                viewpoints.append(np.full_like(points[-1], viewpoint[:, None]))
        if not points:
            return _Look(shown, missing, plausible=True)
        measured = MapUpdate(
            points=np.concatenate(points, axis=1).T[None], depth=np.concatenate(depths)[None],
            exposed=newest.pose,
            now=now.pose, feet=feet[None], standing=np.ones((1, len(feet)), np.bool_),
            body_height=np.full(1, height, np.float32),
            exposed_s=np.full(1, self._time_s(newest.time_ns), np.float32),
            odometry_error=np.full(1, self._odometry_error, np.float32),
            mount_error=np.full(1, mount_error, np.float32),
            viewpoint=np.concatenate(viewpoints, axis=1).T[None],
        )  # fmt: skip
        before = predictor.correction[2]
        plausible = predictor.see(measured, self._time_s(now.time_ns))
        return _Look(shown, missing, plausible, raised_m=float(predictor.correction[2] - before))

    def _feet(self, state: RobotState) -> Singles:
        """Ground under the feet that surely stand, base frame [m], shape (n, 3)."""
        told = np.asarray(state.standing_feet, np.float32)
        if self._rolling is None:
            return told
        centres = self._rolling.centres[np.asarray(state.leg_trusted)]
        under = centres - self.sole * self._trail.now.rotation[2]
        return np.concatenate([under.astype(np.float32), told])

    def _stand(self, state: RobotState, feet: Singles) -> None:
        """Tells how far standing feet are below the ground that images showed there."""
        if self._rolling is not None and self._predictor.images and np.any(state.leg_trusted):
            trusted = feet[: np.count_nonzero(state.leg_trusted)]
            gap = self._predictor.above(self._trail.now.pose, trusted)
            self._rolling.stand(gap[np.abs(gap) < self._map.gate_m])

    def _time_s(self, time_ns: int) -> float:
        """A time on the clock of the map, which begins where the service did:
        single precision holds it for days.
        """
        return 1e-9 * (time_ns - self._started_ns)

    def _status(self, state: RobotState, now_ns: int) -> HeightmapStatus:
        warm = self._predictor.images >= WARM_IMAGES
        found = [watch.status(state.time_ns, now_ns, warm=warm) for watch in self._watches.values()]
        worst = best = found[0]
        for status in found[1:]:
            worst = less_trusted(worst, status)
            best = best if less_trusted(best, status) == status else status
        status = best if best == worst else less_trusted(best, HeightmapStatus.DEGRADED)
        return less_trusted(status, HeightmapStatus.DEGRADED) if self._bad_outputs else status

    def _heightmap(self, state: RobotState, status: HeightmapStatus) -> Heightmap:
        rig, grid = self._rig, self._rig.grid
        views = [watch.view for watch in self._watches.values() if watch.view is not None]
        newest = max(views, key=lambda view: view.time_ns, default=None)
        ground = self._ground(state)
        if rig.shadows:
            height, half_width = deepen_shadows(ground.height, ground.half_width, grid)
            ground = ground._replace(height=height, half_width=half_width)
        age_s = self._time_s(state.time_ns) - ground.seen_s
        return Heightmap(
            time_ns=state.time_ns, step=state.step, x=self._x, y=self._y,
            height=ground.height,
            half_width_90=ground.half_width, status=status,
            depth_age_s=np.inf if newest is None else 1e-9 * (state.time_ns - newest.time_ns),
            frame_id=NO_FRAME if newest is None else newest.frame_id,
            model_id=self._network.model_id,
            seen_share=np.count_nonzero(np.isfinite(age_s)) / grid.size, age_s=age_s.clip(0.0),
            dialect=rig.dialect,
            observation=(
                np.zeros(0) if self._dialect is None
                else self._dialect.observation(ground.height, grid)
            ),
        )  # fmt: skip

    def _ground(self, state: RobotState) -> GridHeights:
        """The answer of the map; level ground that nobody knows before the first image."""
        grid, now = self._rig.grid, self._trail.now
        if not self._predictor.images:
            level = np.full(grid.size, -_body_height(self._rig.robot, state))
            return GridHeights(
                level, np.full(grid.size, UNKNOWN_HALF_WIDTH_M), np.full(grid.size, -np.inf)
            )
        return self._predictor.ground(
            now.pose, float(np.arctan2(now.rotation[1, 0], now.rotation[0, 0])), grid
        )


def _body_height(robot: Robot | None, state: RobotState) -> float:
    """About how high above the ground the base is when the robot stands [m]."""
    return float(state.base_height) if robot is None else robot.stand_height
