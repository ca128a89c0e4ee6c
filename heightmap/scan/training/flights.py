"""Cameras that fly over random ground: images,
odometry and feet as a robot gets them, and the truth.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from saltus.heightmap.scan.cells import cell_centres
from saltus.heightmap.scan.elevation import ElevationMap, MapContext, MapUpdate, OdometryPoses
from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.flight_cameras import FlightCameras, draw_cameras, with_errors
from saltus.heightmap.scan.training.flight_motion import FEET, FlightMotion, draw_motion, in_base
from saltus.heightmap.scan.training.flight_odometry import FlightOdometry, draw_odometry
from saltus.heightmap.scan.training.ground_patches import GroundPatches, draw_ground, heights_at
from saltus.heightmap.scan.training.pose_tables import rotation_of_angles, turn_by_yaw, values_at
from saltus.heightmap.scan.training.raster_rays import first_hits
from saltus.heightmap.scan.training.seeded_random import SeededRandom
from saltus.heightmap.scan.training.settings import FlightSettings

SEEN_M = 2.4
"""Points that are farther ahead than this lie outside of every map [m]."""
KINEMATICS_M = 0.004
"""By how much a robot does not know where its foot is [m]."""
HEIGHT_KNOWN_M = 0.04
"""By how much a robot does not know its usual height [m]."""
LOWEST_BODY_M = 0.16
ERRORS_KNOWN = 0.3
"""Standard deviation of the logarithm of `FlightDraws.told_errors` around the true ones."""

RayMarch = Callable[..., Tensor]
"""`first_hits`, or the same compiled."""
Batch = TypeVar("Batch", bound=tuple)


class FlightDraws(NamedTuple):
    """Everything that is drawn of a batch of robots, once per flight."""

    ground: GroundPatches
    motion: FlightMotion
    odometry: FlightOdometry
    cameras: FlightCameras
    rate_hz: Tensor
    """Images a second, shape (robots,)."""
    latency_s: Tensor
    """From exposure to arrival, shape (robots,)."""
    tells_feet: Tensor
    """True where the robot tells its feet, shape (robots,)."""
    told_height: Tensor
    """Height of the body above the ground, as the robot knows it [m], shape (robots,)."""
    told_errors: Tensor
    """Errors of odometry and mounts, as the robot knows them, in units of usual ones.
    Shape (robots, 2)."""
    image: Tensor
    """Number of the next image, shape (robots,)."""


class FlightImage(NamedTuple):
    """One image of every robot."""

    measured: MapUpdate
    now_s: Tensor
    """Time of its arrival since the flight began [s], shape (robots,)."""
    hits: Tensor
    """Where valid rays truly ended, in the world [m], shape (robots, n, 3)."""
    position: Tensor
    """True place of the base now, in the world [m], shape (robots, 3); and `angles` [rad]."""
    angles: Tensor
    believed_yaw: Tensor
    """Yaw by the odometry now [rad], shape (robots,)."""


def draw_flight(robots: int, settings: FlightSettings, draws: SeededRandom) -> FlightDraws:
    """Flights at their beginning."""
    ground = draw_ground(robots, settings, draws)
    rate = draws.log_uniform(*settings.rate_hz, robots)
    latency = draws.uniform(*settings.latency_s, robots)
    camera_height = draws.log_uniform(*settings.height_m, robots)
    body_height = (camera_height - draws.uniform(*settings.above_m, robots)).clamp(
        min=LOWEST_BODY_M
    )
    motion = draw_motion(ground, body_height, latency + settings.images / rate, settings, draws)
    odometry = draw_odometry(motion, settings, draws)
    cameras = draw_cameras(camera_height, body_height, settings, draws)
    return FlightDraws(
        ground=ground,
        motion=motion,
        odometry=odometry,
        cameras=cameras,
        rate_hz=rate,
        latency_s=latency,
        tells_feet=draws.chance(settings.feet, robots),
        told_height=body_height + draws.normal(HEIGHT_KNOWN_M, robots),
        told_errors=torch.stack((odometry.scale, cameras.unknown))
        .mul(draws.normal(ERRORS_KNOWN, 2, robots).exp())
        .T,
        image=torch.zeros(robots, dtype=torch.long, device=draws.device),
    )


def redraw_robots(flight: Batch, rows: Tensor, other: Batch) -> Batch:
    """Puts what is drawn of other robots in place of some, in place."""
    for mine, new in zip(flight, other, strict=True):
        if isinstance(mine, Tensor):
            mine[rows] = new
        else:
            redraw_robots(mine, rows, new)
    return flight


def next_image(
    flight: FlightDraws, settings: FlightSettings, draws: SeededRandom, march: RayMarch = first_hits
) -> FlightImage:
    """The next image of every robot; the flight's number of images goes on."""
    exposed_s = flight.image / flight.rate_hz
    now_s = exposed_s + flight.latency_s
    flight.image.add_(1)
    points, depth, viewpoint, hits = _image(flight, exposed_s, settings, draws, march)
    position, angles = (values_at(table, now_s) for table in flight.motion[:2])
    feet, standing = _feet(flight, now_s, position, angles, draws)
    believed = values_at(flight.odometry.angles, now_s)
    now = OdometryPoses(values_at(flight.odometry.position, now_s), rotation_of_angles(believed))
    then = OdometryPoses(
        values_at(flight.odometry.position, exposed_s),
        rotation_of_angles(values_at(flight.odometry.angles, exposed_s)),
    )
    odometry_error, mount_error = flight.told_errors.unbind(-1)
    measured = MapUpdate(
        points, depth, then, now, feet, standing, flight.told_height, exposed_s, odometry_error,
        mount_error, viewpoint,
    )  # fmt: skip
    return FlightImage(measured, now_s, hits, position, angles, believed[:, 2])


def _image(
    flight: FlightDraws,
    exposed_s: Tensor,
    settings: FlightSettings,
    draws: SeededRandom,
    march: RayMarch,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Points in the base as measured [m], their depth [m], where their cameras are said to be in
    the base [m], and where the rays truly ended [m].
    """
    cameras, n = flight.cameras, len(exposed_s)
    base, turn = (
        values_at(flight.motion.position, exposed_s),
        rotation_of_angles(values_at(flight.motion.angles, exposed_s)),
    )
    origin = base[:, None] + (turn[:, None] @ cameras.true_position[..., None])[..., 0]
    rays = cameras.rays @ (turn[:, None] @ cameras.true_rotation).mT
    count = rays.shape[2]
    start = origin[:, :, None].expand_as(rays).flatten(1, 2)
    rays = rays.flatten(1, 2)
    far = torch.minimum(cameras.far[:, None], SEEN_M / rays[..., :2].norm(dim=-1).clamp(min=1e-3))
    near = torch.full_like(far, 0.01)
    true = march(flight.ground, start, rays, near, far, settings.raster_m, settings.samples)
    image = true.view(n, 2, settings.rows, settings.columns // 2)
    depth = with_errors(image, cameras, draws).reshape(n, 2, count)
    seen = cameras.rays * depth[..., None]
    viewpoint = cameras.position[:, :, None].expand_as(seen)
    points = seen @ cameras.rotation.mT + viewpoint
    hits = start + true[..., None] * rays
    return points.flatten(1, 2), depth.flatten(1), viewpoint.flatten(1, 2), hits


def _feet(
    flight: FlightDraws, now_s: Tensor, position: Tensor, angles: Tensor, draws: SeededRandom
) -> tuple[Tensor, Tensor]:
    """Standing feet in the base [m], and which are told to stand."""
    motion = flight.motion
    place = (now_s / 0.01).round().long().clamp(max=motion.feet.shape[1] - 1)
    robots = torch.arange(len(now_s), device=now_s.device)
    feet = in_base(motion.feet[robots, place], position, angles)
    return (
        feet + draws.normal(KINEMATICS_M, len(now_s), FEET, 3),
        motion.standing[robots, place] & flight.tells_feet[:, None],
    )


def true_map_heights(
    flight: FlightDraws, shot: FlightImage, state: ElevationMap, around: MapContext,
    map_settings: MapSettings,
    settings: FlightSettings,
) -> Tensor:  # fmt: skip
    """Heights of the map's cells as they truly are around the base,
    in the odometry's corrected world [m].

    Heights are relative to the base, which the robot believes at `around.base` and at its believed
    yaw.
    """
    x, y = cell_centres(state.corner, map_settings, around.base)
    side = map_settings.side
    offset = torch.stack(
        torch.broadcast_tensors(x - around.base[:, :1, None], y - around.base[:, 1:2, None]), -1
    )
    place = turn_by_yaw(offset.reshape(len(offset), -1, 2), shot.angles[:, 2] - shot.believed_yaw)
    place = place + shot.position[:, None, :2]
    ground = heights_at(flight.ground.height, place[..., 0], place[..., 1], settings.raster_m)
    rise = around.base[:, 2] - shot.position[:, 2]
    return (ground + rise[:, None]).view(-1, side, side)
