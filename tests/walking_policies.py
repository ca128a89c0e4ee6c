"""Small policies that command joints, as files."""

from pathlib import Path

import numpy as np
import torch
from samples import KINEMATICS, ROBOT
from torch import Tensor, nn

from saltus.arrays import Floats
from saltus.constants import GRAVITY
from saltus.onnx_export import write_onnx
from saltus.policy.joints.description import PolicyDescription
from saltus.policy.joints.policy import FIELD
from saltus.policy.walking.description import description_of
from saltus.policy.walking.settings import WalkSettings

OURS = description_of(WalkSettings(), ROBOT)
"""Description of what is trained for the tests' robot by default."""


class Constant(nn.Module):
    """Says the same whatever it is given."""

    def __init__(self, action: list[float]) -> None:
        super().__init__()
        self.action = nn.Parameter(torch.tensor(action))

    def forward(self, observation: Tensor) -> Tensor:
        """Shape (n, 12)."""
        return 0.0 * observation[:, :12] + self.action


def put_policy(
    path: Path,
    description: PolicyDescription = OURS,
    action: list[float] | None = None,
    *,
    describes_itself: bool = True,
) -> Path:
    """Writes a policy that stands in its pose, or in another one; returns the file."""
    write_onnx(
        Constant(action or [0.0] * 12),
        (torch.zeros(2, description.size),),
        path,
        inputs=("observation",),
        outputs=("action",),
        metadata={FIELD: description.to_toml()} if describes_itself else {},
    )
    return path


def bearing(joints: Floats, shares: Floats) -> Floats:
    """Torques of the level test robot, whose feet bear shares of its weight [Nm], shape (12,)."""
    _, jacobian = KINEMATICS.position_and_jacobian(joints)
    force = shares[:, None] * ROBOT.mass * GRAVITY * np.array([0.0, 0.0, 1.0])
    return -(force[:, None, :] @ jacobian).reshape(12)
