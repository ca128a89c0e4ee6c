"""Tables over time of a batch of robots, and poses from them."""

import torch
from torch import Tensor

from saltus import rotations

STEP_S = 0.01
"""Step of all tables: they are linear in between."""


def values_at(table: Tensor, time_s: Tensor) -> Tensor:
    """Values at one time per robot: (robots, steps, ...), (robots,) -> (robots, ...)."""
    place = (time_s / STEP_S).clamp(0.0, table.shape[1] - 1.001)
    first = place.floor().long()
    robots = torch.arange(len(table), device=table.device)
    share = (place - first).view(-1, *[1] * (table.dim() - 2))
    return torch.lerp(table[robots, first], table[robots, first + 1], share)


def rotation_of_angles(angles: Tensor) -> Tensor:
    """Base to world of roll, pitch, yaw [rad]: (..., 3) -> (..., 3, 3)."""
    found: Tensor = rotations.rotation_matrix(
        rotations.quaternion_from_roll_pitch_yaw(angles[..., 0], angles[..., 1], angles[..., 2])
    )
    return found


def turn_by_yaw(xy: Tensor, yaw: Tensor) -> Tensor:
    """Vectors (robots, n, 2) turned by an angle of each robot, shape (robots,)."""
    cos, sin = yaw.cos()[:, None], yaw.sin()[:, None]
    x, y = xy[..., 0], xy[..., 1]
    return torch.stack((cos * x - sin * y, sin * x + cos * y), -1)
