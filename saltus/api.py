"""Functions that `import saltus` offers beside what other modules define:
one call for a task, arrays for messages.

Each function only puts together what the commands are made of; docs/python.md shows all of them.
Heavy libraries load when a function is called, not before.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from saltus.arrays import Floats
from saltus.errors import ConfigError
from saltus.grid import HeightGrid
from saltus.used_networks import model_path
from saltus.wire.messages import ControllerMode, DepthFrame, RobotState

if TYPE_CHECKING:
    from saltus.depth import Intrinsics
    from saltus.depth_camera import DepthCamera
    from saltus.effects.profile import Profile
    from saltus.heightmap.service.service import HeightmapService
    from saltus.loop.heights import HeightsFactory
    from saltus.loop.loop import Moment
    from saltus.loop.planner import Planner
    from saltus.real2sim.progress import ProgressListener
    from saltus.real2sim.results import Judgement
    from saltus.robots.robot import Robot
    from saltus.terrain.terrain import Terrain
    from saltus.trial import Outcome
    from saltus.wire.messages import Heightmap

Heights: TypeAlias = Literal["true", "true-exact", "predicted"]
"""The heights that a planner sees, as `saltus policy eval --heightmap` names them."""


def depth_frames(camera: "Intrinsics", depth_m: ArrayLike, time_s: ArrayLike) -> list[DepthFrame]:
    """Images of a depth camera as messages.

    Args:
        camera: Its pin-hole model.
        depth_m: Along the optical axis [m], rows from the top, shape (n, height, width); 0 is
            invalid, infinite is "nothing within range".
        time_s: When each image was taken [s], shape (n,), rising, in the clock of the states.

    Raises:
        ConfigError: shapes that do not fit each other, depth that is not a number, or times that do
            not rise.
    """
    from saltus.depth import depth_frame, depth_in_millimetres

    depth, time_ns = np.asarray(depth_m, np.float64), _nanoseconds(time_s)
    wanted = (len(time_ns), camera.height, camera.width)
    if depth.shape != wanted:
        raise ConfigError(
            f"depth_m has the shape {depth.shape}: it must be {wanted}, (images, height, width)"
        )
    if not (depth >= 0.0).all():
        raise ConfigError("depth_m holds what is negative or no number: set invalid pixels to 0")
    images = depth_in_millimetres(depth)
    return [
        depth_frame(camera, images[i], time_ns=time_ns[i], frame_id=i) for i in range(len(time_ns))
    ]


def robot_states(
    time_s: ArrayLike,
    *,
    quaternion_base_in_world: ArrayLike,
    angular_velocity_base: ArrayLike,
    joint_position: ArrayLike,
    velocity_base_in_world: ArrayLike,
    base_height: ArrayLike,
    leg_trusted: ArrayLike,
) -> list[RobotState]:
    """States of one robot as messages, with what the heightmap network reads; the rest is zero.

    Args:
        time_s: Of each state [s], shape (n,), rising; 100 a second.
        quaternion_base_in_world: (w, x, y, z), z of the world up, shape (n, 4).
        angular_velocity_base: Gyroscope [rad/s], shape (n, 3).
        joint_position: Hip, thigh and calf of the legs FR, FL, RR, RL [rad], shape (n, 12).
        velocity_base_in_world: Estimate [m/s], shape (n, 3).
        base_height: Of the trunk's centre above the feet that stand [m], shape (n,).
        leg_trusted: Whether the foot may be taken to be on the ground, shape (n, 4).

    Raises:
        ConfigError: a shape that does not fit, a value that is not finite, or times that do not
            rise.
    """
    time_ns = _nanoseconds(time_s)
    count = len(time_ns)
    quaternion = _array("quaternion_base_in_world", quaternion_base_in_world, (count, 4))
    angular_velocity = _array("angular_velocity_base", angular_velocity_base, (count, 3))
    joints = _array("joint_position", joint_position, (count, 12))
    velocity = _array("velocity_base_in_world", velocity_base_in_world, (count, 3))
    height = _array("base_height", base_height, (count,))
    trusted = _array("leg_trusted", leg_trusted, (count, 4)) != 0.0
    return [
        RobotState(
            time_ns=time_ns[i],
            step=i,
            quaternion_base_in_world=quaternion[i],
            angular_velocity_base=angular_velocity[i],
            acceleration_base=np.zeros(3),
            joint_position=joints[i],
            joint_velocity=np.zeros(12),
            joint_torque=np.zeros(12),
            velocity_base_in_world=velocity[i],
            base_height=float(height[i]),
            leg_contact=trusted[i],
            leg_progress=np.zeros(4),
            leg_trusted=trusted[i],
            cycle=0,
            mode=ControllerMode.RUN,
            depth_due=-1,
        )
        for i in range(count)
    ]


def make_predictor(robot: "Robot", model: str | Path | None = None) -> "HeightmapService":
    """The heightmap service of one robot, to be called state by state:
    `step(state, frame, now_ns)`.

    Args:
        robot: That the model was made for.
        model: ONNX file; by default the shipped one.

    Raises:
        ModelError: the file is damaged, or made for another robot or camera.
    """
    from saltus.heightmap.service.network import HeightmapNetwork
    from saltus.heightmap.service.service import HeightmapService

    return HeightmapService(HeightmapNetwork(robot, model_path("heightmap", model)))


def predict_heights(
    robot: "Robot",
    frames: Sequence[DepthFrame],
    states: Sequence[RobotState],
    model: str | Path | None = None,
) -> "list[Heightmap]":
    """The heights ahead at every state, each with half of its 90 % interval and a status.

    Args:
        robot: That the model was made for.
        frames: In the order in which they were taken; each is used from 50 ms later on, as on the
            robot.
        states: 100 a second, in order, in the clock of the frames.
        model: ONNX file; by default the shipped one.

    Raises:
        ModelError: the file is damaged, or made for another robot or camera.
    """
    from saltus.heightmap.service.network import HeightmapNetwork
    from saltus.heightmap.service.replay import replay_frames

    return replay_frames(HeightmapNetwork(robot, model_path("heightmap", model)), frames, states)


def roll_out(
    robot: "Robot",
    terrain: "Terrain",
    *,
    planner: "Planner | None" = None,
    trials: int = 10,
    seed: int = 0,
    heights: Heights = "true",
    camera: "str | DepthCamera" = "d435i",
    profile: "str | Profile" = "shipped",
    grid: "HeightGrid | None" = None,
    on_step: "Callable[[Moment], object] | None" = None,
) -> "list[Outcome]":
    """Lets a planner drive robots over a terrain, one trial for each seed, in one process.

    Args:
        robot: Which one, for all.
        terrain: The same for all.
        planner: By default the shipped policy; see `make_planner`.
        trials: How many robots.
        seed: Of the first trial; the others have seed + 1, seed + 2, ... A seed draws start,
            friction, payload, motor strength and delays.
        heights: "true": with the shift of each trial; "true-exact": without; "predicted": what the
            shipped predictor makes of the images of `camera`.
        camera: Name, TOML file, or the camera itself.
        profile: Effects of the hardware: a name, a TOML file, or the profile itself.
        grid: Where the planner is given heights; by default that of the shipped policy.
        on_step: Called with every step of all robots, 100 times a second of theirs.

    Returns:
        How each trial went, in the order of the seeds.

    Raises:
        ConfigError: no trials, or a camera or profile that is not known.
        ModelError: a policy of another robot.
    """
    from saltus.loop.loop import Loop
    from saltus.named_setup import named_setups
    from saltus.policy.actor import grid_of
    from saltus.policy.evaluation.evaluate import HEIGHTS
    from saltus.policy.planner import make_planner
    from saltus.trial import Trial

    if trials < 1:
        raise ConfigError(f"trials = {trials}: it must be at least 1")
    source: HeightsFactory
    if heights == "predicted":
        from saltus.heightmap.data.predicted import PredictedHeightsFactory

        source = PredictedHeightsFactory()
    else:
        source = HEIGHTS[heights]
    drawn, grid = (
        [Trial.draw(seed + i) for i in range(trials)],
        grid or grid_of(model_path("policy", robot=robot.name)),
    )
    setups = named_setups(robot, grid, camera, profile, [terrain] * trials, drawn)
    driver = planner or make_planner("learned", setups[0].robot, grid)
    loop = Loop(setups, driver, heights=source(setups))
    for step in loop.run():
        if on_step is not None:
            on_step(step)
    return [outcome for outcome in loop.outcomes if outcome is not None]


def find_effects(
    runs: Sequence[str | Path],
    out: str | Path,
    *,
    profile: str = "ideal",
    seed: int = 0,
    report: bool = True,
    progress: "ProgressListener | None" = None,
) -> "Judgement":
    """Finds which effects the simulator lacks to explain logs of one robot:
    what `saltus real2sim find` does.

    Args:
        runs: Folders of run logs, or folders or recordings of runs of Saltus, whose logs are
            written into OUT/logs.
        out: Folder for verdict.json, patch.toml and report.html.
        profile: Effects that the simulator has already, besides what the logs claim: a name or a
            TOML file.
        seed: Of the bootstrap.
        report: Whether to write report.html.
        progress: Called with the stage and the share that is done.

    Returns:
        The verdict, the patch and what they stand on.

    Raises:
        SaltusError: a log that cannot be read or compared with anything, or a folder that cannot be
            written.
    """
    from saltus.effects.profile import load_profile
    from saltus.real2sim.pipeline import find_in_logs
    from saltus.real2sim.problem.log import robot_of_runs
    from saltus.recordings.run_log_export import as_run_log

    folder = Path(out)
    logs = [as_run_log(Path(run), folder / "logs" / Path(run).name) for run in runs]
    effects = load_profile(profile, robot_of_runs(logs))
    return find_in_logs(logs, folder, profile=effects, seed=seed, report=report, progress=progress)


def _nanoseconds(time_s: ArrayLike) -> list[int]:
    """Times [s], shape (n,), in whole nanoseconds; `ConfigError` where they do not rise."""
    seconds = np.asarray(time_s, np.float64)
    if seconds.ndim != 1 or not np.isfinite(seconds).all() or (np.diff(seconds) <= 0.0).any():
        raise ConfigError("time_s must be finite times that rise, one for each entry, in seconds")
    return [round(1e9 * second) for second in seconds.tolist()]


def _array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Floats:
    array = np.asarray(values, np.float64)
    if array.shape != shape:
        raise ConfigError(f"{name} has the shape {array.shape}: it must be {shape}")
    if not np.isfinite(array).all():
        raise ConfigError(f"{name} holds values that are not finite")
    return array
