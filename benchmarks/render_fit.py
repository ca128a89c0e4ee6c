"""Exactness with which the fit of the stereo camera finds hidden parameters,
on rendered recordings of a step and a wall.

Each camera has its own baseline, sub-pixel noise and disparity step, and looks from its own pose
past a step of its own at a wall, while the robot stands. Embree renders both views at 424 x 240,
the chain makes the frames. The figures are median and largest errors of each parameter.

    saltus bench render_fit -- --cameras 96
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks._command import Command, progress, tell
from saltus.depth import D435I, depth_frame, depth_in_millimetres
from saltus.render.camera import RobotCamera
from saltus.render.stereo.camera import UNFILTERED, StereoCamera, StereoConfig
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_embree import StereoEmbree
from saltus.render.stereo_fit import fit_stereo
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.terrain import FIRST_EDGE_X, Terrain, build_course
from saltus.wire.messages import DepthFrame

ROBOT = load_robot(DEFAULT_ROBOT)
PERIOD_S = 1.0 / 30.0  # rate of a D435i at 424x240 as it comes out of the box
STEPS_PX = (1 / 16, 1 / 32, 1 / 64)
HIDDEN = ("baseline_m", "sigma_px", "step_px")
WALL_M = 1.5  # high: beyond what the camera sees of it


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    cameras: int = 24
    """Number of cameras that are drawn and fitted."""
    frames: int = 60
    """Frames of each recording."""
    seed: int = 0
    """Seed of what is drawn."""

    def measure(self) -> dict[str, Any]:
        return summary([self._camera(index) for index in progress(range(self.cameras))])

    def _camera(self, index: int) -> dict[str, float | None]:
        rng = np.random.default_rng([self.seed, index])
        hidden = HiddenCamera.draw(rng)
        found = errors(hidden, recording(hidden, self.frames, rng))
        off = ", ".join(
            f"{n} {'untestable' if e is None else f'{100 * e:+.1f} %'}" for n, e in found.items()
        )
        true = (
            f"{1e3 * hidden.baseline_m:.1f} mm, {hidden.sigma_px:.3f} px, "
            f"1/{1 / hidden.step_px:.0f} px"
        )
        tell(f"camera {index:2} ({true}): {off}")
        return found


@dataclass(frozen=True, kw_only=True)
class HiddenCamera:
    """Parameters that the fit must find, and the view that it has."""

    baseline_m: float
    sigma_px: float
    step_px: float
    height_m: float
    """Height of the step."""
    depth_m: float
    """Depth of the step, along the course."""
    before_wall_m: float
    """From the step to the wall."""
    distance_m: float
    """From the robot's centre to the step."""
    trunk_m: float
    """Height of the robot's centre."""
    roll: float
    pitch: float
    yaw: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "HiddenCamera":
        """Any camera that stereo could be, before any scene with a step and a wall in view."""
        return cls(
            baseline_m=rng.uniform(0.040, 0.070),
            sigma_px=float(np.exp(rng.uniform(np.log(0.04), np.log(0.15)))),
            step_px=float(rng.choice(STEPS_PX)),
            height_m=rng.uniform(0.15, 0.30),
            depth_m=rng.uniform(0.1, 0.4),
            before_wall_m=rng.uniform(0.4, 1.0),
            distance_m=rng.uniform(0.6, 1.0),
            trunk_m=rng.uniform(0.28, 0.45),
            roll=rng.uniform(-0.2, 0.2),
            pitch=rng.uniform(-0.1, 0.1),
            yaw=rng.uniform(-0.6, 0.6),
        )

    @property
    def terrain(self) -> Terrain:
        """A step across the course, and a wall behind it."""
        return build_course(
            "step",
            {},
            [(self.depth_m, self.height_m), (self.before_wall_m, 0.0)],
            last_top=WALL_M,
            finish_behind=1.0,
        )

    @property
    def config(self) -> StereoConfig:
        """The camera, without post-filters."""
        noise = replace(UNFILTERED.disparity_noise, sigma=self.sigma_px)
        step = replace(UNFILTERED.disparity_step, step=self.step_px)
        return replace(UNFILTERED, disparity_noise=noise, disparity_step=step)


def recording(hidden: HiddenCamera, count: int, rng: np.random.Generator) -> list[DepthFrame]:
    """Frames of a robot that stands, as the camera sends them."""
    optics = StereoOptics.of(D435I, baseline_m=hidden.baseline_m)
    angles = (np.asarray(angle) for angle in (hidden.roll, hidden.pitch, hidden.yaw))
    position = np.array([FIRST_EDGE_X - hidden.distance_m, 0.0, hidden.trunk_m])
    pair = StereoEmbree(hidden.terrain, optics, RobotCamera.on(ROBOT, D435I))
    scene = pair.render_pair(position, quaternion_from_roll_pitch_yaw(*angles), ROBOT.stand_pose)
    return frames_of(StereoCamera(hidden.config, optics), scene, count, rng)


def frames_of(
    camera: StereoCamera, scene: tuple[Any, Any], count: int, rng: np.random.Generator
) -> list[DepthFrame]:
    """Returns what a D435i sends of a scene at rest:
    depth and what the right imager does not see.
    """
    state = camera.init((), rng)
    frames = []
    for k in range(count):
        image, state = camera.step(*scene, np.asarray(PERIOD_S * k), state)
        depth = depth_in_millimetres(image.depth)
        frames.append(depth_frame(D435I, depth, time_ns=round(1e9 * PERIOD_S * k), frame_id=k))
    return frames


def errors(hidden: HiddenCamera, frames: list[DepthFrame]) -> dict[str, float | None]:
    """Relative errors by parameter; None where the fit calls one untestable."""
    found = fit_stereo(frames).parameters
    result: dict[str, float | None] = {}
    for name in HIDDEN:
        value, true = getattr(found, name).value, getattr(hidden, name)
        result[name] = None if value is None else value / true - 1.0
    return result


def summary(rows: list[dict[str, float | None]]) -> dict[str, Any]:
    """Median and largest error [%] of each parameter, and how often it was untestable."""
    result: dict[str, Any] = {"cameras": len(rows)}
    for name in HIDDEN:
        size = [abs(100.0 * row[name]) for row in rows if (row[name]) is not None]  # type: ignore[operator]
        result[name] = {
            "median_percent": round(float(np.median(size)), 2),
            "worst_percent": round(max(size), 2),
            "untestable": len(rows) - len(size),
        }
    return result
