"""Depth cameras of all kinds: where they sit, how they look, and which errors their images have."""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from saltus.heightmap.scan.training.pose_tables import rotation_of_angles
from saltus.heightmap.scan.training.seeded_random import SeededRandom
from saltus.heightmap.scan.training.settings import FlightSettings

BASELINE_M = 0.05
"""Distance of a stereo camera's imagers [m] (D435i datasheet): what only one of them sees is a dead
margin at the left."""
DEPTH_NOISE = (0.001, 0.012)
"""Standard deviation of depth at 1 m [m], growing with its square: a D435i at 848 x 480 has
0.004, at 424 x 240 0.008 (Intel's tuning paper, 0.08 px)."""
SCALE = 0.008
"""Standard deviation of a camera's constant factor of depth."""
CALIBRATION_RAD, CALIBRATION_M = math.radians(0.3), 0.003
"""By how much nobody knows how it sits, on each axis."""
_FORWARD = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
"""Axes of the image (right, down, ahead) to those of a base it looks ahead of (ahead, left, up)."""


class FlightCameras(NamedTuple):
    """One camera of each robot, or two with half of the columns each:
    the two halves of the images.
    """

    position: Tensor
    """In the base frame as it is known [m], shape (robots, 2, 3)."""
    rotation: Tensor
    """Axes of the image to the base as known, shape (robots, 2, 3, 3)."""
    true_position: Tensor
    """As they are, and `true_rotation`."""
    true_rotation: Tensor
    rays: Tensor
    """In the axes of the image, with 1 along the optical axis: (robots, 2, rows * columns / 2,
    3)."""
    near: Tensor
    """Range [m], shape (robots,); and `far`."""
    far: Tensor
    noise: Tensor
    """Deviation at 1 m [m], shape (robots,)."""
    white: Tensor
    """Share of the noise that pixels do not share with neighbours, shape (robots,)."""
    scale: Tensor
    """Factor of depth, shape (robots,)."""
    edges: Tensor
    """Share of pixels at edges that are holes, shape (robots,)."""
    holes: Tensor
    """Share of the image in holes, shape (robots,)."""
    margin: Tensor
    """Columns of the dead left margin at 1 m, shape (robots,)."""
    lost: Tensor
    """Share of images that never come, shape (robots,)."""
    unknown: Tensor
    """Errors of mounts and scale, in units of usual ones, shape (robots,)."""


def draw_cameras(
    camera_height: Tensor, body_height: Tensor, settings: FlightSettings, draws: SeededRandom
) -> FlightCameras:
    """Cameras at these heights above the ground on bodies of these heights [m],
    each of shape (robots,).
    """
    n = len(camera_height)
    down = torch.deg2rad(draws.uniform(*settings.down_deg, n, 2))
    aim = math.radians(settings.look_deg) + draws.normal(math.radians(settings.aim_deg), n)
    side = torch.where(draws.chance(settings.turned, n), draws.uniform(-math.pi, math.pi, n), aim)
    two = draws.chance(settings.pairs, n)
    other = side + math.pi + draws.normal(0.3, n)
    roll = _roll(n, settings, draws)
    yaw = torch.stack((side, torch.where(two, other, side)), 1)
    pitch = torch.stack((down[:, 0], torch.where(two, down[:, 1], down[:, 0])), 1)
    looks = rotation_of_angles(torch.stack((torch.zeros_like(pitch), pitch, yaw), -1))
    axes = torch.tensor(_FORWARD, device=draws.device)
    turn = rotation_of_angles(
        torch.stack((torch.zeros_like(roll), torch.zeros_like(roll), roll), -1)
    )
    known = looks @ axes @ turn[:, None]

    def each(values: Tensor) -> Tensor:
        """Both halves of the image of one camera are alike."""
        shared = two.view(n, *[1] * (values.dim() - 1))
        return torch.where(shared, values, values[:, :1].expand_as(values))

    ahead = each(draws.uniform(*settings.ahead_m, n, 2))
    up = (camera_height - body_height)[:, None].expand(n, 2)
    position = torch.stack(
        (ahead * yaw.cos(), ahead * yaw.sin() + draws.normal(0.02, n, 1), up), -1
    )
    errors = settings.errors
    unknown = draws.uniform(*settings.calibration, n) * errors
    off = rotation_of_angles(each(draws.normal(CALIBRATION_RAD, n, 2, 3) * unknown[:, None, None]))
    fov = torch.deg2rad(draws.log_uniform(*settings.fov_deg, n))
    half = 0.5 * fov
    return FlightCameras(
        position=position, rotation=known,
        true_position=position + each(
            draws.normal(CALIBRATION_M, n, 2, 3) * unknown[:, None, None]
        ),
        true_rotation=off @ known,
        rays=_rays(half.tan(), draws.uniform(*settings.shape, n), two, settings),
        near=draws.uniform(0.05, 0.3, n), far=draws.uniform(1.5, 5.0, n),
        noise=draws.log_uniform(*DEPTH_NOISE, n) * errors, white=draws.uniform(0.2, 0.8, n),
        scale=1.0 + draws.normal(SCALE, n) * unknown, edges=draws.uniform(0.0, 0.9, n) * errors,
        holes=draws.uniform(0.0, 0.15, n) * draws.chance(0.5, n) * errors,
        margin=BASELINE_M * draws.chance(0.6, n) * errors * 0.5 * settings.columns / half.tan(),
        lost=draws.uniform(0.0, 0.15, n) * draws.chance(0.4, n) * errors,
        unknown=unknown,
    )  # fmt: skip


def _roll(n: int, settings: FlightSettings, draws: SeededRandom) -> Tensor:
    """About the optical axis [rad]: hardly any, or any angle up to a quarter turn."""
    roll: Tensor = torch.where(
        draws.chance(settings.rolled, n),
        draws.one_of((-0.5, 0.5, 0.0), n) * math.pi + draws.uniform(-0.5, 0.5, n),
        draws.normal(0.03, n),
    ).clamp(-0.5 * math.pi, 0.5 * math.pi)
    return roll


def _rays(width: Tensor, shape: Tensor, two: Tensor, settings: FlightSettings) -> Tensor:
    """Rays of images whose halves are this wide, and by `shape` as high."""
    rows, half = settings.rows, settings.columns // 2
    down = ((torch.arange(rows, device=width.device) + 0.5) / rows * 2.0 - 1.0)[None, None, :, None]
    right = (torch.arange(half, device=width.device) + 0.5) / half
    one = torch.stack((right - 1.0, right))  # the left and the right half of one image
    both = (right * 2.0 - 1.0).expand(2, half)  # or each a whole image
    right = torch.where(two[:, None, None], both, one)[:, :, None, :]
    x = (right * width[:, None, None, None]).expand(-1, 2, rows, half)
    y = (down * (width * shape)[:, None, None, None]).expand_as(x)
    return torch.stack((x, y, torch.ones_like(x)), -1).flatten(2, 3)


def with_errors(depth: Tensor, cameras: FlightCameras, draws: SeededRandom) -> Tensor:
    """Depth images (robots, 2, rows, columns / 2) [m] as a stereo camera gives them;
    0 is invalid before and after.
    """
    n, _, rows, half = depth.shape
    image = depth.transpose(1, 2).reshape(n, rows, 2 * half)
    valid = image > 0.0
    distance = cameras.noise[:, None, None] * image**2
    white = cameras.white[:, None, None]
    noise = white * draws.normal(1.0, n, rows, 2 * half) + (1.0 - white**2).sqrt() * _blobs(
        n, rows, 2 * half, 3, draws
    )
    noisy = image * cameras.scale[:, None, None] + distance * noise
    kept = valid & ~_at_edges(image, valid, cameras, draws)
    level = torch.special.ndtri(cameras.holes.clamp(1e-6, 0.5))[:, None, None]
    kept &= _blobs(n, rows, 2 * half, 5, draws) > level
    column = torch.arange(2 * half, device=depth.device)
    kept &= column * image > cameras.margin[:, None, None] * draws.uniform(0.8, 1.2, n, rows, 1)
    kept &= (draws.uniform(0.0, 1.0, n) >= cameras.lost)[:, None, None]
    kept &= (noisy > cameras.near[:, None, None]) & (noisy < cameras.far[:, None, None])
    found = torch.where(kept, noisy, 0.0)
    return found.view(n, rows, 2, half).transpose(1, 2)


def _blobs(n: int, rows: int, columns: int, size: int, draws: SeededRandom) -> Tensor:
    """Noise of deviation 1 that pixels share over about `size` of them:
    at 424 x 240 one ray is 5 to 7 pixels.
    """
    small = draws.normal(1.0, n, 1, max(2, rows // size), max(2, columns // size))
    wide = functional.interpolate(small, size=(rows, columns), mode="bilinear", align_corners=True)[
        :, 0
    ]
    return wide * 1.5  # interpolation takes a third of the deviation


def _at_edges(image: Tensor, valid: Tensor, cameras: FlightCameras, draws: SeededRandom) -> Tensor:
    """Pixels beside a jump of depth, or beside none, that are lost."""
    far = torch.where(valid, image, 10.0)[:, None]
    padded = functional.pad(far, (1, 1, 1, 1), mode="replicate")
    span = functional.max_pool2d(padded, 3, 1) + functional.max_pool2d(-padded, 3, 1)
    share = torch.where(span[:, 0] > 0.12 * image, cameras.edges[:, None, None], 0.0)
    return draws.uniform(0.0, 1.0, *image.shape) < share
