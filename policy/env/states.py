"""What the robots of a training know of themselves."""

import torch
from torch import Tensor

from saltus.constants import GRAVITY
from saltus.policy.env.memory import Memory
from saltus.rotations import rotation_matrix
from saltus.sim.engine import Engine


class LiveStates:
    """A `saltus.states.Proprioception` read from the live tensors of engine and environment: what is read holds now.

    Args:
        engine: The physics; its positions and velocities are those that IMU and encoders say.
        memory: Estimates and schedule.
    """

    def __init__(self, engine: Engine, memory: Memory) -> None:
        self._qpos, self._qvel = torch.as_tensor(engine.qpos), torch.as_tensor(engine.qvel)
        self._qacc = torch.as_tensor(engine.qacc)
        self._memory = memory

    @property
    def quaternion_base_in_world(self) -> Tensor:
        """(w, x, y, z), shape (n, 4)."""
        return self._qpos.float()[:, 3:7]

    @property
    def angular_velocity_base(self) -> Tensor:
        """[rad/s], shape (n, 3)."""
        return self._qvel.float()[:, 3:6]

    @property
    def acceleration_base(self) -> Tensor:
        """Specific force [m/s^2], shape (n, 3)."""
        force = self._qacc[:, :3].float() + self._qpos.new_tensor([0.0, 0.0, GRAVITY]).float()
        specific: Tensor = rotation_matrix(self.quaternion_base_in_world).mT @ force[..., None]
        return specific[..., 0]

    @property
    def joint_position(self) -> Tensor:
        """[rad], shape (n, 12)."""
        return self._qpos.float()[:, 7:]

    @property
    def joint_velocity(self) -> Tensor:
        """[rad/s], shape (n, 12)."""
        return self._qvel.float()[:, 6:]

    @property
    def velocity_base_in_world(self) -> Tensor:
        """Estimate [m/s], shape (n, 3)."""
        return self._memory.estimate[:, :3]

    @property
    def base_height(self) -> Tensor:
        """Estimate [m], shape (n,)."""
        return self._memory.estimate[:, 3]

    @property
    def leg_contact(self) -> Tensor:
        """Scheduled, bool, shape (n, 4)."""
        return self._memory.contact

    @property
    def leg_progress(self) -> Tensor:
        """Of stance or swing, shape (n, 4)."""
        return self._memory.progress

    @property
    def leg_trusted(self) -> Tensor:
        """Bool, shape (n, 4)."""
        return self._memory.trusted

    @property
    def cycle(self) -> Tensor:
        """Of the present goal, shape (n,)."""
        return self._memory.cycle
