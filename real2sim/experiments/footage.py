"""Images that a depth camera with the effects of a profile delivers of a robot that moves."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.depth import D435I, Intrinsics
from saltus.effects.image_pixels import to_images
from saltus.effects.profile import Profile
from saltus.real2sim.problem.camera.rays import claimed_mount
from saltus.recordings.run_claims import CameraClaim
from saltus.recordings.run_log import DepthTable
from saltus.render.camera import RobotCamera
from saltus.robots.mount import Mount
from saltus.robots.robot import Robot
from saltus.sim.plant_state import PlantState
from saltus.terrain.terrain import Terrain

POOLING = 5  # as many pixels of the D435i as make one of the model's image
AXIAL_NOISE = 1.3e-3  # standard deviation over squared depth [1/m], plane fits on frames of a D435i
RANGE_MAX_M = 10.0  # D435i datasheet


WIDTH, HEIGHT = D435I.width // POOLING, D435I.height // POOLING
POOLED_D435I = Intrinsics(
    width=WIDTH, height=HEIGHT, fx=D435I.fx / POOLING, fy=D435I.fy / POOLING,
    cx=(D435I.cx - 0.5 * (D435I.width - POOLING * WIDTH)) / POOLING, cy=D435I.cy / POOLING,
)  # fmt: skip
"""420 x 240 pixels of the D435i, pooled by five."""


@dataclass(frozen=True, kw_only=True)
class FootageCamera:
    """The camera of an experiment, as its log will claim it."""

    rate_hz: float = 50.0
    latency_s: float = 0.0
    intrinsics: Intrinsics = POOLED_D435I
    """Intrinsics of its images."""
    mount: Mount

    @classmethod
    def on(cls, robot: Robot, latency_s: float = 0.0) -> "FootageCamera":
        """A camera where the robot has its own."""
        return cls(latency_s=latency_s, mount=Mount.of(robot))

    @classmethod
    def of(cls, claim: CameraClaim) -> "FootageCamera":
        """The camera that a run log claims (`meta.camera`),
        its images pooled until none is larger than the D435i's.
        """
        by = max(1, -(-int(claim["width"]) // WIDTH))
        intrinsics = Intrinsics(
            width=int(claim["width"]) // by, height=int(claim["height"]) // by,
            **{name: float(claim[name]) / by for name in ("fx", "fy", "cx", "cy")},
        )  # fmt: skip
        return cls(
            rate_hz=float(claim["rate"]),
            latency_s=float(claim["latency"]),
            intrinsics=intrinsics,
            mount=claimed_mount(claim),
        )

    def claim(self) -> CameraClaim:
        """`meta.camera` of a run log."""
        return {
            "fx": self.intrinsics.fx,
            "fy": self.intrinsics.fy,
            "cx": self.intrinsics.cx,
            "cy": self.intrinsics.cy,
            "width": self.intrinsics.width,
            "height": self.intrinsics.height,
            "position": self.mount.position.tolist(),
            "roll": float(self.mount.roll),
            "pitch": float(self.mount.pitch),
            "yaw": float(self.mount.yaw),
            "rate": self.rate_hz,
            "latency": self.latency_s,
            "range_max": RANGE_MAX_M,
        }


def film_experiment(
    robot: Robot,
    camera: FootageCamera,
    profile: Profile,
    terrain: Terrain,
    capture_s: Floats,
    states: Sequence[PlantState],
    rng: np.random.Generator,
) -> DepthTable:
    """Images as they arrive.

    Args:
        robot: That carries the camera.
        camera: As claimed; the effects of `profile` are what it does in truth.
        profile: Its camera part.
        terrain: What there is to see.
        capture_s: When images are exposed [s], shape (n,).
        states: Of the robot then.
        rng: Of the noise and of what effects draw.
    """
    # Open3D is slow to load, and motions without a camera need none
    from saltus.render.embree import EmbreeRenderer

    claimed = RobotCamera(robot=robot, intrinsics=camera.intrinsics, mount=camera.mount)
    renderer = EmbreeRenderer(terrain, claimed.moved(profile.view_chain), threads=1)
    poses = ("position_base_in_world", "quaternion_base_in_world", "joint_position")
    depth = renderer.render_batch(
        *(np.array([getattr(state, name) for state in states]) for name in poses)
    ).astype(np.float64)
    depth += (
        AXIAL_NOISE
        * np.where(np.isfinite(depth), depth, 0.0) ** 2
        * rng.standard_normal(depth.shape)
    )
    depth[~(depth <= RANGE_MAX_M)] = 0.0
    shown, arrival_s = to_images(profile, camera.intrinsics.fx).camera_chain.film(
        depth, capture_s, rng
    )
    kept = np.isfinite(arrival_s)
    return DepthTable(
        arrival_s=arrival_s[kept],
        capture_s=None,
        frame_id=np.flatnonzero(kept).astype(np.int64),
        depth_mm=np.rint(1e3 * shown[kept]).astype(np.uint16),
    )
