"""The beginning and the end of an episode: judgement,
reset, and what disturbs a robot in between.
"""

from typing import Any

import torch
from torch import Tensor

from saltus.arrays import ColumnNames
from saltus.constants import POLICY_DT
from saltus.controller.estimator import Estimator
from saltus.effects.body import BodyModel
from saltus.effects.heightmap_shift import shift_of
from saltus.effects.profile import Profile
from saltus.policy.env.curriculum import level_difficulty, next_level
from saltus.policy.env.env_observations import EnvObservations
from saltus.policy.env.jump_memory import JumpMemory, write_memory
from saltus.policy.env.randomisation import BODY_DRAWS, SOFT_RUBBER, draw_bodies, draw_wide
from saltus.policy.env.settings import JumpEnvSettings
from saltus.robots.legs import LegKinematics
from saltus.rotations import quaternion_from_roll_pitch_yaw, roll_pitch_yaw, rotation_matrix
from saltus.sim.engine import Engine
from saltus.sim.plant import CLEARANCE
from saltus.terrain.course_batch import DRAWS, draw_courses
from saltus.terrain.terrain import TRENCH_DEPTH
from saltus.trial import UPRIGHT_LIMIT

_TRUNK_POINTS = 9  # along the lower edge of the trunk, 4.7 cm apart

TALLY = ("episodes", "finished", "tilted", "touched", "sunk", "astray", "way_m", "time_s")
"""Counts over the episodes of each kind of terrain."""

_START_DRAWS = ColumnNames(joints=(12,), x=(), yaw=(), y=(), heading=(), height_shift=(2,))
_EVENT_DRAWS = ColumnNames(
    level=(), difficulty=(), torque_time=(), torque=(), push_time=(), push_ahead=()
)


class EpisodeResets:
    """Judges whether training robots have fallen or finished, and starts those anew; results are
    tensors that are rewritten in place.
    """

    def __init__(
        self,
        memory: JumpMemory,
        config: JumpEnvSettings,
        engine: Engine,
        estimator: Estimator,
        views: EnvObservations,
        profile: Profile,
    ) -> None:
        self._memory, self._config, self._engine, self._views = memory, config, engine, views
        self._body, shift = profile.body_chain, shift_of(profile.heightmap)
        self._qpos, self._qvel = torch.as_tensor(engine.qpos), torch.as_tensor(engine.qvel)
        self._warmstart = torch.as_tensor(engine.warmstart)
        self._wrench = torch.as_tensor(engine.trunk_wrench)
        count, device = engine.count, memory.phase.device
        self._shift = torch.tensor((shift.x, shift.z), device=device)
        beside = torch.tensor((shift.x_range, shift.z_range), device=device)
        self._shift_range = beside + torch.tensor(
            config.randomisation.height_shift_m, device=device
        )
        self._wide = config.randomisation.wide
        self._columns = ColumnNames(
            course=(DRAWS.count,),
            body=(BODY_DRAWS.count,),
            start=(_START_DRAWS.count,),
            event=(_EVENT_DRAWS.count,),
            wide=(self._wide.draws,),
            height_noise=(views.grid.size,),
        )
        self.draws = torch.zeros(count, self._columns.count, device=device)
        """Uniform numbers for the next `reset`, `disturb` and observation.

        The environment fills them.
        """
        self.reward = torch.zeros(count, device=device)
        self.done = torch.zeros(count, dtype=torch.bool, device=device)
        self.timed_out = torch.zeros(count, dtype=torch.bool, device=device)
        kinds = range(len(config.curriculum.shares))
        self.tally = torch.zeros(len(kinds), len(TALLY), device=device)
        """Sums over the episodes that ended, for each kind of terrain; see `TALLY`."""
        self.term_sums = torch.zeros_like(memory.terms[0])
        """Sum over steps of the mean of each reward term."""
        self._grown = torch.zeros((), device=device)
        self.grow(0.0)
        self._blank = estimator.init((count,), memory.phase)
        robot = engine.robot
        self._legs, self._foot_radius = LegKinematics(robot), robot.foot_radius
        self._stand = torch.tensor(robot.stand_pose, dtype=torch.float32, device=device)
        self._is_kind = torch.stack([memory.kind == k for k in kinds]).float()
        low, high = (
            robot.trunk_center - 0.5 * robot.trunk_size,
            robot.trunk_center + 0.5 * robot.trunk_size,
        )
        edge = torch.zeros(_TRUNK_POINTS, 3, device=device)
        edge[:, 0] = torch.linspace(float(low[0]), float(high[0]), _TRUNK_POINTS)
        edge[:, 2] = float(low[2])
        self._trunk_edge = edge

    def grow(self, steps: float) -> None:
        """Ranges are drawn from as after so many environment steps of all processes."""
        self._grown.fill_(self._wide.grown(steps))

    def judge(self) -> None:
        """Reward of the last 10 ms, and which episodes are over and why."""
        memory, limits = self._memory, self._config.episode
        qpos = torch.nan_to_num(self._qpos.float(), nan=1e3)
        rotation = rotation_matrix(qpos[:, 3:7])
        roll, pitch, yaw = roll_pitch_yaw(rotation)
        position = qpos[:, :3]
        edge = position[:, None] + self._trunk_edge @ rotation.mT
        places = torch.cat([position[:, None], edge], 1)
        ground = self._views.courses().height_at(places[..., 0], places[..., 1])
        finite = torch.isfinite(self._qpos.sum(-1) + self._qvel.sum(-1))
        tilted = (roll.abs() > UPRIGHT_LIMIT) | (pitch.abs() > UPRIGHT_LIMIT)
        touched = (edge[..., 2] < ground[:, 1:]).any(-1) | memory.touched[:, 12:].any(-1)
        descends = self._views.descends()
        lowest = torch.where(descends, memory.floor + TRENCH_DEPTH, 0.0)
        sunk = (position[:, 2] - ground[:, 0] < limits.lowest_base_m) | (
            position[:, 2] < lowest - limits.sunk_m
        )
        astray = (position[:, 1].abs() > limits.astray_m) | (
            (yaw - memory.heading).abs() > limits.astray_rad
        )
        failed = tilted | touched | sunk | astray | ~finite
        memory.time_s.add_(POLICY_DT)
        finished = (position[:, 0] > memory.finish_x) & ~failed
        late = memory.time_s > limits.time_limit_s
        self.timed_out.copy_((finished | late) & ~failed)
        self.done.copy_(self.timed_out | failed)
        terms = torch.nan_to_num(memory.terms).clamp(-10.0, 10.0)
        self.reward.copy_(terms.sum(-1))
        self.term_sums.add_(terms.mean(0))

        climb = torch.where(descends, ground[:, 0].abs(), ground[:, 0].clamp(min=0.0))
        way = position[:, 0] - memory.start_x + climb
        lasted = memory.time_s - memory.first_time_s
        rows = [torch.ones_like(way), finished, tilted, touched, sunk, astray, way, lasted]
        counted = torch.stack([row.float() * self.done for row in rows], -1)
        self.tally.add_((self._is_kind[:, :, None] * torch.nan_to_num(counted)[None]).sum(1))
        drawn = _EVENT_DRAWS.of(self._drawn.event)
        level = next_level(
            self._config.curriculum, memory.level, way, failed, finished, drawn.level
        )
        # A robot's first episode, which may be too short for any way, moves no level when its time
        # is over.
        write_memory(
            memory, self.done & (failed | finished | (memory.first_time_s == 0.0)), level=level
        )

    def reset(self, mask: Tensor) -> None:
        """Starts the next episode of the robots in `mask`, bool, shape (n,)."""
        memory, ranges = self._memory, self._config.randomisation
        drawn = self._drawn
        hard = level_difficulty(
            self._config.curriculum, memory.level, _EVENT_DRAWS.of(drawn.event).difficulty
        )
        course = draw_courses(memory.kind, hard, drawn.course)
        names = ("low", "high", "top", "finish_x", "slope", "floor")
        write_memory(memory, mask, **{name: getattr(course, name) for name in names})
        if (table := self._views.table) is not None:
            place = table.draw(self._views.family, memory.level, DRAWS.of(drawn.course).start)
            own = {name: getattr(table, name)[place] for name in ("finish_x", "slope", "floor")}
            write_memory(memory, mask & self._views.is_own, course=place, **own)
        bodies = draw_bodies(ranges, drawn.body)
        write_memory(memory, mask, **bodies)
        self._engine.set_terrain(self._views.courses().boxes())
        if self._wide.share > 0.0:
            mass_kg = self._engine.robot.mass
            write_memory(
                memory,
                mask,
                **draw_wide(ranges, bodies["friction"], mass_kg, self._grown, drawn.wide),
            )
        self._engine.set_bodies(self._bodies())
        start = _START_DRAWS.of(drawn.start)
        self._place(mask, start)
        zero = torch.zeros_like(memory.phase)
        shift = self._shift + (2.0 * start.height_shift - 1.0) * self._shift_range
        write_memory(
            memory,
            mask,
            phase=zero,
            estimate=self._blank.mean,
            variance=self._blank.variance,
            tick=zero,
            contact=torch.ones_like(memory.contact),
            trusted=torch.ones_like(memory.trusted),
            progress=torch.zeros_like(memory.progress),
            tracking_cost=zero,
            time_s=zero,
            first_time_s=zero,
            height_shift=shift,
            pitch_torque=zero,
            touched=torch.zeros_like(memory.touched),
        )

    def _bodies(self) -> BodyModel:
        memory = self._memory
        # in double precision: robots that are not softened are as stiff as those of a training
        # without such draws
        softness = memory.softness.double() if self._wide.share > 0.0 else 0.0
        claimed = BodyModel(
            payload_kg=memory.payload_kg,
            com_shift=memory.com_shift,
            inertia_scale=1.0,
            friction=memory.friction,
            **{
                name: usual + softness * (soft - usual)
                for name, (usual, soft) in SOFT_RUBBER.items()
            },
        )
        return self._body.apply(claimed)

    def disturb(self) -> None:
        """Redraws the torque on the trunk, and pushes.

        Both at random times with the configured mean period.
        """
        memory, ranges = self._memory, self._config.randomisation
        event, body = _EVENT_DRAWS.of(self._drawn.event), BODY_DRAWS.of(self._drawn.body)
        redrawn = event.torque_time < POLICY_DT / ranges.torque_period_s
        torque = ranges.pitch_torque_nm * (2.0 * event.torque - 1.0)
        write_memory(memory, redrawn, pitch_torque=torque)
        across = rotation_matrix(self._qpos[:, 3:7].float())[:, :, 1]
        self._wrench[:, 3:6] = (across * memory.pitch_torque[:, None]).to(self._wrench.dtype)
        pushed = event.push_time < POLICY_DT / ranges.push_period_s
        way = 2.0 * torch.stack([event.push_ahead, body.push_aside], -1) - 1.0
        kick = ranges.push_mps * way
        if self._wide.share > 0.0:
            hard = (event.push_time < POLICY_DT / self._wide.side_push_period_s) & (
                memory.push_mps > 0.0
            )
            aside = torch.where(hard, memory.push_mps * torch.sign(way[:, 1]), kick[:, 1])
            kick = torch.stack([kick[:, 0], aside], -1)
        self._qvel[:, :2] += (kick * pushed[:, None]).to(self._qvel.dtype)

    def _place(self, mask: Tensor, drawn: Any) -> None:
        """Puts robots in their standing pose, just above the ground at the start of their course.

        `drawn` has the columns of `_START_DRAWS`.
        """
        memory, ranges = self._memory, self._config.randomisation
        joints = self._stand + ranges.start_joint_rad * (2.0 * drawn.joints - 1.0)
        x, yaw = (
            ranges.start_x_m * (2.0 * drawn.x - 1.0),
            ranges.start_yaw_rad * (2.0 * drawn.yaw - 1.0),
        )
        zero = torch.zeros_like(x)
        quaternion = quaternion_from_roll_pitch_yaw(zero, zero, yaw)
        feet = self._legs.position(joints)
        z = CLEARANCE + self._foot_radius - feet[..., 2].amin(-1)
        position = torch.stack([x, ranges.start_x_m * (2.0 * drawn.y - 1.0), z], -1)
        fresh = torch.cat([position, quaternion, joints], -1).to(self._qpos.dtype)
        rows = mask[:, None]
        self._qpos.copy_(torch.where(rows, fresh, self._qpos))
        self._qvel.copy_(torch.where(rows, torch.zeros_like(self._qvel), self._qvel))
        self._warmstart.copy_(torch.where(rows, torch.zeros_like(self._warmstart), self._warmstart))
        write_memory(memory, mask, start_x=x, heading=yaw * drawn.heading)
        write_memory(memory, mask, liftoff=feet @ rotation_matrix(quaternion).mT)

    @property
    def height_noise(self) -> Tensor:
        """Uniform numbers of the noise of heights, shape (n, points)."""
        noise: Tensor = self._drawn.height_noise
        return noise

    @property
    def _drawn(self) -> Any:
        """Columns of courses, bodies, starts, events, of what is wide, and of noise."""
        return self._columns.of(self.draws)
