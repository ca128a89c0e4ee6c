"""Flags of a terrain and of a run, which commands share."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from saltus.config import (
    JUMPING_CAMERA,
    WALKING_CAMERA,
    Pace,
    RendererName,
    RunConfig,
    RunHeights,
    RunPlanner,
    TerrainConfig,
)
from saltus.flags import flag_help
from saltus.grid import DEFAULT_GRID, WALKING_GRID, load_grid
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.terrain.curriculum import FAMILIES

if TYPE_CHECKING:
    from saltus.depth_camera import DepthCamera
    from saltus.robots.robot import Robot
    from saltus.wire.router import NetworkAccess


def _shown(size: str, otherwise: str = "") -> Any:
    """Help of a size: its default in each family that has it, or `otherwise`."""
    sizes = {name: family.sizes[size] for name, family in FAMILIES.items() if size in family.sizes}
    defaults = ", ".join(f"{value.default:g} {name}" for name, value in sizes.items())
    by_difficulty = any(value.base is not None for value in sizes.values())
    kind = "INT" if size == "steps" else "FLOAT"
    return flag_help(
        kind, otherwise or defaults + ("; or by the difficulty" if by_difficulty else "")
    )


@dataclass(frozen=True, kw_only=True)
class SizedCourse(TerrainConfig):
    """Flags that choose a terrain and its size. A size that is given wins over the difficulty."""

    difficulty: Annotated[
        float | None, _shown("difficulty", "none; 0.5 of a family of your own")
    ] = None
    steps: Annotated[int | None, _shown("steps")] = None
    rise_m: Annotated[float | None, _shown("rise_m")] = None
    run_m: Annotated[float | None, _shown("run_m")] = None
    stone_m: Annotated[float | None, _shown("stone_m")] = None
    gap_m: Annotated[float | None, _shown("gap_m")] = None
    gap_max_m: Annotated[float | None, _shown("gap_max_m", "none, all are alike")] = None
    height_m: Annotated[float | None, _shown("height_m")] = None
    depth_m: Annotated[float | None, _shown("depth_m")] = None
    depth_max_m: Annotated[float | None, _shown("depth_max_m", "none, depth_m")] = None
    slope_deg: Annotated[float | None, _shown("slope_deg")] = None


CourseOptions = tyro.conf.OmitArgPrefixes[SizedCourse]


@dataclass(frozen=True, kw_only=True)
class RobotOption:
    """Flag of a command for any robot."""

    robot: str = DEFAULT_ROBOT
    """A robot that Saltus ships, or the path of an MJCF or of a folder with a robot.toml."""


@dataclass(frozen=True, kw_only=True)
class ModelOptions:
    """Flags of a command that runs both networks."""

    policy_model: Annotated[Path | None, flag_help("PATH", "the shipped policy")] = None
    """ONNX file of the learned planner, or of a policy that walks, or a TOML file about that."""
    heightmap_model: Annotated[Path | None, flag_help("PATH", "the shipped model")] = None
    """ONNX file of the heightmap service; scan: the shipped network of any robot and grid."""


@dataclass(frozen=True, kw_only=True)
class HardwareOptions:
    """Flags of a robot's hardware."""

    profile: str = "shipped"
    """Effects of the hardware: shipped (those of the robot), ideal, one of your own, or a TOML
    file."""
    known: Annotated[str | None, flag_help("STR", "nothing")] = None
    """Profile of what is known of the drives: the leg controller makes up for its torque gain and
    viscous friction."""


@dataclass(frozen=True, kw_only=True)
class RunOptions(ModelOptions, HardwareOptions, RobotOption):
    """Flags of a run of the whole stack, of `demo` and `up` alike."""

    course: CourseOptions = field(default_factory=SizedCourse)
    seed: int = 0
    """Seed of everything that is drawn."""
    pace: Pace
    """lockstep: bit-repeatable, as fast as it goes. realtime: by the clock, times speed."""
    speed: float = 1.0
    """With realtime: seconds of the run for each second of this computer.

    Less than 1 where it cannot keep up.
    """
    camera: Annotated[
        str | None, flag_help("STR", f"{JUMPING_CAMERA}; {WALKING_CAMERA} with --planner walking")
    ] = None
    """d435i: with the errors of a stereo camera. d435i_whole: its whole image. ideal: true depth.

    Or a TOML file, see saltus camera show.
    """
    renderer: RendererName = "auto"
    """Back end that renders the images.

    Auto: embree, or the fastest for a camera without errors.
    """
    planner: RunPlanner = "learned"
    """scripted: rules that read the heightmap. learned: a network. walking: a network that follows
    commands (saltus drive) on the 187 heights of the scan; told to jump, the robot jumps by its
    shipped policy, or by rules where there is none."""
    heights: RunHeights = "predicted"
    """predicted: by the heightmap service's network, of the camera's images. true: the ground as
    the simulator has it, to compare with."""
    commands: Annotated[Path | None, flag_help("PATH", "none")] = None
    """Script of commands, as of saltus drive --script, by the time of the run."""
    out: Annotated[Path | None, flag_help("PATH", "a new one under runs/")] = None
    """Folder for everything, in place of what an earlier run left there."""

    def config(self, time_limit_s: float) -> RunConfig:
        """The configuration of the run, checked:
        what is wrong with it is said before anything starts.

        Raises:
            ConfigError, ModelError: what is wrong.
        """
        from saltus.controller.compensation import compensation_for
        from saltus.drive.script import WishScript
        from saltus.effects.heightmap_shift import refuse_shift
        from saltus.effects.profile import load_profile
        from saltus.terrain.curriculum import make_terrain
        from saltus.used_networks import SCAN

        walks = self.planner == "walking"
        named = self.camera or (WALKING_CAMERA if walks else JUMPING_CAMERA)
        camera, robot = mounted_camera(named, load_robot(self.robot))
        make_terrain(self.course)
        refuse_shift(load_profile(self.profile, robot).heightmap, "a robot that sees with a camera")
        compensation_for(self.known, robot)
        policy, heightmap = (
            None if path is None else str(path)
            for path in (self.policy_model, self.heightmap_model)
        )
        if self.commands is not None:
            WishScript(self.commands)
        if heightmap is None and not walks and self.robot != DEFAULT_ROBOT:
            heightmap = SCAN
        if walks:
            self._check_walking(robot)
        else:
            self._check_jumping(camera, robot, heightmap)
        config = RunConfig(
            robot=self.robot, grid=WALKING_GRID if walks else DEFAULT_GRID, terrain=self.course,
            seed=self.seed,
            pace=self.pace,
            camera=named, renderer=self.renderer, profile=self.profile, known=self.known,
            planner=self.planner, heights=self.heights,
            policy_model=policy, heightmap_model=heightmap, speed=self.speed,
            commands=None if self.commands is None else str(self.commands),
            time_limit_s=time_limit_s,
        )  # fmt: skip
        config.check()
        return config

    def _check_walking(self, robot: "Robot") -> None:
        """Refuses networks that cannot walk this robot or see for it."""
        from saltus.heightmap.scan.predictor import ScanNetwork
        from saltus.policy.joints.policy import JointPolicy
        from saltus.used_networks import model_path, walking_path

        policy = JointPolicy(walking_path(self.robot, self.policy_model))
        policy.refuse_other(robot)
        load_grid(WALKING_GRID).places_of(policy.description.height_grid())
        ScanNetwork(model_path("scan", self.heightmap_model))

    def _check_jumping(self, camera: "DepthCamera", robot: "Robot", heightmap: str | None) -> None:
        """Refuses networks that cannot make this robot jump or see for it."""
        from saltus.heightmap.data.predicted import load_predictor
        from saltus.policy.planner import make_planner
        from saltus.used_networks import model_path

        is_other = self.robot != DEFAULT_ROBOT  # for which the shipped models were not made
        is_elsewhere = any(value is not None for value in camera.mount.values())
        if heightmap is not None or is_elsewhere:
            load_predictor(model_path("heightmap", heightmap), robot, load_grid(DEFAULT_GRID))
        if self.planner != "walking" and (self.policy_model is not None or is_other):
            make_planner(self.planner, robot, load_grid(DEFAULT_GRID), self.policy_model)


@dataclass(frozen=True, kw_only=True)
class NetworkOptions:
    """Whom a router lets in besides the programs of its own machine."""

    listen: Annotated[str | None, flag_help("HOST:PORT", "none, this machine only")] = None
    """Where others join over a network, each with a certificate of --keys."""
    keys: Path = Path("keys")
    """Folder of saltus keys."""

    def network(self, prefix: str) -> "NetworkAccess | None":
        """How others join; `ConfigError` where there is no authority, or the address is none."""
        if self.listen is None:
            return None
        from saltus.wire.certificates import network_of

        return network_of(self.keys, self.listen, prefix)


def mounted_camera(name_or_path: str, robot: "Robot") -> tuple["DepthCamera", "Robot"]:
    """A camera, all of it checked, and the robot that has its camera there.

    Raises:
        SaltusError: there is no such camera, it has errors that there are not, or sits inside of
            the trunk.
    """
    from saltus.depth_camera import load_camera
    from saltus.render.camera import RobotCamera
    from saltus.render.stereo.camera import StereoConfig

    camera = load_camera(name_or_path)
    StereoConfig.of(camera)
    mounted = camera.mounted_on(robot)
    RobotCamera.on(mounted, camera.image)
    return camera, mounted
