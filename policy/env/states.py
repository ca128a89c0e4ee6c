"""States that the robots of a training know of themselves."""

import torch

from saltus.constants import GRAVITY
from saltus.policy.env.memory import Memory
from saltus.rotations import rotation_matrix
from saltus.sim.engine import Engine
from saltus.states import RobotStates


def engine_states(engine: Engine, memory: Memory) -> RobotStates:
    """IMU and encoders as the engine's positions and velocities say,
    estimates and schedule as remembered; tensors.
    """
    qpos, qvel = torch.as_tensor(engine.qpos).float(), torch.as_tensor(engine.qvel).float()
    force = torch.as_tensor(engine.qacc)[:, :3].float() + qpos.new_tensor([0.0, 0.0, GRAVITY])
    return RobotStates(
        quaternion_base_in_world=qpos[:, 3:7],
        angular_velocity_base=qvel[:, 3:6],
        acceleration_base=(rotation_matrix(qpos[:, 3:7]).mT @ force[..., None])[..., 0],
        joint_position=qpos[:, 7:],
        joint_velocity=qvel[:, 6:],
        velocity_base_in_world=memory.estimate[:, :3],
        base_height=memory.estimate[:, 3],
        leg_contact=memory.contact,
        leg_progress=memory.progress,
        leg_trusted=memory.trusted,
        cycle=memory.cycle,
    )
