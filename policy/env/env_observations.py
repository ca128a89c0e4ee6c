"""Views of policy and critic on a training environment, and the goal of each jump."""

from collections.abc import Callable

import torch
from torch import Tensor

from saltus.grid import HeightGrid
from saltus.loop.planner import observe
from saltus.policy.env.jump_memory import JumpMemory, write_memory
from saltus.policy.env.randomisation import WIDE
from saltus.policy.env.settings import JumpEnvSettings
from saltus.policy.policy_features import (
    PROPRIOCEPTION_SIZE,
    next_past,
    policy_features,
    size_with,
    with_past,
)
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.states import Proprioception
from saltus.terrain.course_batch import CourseBatch, may_lead_down
from saltus.terrain.course_law import KINDS
from saltus.terrain.course_table import OwnCourses

FAR_X = (0.9, 1.1, 1.3, 1.6)
"""Heights that only the critic sees [m ahead]."""
_GOAL_M = 1.0  # way of one jump along the profile; original, but horizontal there


class EnvObservations:
    """Observations of training robots as tensors that are rewritten in place, from what robots know
    now and the engine's positions.
    """

    def __init__(
        self,
        robot: Robot,
        grid: HeightGrid,
        memory: JumpMemory,
        config: JumpEnvSettings,
        states: Callable[[], Proprioception],
        qpos: Tensor,
        qvel: Tensor,
    ) -> None:
        self._legs, self._stand_height = LegKinematics(robot), robot.stand_height
        self._memory, self._config, self._states, self._qpos, self._qvel = (
            memory,
            config,
            states,
            qpos,
            qvel,
        )
        count, device = len(memory.kind), memory.phase.device
        self.grid = grid
        """Grid of the policy's heights."""
        self._far = HeightGrid(x=FAR_X)
        self.actor = torch.zeros(count, size_with(grid, config.past_steps), device=device)
        self._has_wide = config.randomisation.wide.share > 0.0
        self._descends, self.family = may_lead_down(memory.kind), memory.kind - len(KINDS)
        self.is_own = self.family >= 0
        """Which robots are on families of one's own, and below, on which; shape (n,)."""
        self.table = (
            None if config.curriculum.table is None else config.curriculum.table.like(memory.phase)
        )
        self.critic = torch.zeros(
            count, size_with(grid) + PRIVILEGED + config.randomisation.wide.draws, device=device
        )

    def courses(self) -> CourseBatch:
        """The terrain of every robot."""
        m, own = self._memory, None
        if self.table is not None:
            own = OwnCourses(table=self.table, course=m.course.long(), used=self.is_own)
        return CourseBatch(
            low=m.low,
            high=m.high,
            top=m.top,
            finish_x=m.finish_x,
            slope=m.slope,
            floor=m.floor,
            own=own,
        )

    def descends(self) -> Tensor:
        """Which robots are on ground that may lead down, bool, shape (n,)."""
        if self.table is None:
            return self._descends
        return torch.where(
            self.is_own, self.table.leads_down[self._memory.course.long()], self._descends
        )

    def set_goals(self, fresh: Tensor) -> None:
        """Gives robots that begin a gait cycle, or an episode (`fresh`, bool, (n,)),
        the goal of their next jump.

        The goal is one metre ahead along the profile: on stairs of 0.2 m by 0.25 m, 0.56 m ahead.
        """
        memory, position = self._memory, self._qpos[:, :3].float()
        cycle = torch.floor(memory.phase)
        begins = fresh | (cycle != memory.cycle)
        far = position[:, :1] + position.new_tensor([0.0, _GOAL_M])
        aside = position[:, 1:2]
        below = self.courses().height_at(far, aside.expand_as(far))
        descends = self.descends()
        # Over a trench it is its rim
        ground = torch.where(descends[:, None], below, below.clamp(min=0.0))
        length = _GOAL_M / (1.0 + (ground[:, 1] - ground[:, 0]).abs() / _GOAL_M)
        goal_x = position[:, 0] + length
        there = self.courses().height_at(goal_x[:, None], aside)[:, 0]
        goal_z = (
            torch.where(descends, there, torch.maximum(there, ground[:, 0])) + self._stand_height
        )
        write_memory(memory, begins, goal_x=goal_x, goal_z=goal_z, goal_length=length, cycle=cycle)

    def observe(self, draws: Tensor, fresh: Tensor) -> None:
        """Writes what policy and critic see now.

        Args:
            draws: Of the noise of the heights, uniform in [0, 1), shape (n, points).
            fresh: Robots that begin, bool, shape (n,).
        """
        memory = self._memory
        qpos = self._qpos.float()
        seen = observe(self._states(), self._legs)
        rotation = rotation_matrix(qpos[:, 3:7])
        _, _, yaw = roll_pitch_yaw(rotation)
        shift = memory.height_shift
        courses, position = self.courses(), qpos[:, :3]
        places = self.grid.points_in_world(position, yaw, ahead=shift[:, 0])
        shifted = courses.height_at(*places) - position[:, 2:] + shift[:, 1:]
        noise = self._config.randomisation.height_noise_m * (2.0 * draws - 1.0)
        true, far = (
            courses.height_at(*grid.points_in_world(position, yaw)) - position[:, 2:]
            for grid in (self.grid, self._far)
        )
        self.actor.copy_(
            self._recalled(torch.nan_to_num(policy_features(seen, shifted + noise)), fresh)
        )
        exact = policy_features(seen, true)
        known = self._privileged(yaw, far)
        self.critic.copy_(torch.nan_to_num(torch.cat([exact, known], -1)))

    def _recalled(self, vector: Tensor, fresh: Tensor) -> Tensor:
        """The vector with the past; `actor` is still that of the step before."""
        if not self._config.past_steps:
            return vector
        plan = self._config.bounds.normalised(self._memory.plan)
        latest = torch.cat([self.actor[:, :PROPRIOCEPTION_SIZE], plan], -1)
        write_memory(self._memory, past=next_past(self._memory.past, latest, vector, fresh))
        return with_past(vector, self._memory.past, self._config.past_steps)

    def _privileged(self, yaw: Tensor, far: Tensor) -> Tensor:
        """Returns what the critic sees besides the policy's vector, each about of size 1.

        Shape (n, PRIVILEGED).
        """
        memory, config = self._memory, self._config
        position, velocity = self._qpos[:, :3].float(), self._qvel[:, :3].float()
        scalars = [
            memory.goal_x - position[:, 0],
            memory.goal_z - position[:, 2],
            memory.goal_length,
            position[:, 1],
            yaw - memory.heading,
            memory.time_s / config.episode.time_limit_s,
            memory.friction,
            memory.payload_kg,
            memory.motor_strength,
            1e2 * memory.delay_s,
            memory.pitch_torque,
            memory.slope,
            memory.level / config.curriculum.levels,
            torch.floor(memory.phase).clamp(max=2.0),
        ]
        parts = [
            torch.stack(scalars, -1),
            velocity,
            1e1 * memory.com_shift,
            1e1 * memory.height_shift,
            memory.touched[:, :4].float(),
            config.bounds.normalised(memory.plan),
            far,
        ]
        if self._has_wide:
            parts.append(
                torch.stack([scale * getattr(memory, name) for name, scale in WIDE.items()], -1)
            )
        return torch.cat(parts, -1)


PRIVILEGED = 14 + 3 + 3 + 2 + 4 + 10 + len(FAR_X)
"""Length of what the critic sees besides the policy's vector, without what `WideSettings` adds."""
