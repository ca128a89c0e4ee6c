"""Services of any grid for several robots, one for each, and how a command names them."""

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from saltus.config import RunPlanner
from saltus.depth_camera import DepthCamera, load_camera
from saltus.dialects import dialect_of
from saltus.errors import ConfigError
from saltus.grid import DEFAULT_GRID, HeightGrid, load_grid
from saltus.heightmap.scan.own_body import BodyBox, NoBody, OwnBody, RobotBody
from saltus.heightmap.scan.predictor import ScanNetwork, is_scan
from saltus.heightmap.scan.scan_camera import ScanCamera
from saltus.heightmap.service.fleet import RobotRequest
from saltus.heightmap.service.image_watch import DEPTH
from saltus.heightmap.service.scan import FIRST, AtOnce, PredictionWorker, ScanRig, ScanService
from saltus.robots.mount import Mount
from saltus.robots.robot import Robot
from saltus.used_networks import model_path
from saltus.wire.messages import Heightmap
from saltus.wire.topics import Topic

ROBOT_BODY, NO_BODY = "robot", "none"


@dataclass(frozen=True, kw_only=True)
class ScanChoice:
    """Which heights are to be served around the robot of a run: grid, form, model and cameras."""

    grid: HeightGrid
    dialect: str = ""
    """Name of the dialect of the observation; empty: none."""
    cameras: tuple[DepthCamera, ...] = ()
    """The first sends under `camera/depth`, others under `camera/depth/NAME`.

    None: the run's own.
    """
    body: str = ROBOT_BODY
    """"robot": legs and trunk are those of the run's robot. "none", or length, width and height of
    a box around the base [m], as 0.6x0.4x0.5: the robot has no model, and states tell its standing
    feet."""
    model: Path | None = None
    """ONNX file; None: the shipped one."""
    shadows: bool = False
    """See `ScanRig.shadows`."""

    @classmethod
    def of_flags(
        cls, grid: str | None, dialect: str | None, cameras: Sequence[str | Path], body: str,
        model: Path | None,
    ) -> Self | None:  # fmt: skip
        """The heights that flags ask for; None for the line of one robot.

        Args:
            grid: A name or a TOML file, as `load_grid` takes it; None or the line's: no scan.
            dialect: None or empty: none.
            cameras: Names or TOML files, as `load_camera` takes them.
            body: See `body`.
            model: See `model`.

        Raises:
            ConfigError: no such grid, dialect or camera, or flags of a grid without one.
        """
        if not grid or grid == DEFAULT_GRID:
            if dialect or cameras or body != ROBOT_BODY:
                raise ConfigError("--dialect, --cameras and --body need a grid: --grid scan")
            return None
        if dialect:
            dialect_of(dialect)
        return cls(
            grid=load_grid(grid), dialect=dialect or "",
            cameras=tuple(load_camera(str(path)) for path in cameras), body=body, model=model,
        )  # fmt: skip

    @classmethod
    def of_run(cls, grid: HeightGrid, model: str | None, planner: RunPlanner) -> Self | None:
        """The heights of a run's grid by the network that the run names;
        None where it is of the line.

        A planner that jumps is told of shadows; one that walks was measured without.

        Raises:
            ModelError: its file cannot be read.
        """
        path = model_path("heightmap", model)
        if model is None or not is_scan(path):
            return None
        return cls(grid=grid, model=path, shadows=planner != "walking")

    def network(self) -> ScanNetwork:
        """The network that is to run; `ModelError` where it cannot."""
        return ScanNetwork(model_path("scan", self.model))

    def rig(self, robot: Robot, own: DepthCamera) -> ScanRig:
        """Everything about the robot of a run, whose camera is `own`.

        Raises:
            ConfigError: two cameras of one name, or a body that is none.
        """
        cameras = self.cameras or (own,)
        names = [FIRST, *(camera.name for camera in cameras[1:])]
        if len(set(names)) < len(names) or "" in names[1:] or any("/" in name for name in names):
            raise ConfigError(
                f"names of cameras: {', '.join(names[1:])}: each must have one of its own, without "
                "/"
            )
        mounts = {
            name: ScanCamera(Mount.of(camera.mounted_on(robot)), camera.range_m, camera.mount_error)
            for name, camera in zip(names, cameras, strict=True)
        }
        return ScanRig(
            grid=self.grid, cameras=mounts, dialect=self.dialect,
            robot=robot if self.body == ROBOT_BODY else None, body=self._body(robot),
            shadows=self.shadows,
        )  # fmt: skip

    def _body(self, robot: Robot) -> OwnBody:
        if self.body == ROBOT_BODY:
            return RobotBody(robot)
        if self.body == NO_BODY:
            return NoBody()
        try:
            length, width, height = (float(side) for side in self.body.split("x"))
        except ValueError:
            raise ConfigError(
                f"body = '{self.body}': it must be robot, none, or the sides of a box [m], as "
                "0.6x0.4x0.5"
            ) from None
        return BodyBox((length, width, height))

    def missing(self, robot: Robot) -> str:
        """One line about what the service is not told of the robot,
        and what that costs (docs/scan.md).
        """
        if self.body == ROBOT_BODY:
            return (
                f"legs and trunk of {robot.name} are taken out of the images, and its feet tell "
                "the ground: of another "
                "robot say --body none, or its box, as --body 0.6x0.4x0.5"
            )
        body = (
            "the robot's own body stays in the images: if cameras see it, ground under it is up to "
            "60 mm off for 8"
            if self.body == NO_BODY
            else "a box stands for the body: legs outside of it are taken for ground"
        )
        return (
            f"{body}; feet are those that states tell in standing_feet: without any, "
            "heights are 1 mm worse"
        )


class ScanFleet:
    """Answers the states of several robots, by name; each has a map of its own.

    In real time images are looked at in one thread beside, so that states are answered meanwhile.
    """

    def __init__(
        self,
        network: ScanNetwork,
        rig: ScanRig,
        robots: Iterable[str],
        depth: Topic = DEPTH,
        *,
        at_once: bool,
    ) -> None:
        self._pool = (
            None if at_once else ThreadPoolExecutor(max_workers=1, thread_name_prefix="scan")
        )
        worker: PredictionWorker = self._pool or AtOnce()
        self._services = {robot: ScanService(network, rig, depth, worker) for robot in robots}
        self._boots: dict[tuple[str, str | None], bytes] = {}

    def step(self, arrivals: Mapping[str, RobotRequest]) -> dict[str, Heightmap]:
        """Answers those robots that ask, by name, each as `ScanService.step` would."""
        return {name: self._answer(name, arrival) for name, arrival in arrivals.items()}

    def close(self) -> None:
        """Waits for the image that is looked at."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def _answer(self, robot: str, arrival: RobotRequest) -> Heightmap:
        service = self._services[robot]
        if self._is_new(robot, None, arrival.robot_boot):
            service.reset()
        frames = {}
        for camera, frame, boot in arrival.images:
            known = (robot, camera) in self._boots
            if self._is_new(robot, camera, boot) and known:
                service.new_camera(camera)
            frames[camera] = frame
        return service.step(arrival.state, frames, arrival.now_ns)

    def _is_new(self, robot: str, camera: str | None, boot: bytes) -> bool:
        """True where this sender has not spoken before; `camera` is None for the robot itself."""
        before, self._boots[robot, camera] = self._boots.get((robot, camera)), boot
        return boot != before
