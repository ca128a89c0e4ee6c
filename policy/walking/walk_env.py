"""The environment of walking: thousands of robots in lockstep at 50 Hz.

Each has the boxes of its ground that are nearest to it.

A step is: take the action; ten times drives and physics; then judge, reset who is done, command,
look.
"""

from typing import Any

import torch
from torch import Tensor

from saltus.arrays import ColumnNames
from saltus.constants import PHYSICS_DT
from saltus.effects.body import BodyModel
from saltus.effects.profile import load_profile
from saltus.grid import SCAN
from saltus.joint_command import JointCommand
from saltus.policy.env.curriculum import kinds_of_robots, moved_level
from saltus.policy.env.jump_memory import write_memory
from saltus.policy.env.randomisation import BODY_DRAWS, SOFT_RUBBER, draw_bodies, training_drives
from saltus.policy.env.training_env import TrainingEnv, Transition
from saltus.policy.joints.observation import (
    LIMIT,
    ObservationMaker,
    WalkerReadings,
    gravity_in_base,
    in_command_frame,
    joint_targets,
    standing_height,
)
from saltus.policy.walking import commands, starts
from saltus.policy.walking.commands import command_now, draw_command
from saltus.policy.walking.course_field import CourseField, beside_drop, in_trench
from saltus.policy.walking.description import POLICY_HZ, SIZE, description_of
from saltus.policy.walking.scan_errors import ScanDraws, ScanErrors
from saltus.policy.walking.settings import WalkSettings
from saltus.policy.walking.starts import first_motion, height_above, led_time, under_trunk
from saltus.policy.walking.walk_memory import WalkMemory, blank_walk_memory
from saltus.policy.walking.walk_rewards import (
    AIR_TIME_S,
    WalkRewardInputs,
    total_reward,
    walk_reward_terms,
)
from saltus.robots.robot import JOINTS
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.sim.engine import Engine
from saltus.terrain.boxes import Boxes
from saltus.trial import UPRIGHT_LIMIT

DT = 1.0 / POLICY_HZ
SUBSTEPS = round(DT / PHYSICS_DT)
TALLY = ("episodes", "failed", "steps", "speed_error", "turn_error", "way_m", "asked_m")
"""Counts over the robots of each family since the last report."""
_LEAST_WAY = 1.0  # m; a shorter commanded way moves no level
_START = ColumnNames(x=(), y=(), variant=(), level=(), age=(), motion=(starts.DRAWS.count,))
_PUSH = ColumnNames(when=(), ahead=(), aside=())
_SENSORS = ColumnNames(angular_velocity=(3,), gravity=(3,), position=(12,), velocity=(12,))
_DRAWS = ColumnNames(
    start=(_START.count,),
    body=(BODY_DRAWS.count,),
    command=(commands.DRAWS.count,),
    push=(_PUSH.count,),
    sensors=(_SENSORS.count,),
    shift=(),
    noise=(),
    error=(SCAN.size,),
)
PRIVILEGED = 3 + 1 + 1 + 1 + 3 + 4 + 4 + 1
"""Length of what the critic sees besides the policy's vector without errors."""


class WalkEnv(TrainingEnv):
    """Robots that walk on the boxes of their ground, given heights on the scan."""

    substeps = SUBSTEPS
    memory: WalkMemory

    def __init__(
        self, engine: Engine, config: WalkSettings, *, seed: int, device: str = "cpu"
    ) -> None:
        super().__init__(engine, device, seed, len(JOINTS))
        self.config = config
        self._warmstart = torch.as_tensor(engine.warmstart)
        description = description_of(config, self.robot)
        pose = description.pose
        self._pose = torch.tensor(pose, dtype=torch.float32, device=self.device)
        self._height = standing_height(self.robot, pose)
        kind = torch.tensor(kinds_of_robots(config.ground.shares, self.count), device=self.device)
        wide = torch.tensor(
            [name in config.ground.wide for name in config.ground.shares], device=self.device
        )
        jumps = [name in config.jump_start.families for name in config.ground.shares]
        self._may_jump = torch.tensor(jumps, device=self.device)[kind]
        self.memory = blank_walk_memory(kind, wide[kind], config.ground.boxes)
        self.ground = CourseField(config.ground, self.memory.time_s)
        self._is_kind = torch.stack([kind == k for k in range(len(config.ground.shares))]).float()
        self._scan_errors = ScanErrors(config.scan)
        # evenly among robots: those of a family follow each other, and each family has its share
        so_far = (torch.arange(self.count + 1, device=self.device) * config.scan.exact).floor()
        self._is_exact = so_far.diff() > 0.0
        self._observer = ObservationMaker(description)
        profile = load_profile(config.profile, self.robot)
        self._body = profile.body_chain
        self._equip(training_drives(self.robot, profile, config.randomisation, self.memory))
        self._draws = torch.zeros(self.count, _DRAWS.count, device=self.device)
        self.reward = torch.zeros(self.count, device=self.device)
        self.done = torch.zeros(self.count, dtype=torch.bool, device=self.device)
        self.timed_out = torch.zeros_like(self.done)
        self.actor = torch.zeros(self.count, SIZE, device=self.device)
        self.critic = torch.zeros(self.count, SIZE + PRIVILEGED, device=self.device)
        self.tally = torch.zeros(len(self._is_kind), len(TALLY), device=self.device)
        """Sums over the robots of each family; see `TALLY`."""
        self.term_sums = torch.zeros_like(self.memory.terms[0])
        """Sum over steps of the mean of each reward term."""
        self._trunk = under_trunk(self.robot).like(self.reward)
        self._sums = self.tally, self.term_sums
        self._shown = Transition(
            actor=self.actor, critic=self.critic,
            reward=self.reward, done=self.done, timed_out=self.timed_out,
        )  # fmt: skip
        self._start(self._take, self._control, self._finish)

    def motion(self) -> Tensor:
        """Velocities of the bases as commands have them, shape (n, 3)."""
        qpos, qvel = self._qpos.float(), self._qvel.float()
        ahead = in_command_frame(qvel[:, :3], rotation_matrix(qpos[:, 3:7]))[:, :2]
        return torch.cat([ahead, qvel[:, 5:6]], -1)

    def grow(self, steps: float) -> None:
        """Nothing: no range grows with the steps."""

    @torch.no_grad()
    def _take(self) -> None:
        memory, most = self.memory, self.config.drives.most
        write_memory(memory, last_action=memory.action, tick=torch.zeros_like(memory.tick))
        write_memory(memory, action=torch.nan_to_num(self._output).clamp(-most, most))

    @torch.no_grad()
    def _control(self) -> None:
        memory, drives = self.memory, self.config.drives
        is_late = memory.tick * PHYSICS_DT < memory.plan_delay_s
        obeyed = torch.where(is_late[:, None], memory.last_action, memory.action)
        zero = torch.zeros_like(obeyed)
        command = JointCommand(
            position=joint_targets(self._pose, drives.scale, obeyed),
            velocity=zero,
            kp=zero + drives.kp,
            kd=zero + drives.kd,
            torque=zero,
        )
        torque = self._drive(command, self._qpos[:, 7:].float(), self._qvel[:, 6:].float())
        write_memory(memory, tick=memory.tick + 1.0, torque=torque.believed)

    @torch.no_grad()
    def _finish(self) -> None:
        self._judge()
        self._reset(self.done)
        self._push()
        self._look(self.done)

    def _judge(self) -> None:
        """Reward of the last step, and which episodes are over and why."""
        memory, config = self.memory, self.config
        qpos = torch.nan_to_num(self._qpos.float(), nan=1e3)
        qvel = torch.nan_to_num(self._qvel.float()).clamp(-1e3, 1e3)
        rotation, position = rotation_matrix(qpos[:, 3:7]), qpos[:, :3]
        roll, pitch, _ = roll_pitch_yaw(rotation)
        touching = torch.as_tensor(self._engine.touching())
        trunk = position[:, None] + self._trunk @ rotation.mT
        below = self._boxes().height_at(trunk[..., 0], trunk[..., 1])
        finite = torch.isfinite(self._qpos.sum(-1) + self._qvel.sum(-1))
        tilted = (roll.abs() > UPRIGHT_LIMIT) | (pitch.abs() > UPRIGHT_LIMIT)
        failed = tilted | (trunk[..., 2] < below).any(-1) | touching[:, 12:].any(-1) | ~finite
        memory.time_s.add_(DT)
        finished = ~memory.wide & (position[:, 0] > self.ground.table.finish_x[memory.course])
        over = memory.time_s > config.time_limit_s
        over = over | finished | self.ground.left(memory.course, position[:, :2])
        self.timed_out.copy_(over & ~failed)
        self.done.copy_(over | failed)

        landed = touching[:, :4] & (memory.air_s > 0.0)
        foot, jacobian = self._legs.position_and_jacobian(qpos[:, 7:])
        relative = (jacobian @ qvel[:, 6:].reshape(-1, 4, 3, 1))[..., 0]
        relative = relative + torch.linalg.cross(qvel[:, None, 3:6].expand_as(foot), foot)
        foot_velocity = qvel[:, None, :3] + relative @ rotation.mT
        place = position[:, None] + foot @ rotation.mT
        velocity = in_command_frame(qvel[:, :3], rotation)
        terms = walk_reward_terms(
            config.reward,
            WalkRewardInputs(
                command=memory.command,
                velocity=velocity,
                angular_velocity=qvel[:, 3:6],
                gravity=gravity_in_base(rotation),
                torque=memory.torque,
                joint_acceleration=(qvel[:, 6:] - memory.joint_velocity) / DT,
                joint_offset=qpos[:, 7:] - self._pose,
                action=memory.action,
                last_action=memory.last_action,
                landed_after_s=torch.where(landed, memory.air_s, AIR_TIME_S),
                foot_touching=touching[:, :4],
                foot_ground=self._boxes().height_at(place[..., 0], place[..., 1]),
                foot_speed_squared=(foot_velocity[..., :2] ** 2).sum(-1),
                leg_touching=touching[:, 4:12],
                foot_missed=touching[:, :4] & in_trench(self._boxes(), place),
                foot_beside_drop=touching[:, :4] & beside_drop(self._boxes(), place),
                failed=failed,
            ),
        )
        terms = torch.nan_to_num(terms).clamp(-10.0, 10.0)
        self.reward.copy_(total_reward(terms))
        self.term_sums.add_(terms.mean(0))
        write_memory(
            memory,
            terms=terms,
            joint_velocity=qvel[:, 6:],
            foot_touching=touching[:, :4],
            air_s=torch.where(touching[:, :4], 0.0, memory.air_s + DT),
        )
        self._count(velocity, qvel[:, 5], failed)

    def _count(self, velocity: Tensor, turning: Tensor, failed: Tensor) -> None:
        """Way along the command, tallies, and the levels of those whose episode is over."""
        memory, config = self.memory, self.config.ground
        asked = memory.command[:, :2].norm(dim=-1)
        along = (velocity[:, :2] * memory.command[:, :2]).sum(-1) / asked.clamp(min=1e-3)
        write_memory(memory, way_m=memory.way_m + DT * along, asked_m=memory.asked_m + DT * asked)
        error = (velocity[:, :2] - memory.command[:, :2]).norm(dim=-1)
        one = torch.ones_like(asked)
        rows = [
            self.done.float(),
            failed.float(),
            one,
            error,
            (turning - memory.command[:, 2]).abs(),
            DT * along,
            DT * asked,
        ]
        self.tally.add_(self._is_kind @ torch.stack(rows, -1))
        share = memory.way_m / memory.asked_m.clamp(min=1e-3)
        counts = memory.asked_m > _LEAST_WAY
        up = ~failed & counts & (share > config.promotion)
        is_whole = memory.first_time_s == 0.0  # one that begins in a jump is harder than its level
        down = is_whole & (failed | (counts & (share < config.demotion)))
        draw = _START.of(_DRAWS.of(self._draws).start).level
        level = moved_level(config.levels, memory.level, up, down, draw)
        write_memory(memory, self.done, level=level)

    def _reset(self, mask: Tensor) -> None:
        """Starts the next episode of the robots in `mask`; brings everyone the near ground."""
        memory, drawn = self.memory, _DRAWS.of(self._draws)
        start = _START.of(drawn.start)
        begins_so = starts.DRAWS.of(start.motion).jumps < self.config.jump_start.share
        jumps = mask & self._may_jump & begins_so
        level = torch.where(jumps, self.config.ground.levels - 1.0, memory.level)
        course = self.ground.table.draw(memory.kind, level, start.variant)
        write_memory(
            memory, mask, course=course, **draw_bodies(self.config.randomisation, drawn.body)
        )
        finish = self.ground.table.finish_x[memory.course]
        x = torch.where(memory.wide | jumps, start.x * finish, 0.4 * start.x - 0.2)
        y = torch.where(memory.wide, 1.0, 0.3) * (2.0 * start.y - 1.0)
        begin = torch.stack([x, y], -1)
        here = torch.where(mask[:, None], begin, torch.nan_to_num(self._qpos[:, :2].float()))
        boxes = self.ground.near(memory.course, here)
        write_memory(memory, center=boxes.center, half_size=boxes.half_size, turn=boxes.angles)
        self._engine.set_terrain(self._boxes())
        self._engine.set_bodies(self._bodies())
        self._place(mask, jumps, begin, start.motion)
        zero = torch.zeros_like(memory.time_s)
        command, standing = draw_command(self.config.command, memory.wide, drawn.command)
        jump = self.config.jump_start
        command[:, 0] = torch.where(jumps, self.config.command.along_mps[0], command[:, 0])
        stands = commands.DRAWS.of(drawn.command).standing < jump.standing
        standing = torch.where(jumps, stands, standing)
        led_s = torch.where(jumps, led_time(starts.DRAWS.of(start.motion).led), zero)
        begin_s = torch.where(jumps, max(self._time_limit_s - jump.lasts_s, 0.0), zero)
        redrawn = mask | (commands.DRAWS.of(drawn.command).when < DT / self.config.command.period_s)
        write_memory(memory, redrawn, drawn=command, standing=standing)
        write_memory(
            memory,
            mask,
            time_s=begin_s,
            first_time_s=begin_s,
            led_s=led_s,
            tick=zero,
            action=torch.zeros_like(memory.action),
            last_action=torch.zeros_like(memory.action),
            air_s=torch.zeros_like(memory.air_s),
            joint_velocity=torch.zeros_like(memory.joint_velocity),
            foot_touching=torch.zeros_like(memory.foot_touching),
            way_m=zero,
            asked_m=zero,
            phase=start.age,
            shift=2.0 * drawn.shift - 1.0,
            noise=drawn.noise,
        )

    def _place(self, mask: Tensor, jumps: Tensor, begin: Tensor, draws: Tensor) -> None:
        """Puts robots just above the ground below them: in their standing pose, or in a jump."""
        ranges = self.config.randomisation
        yaw = torch.where(self.memory.wide, torch.pi, ranges.start_yaw_rad)
        first = first_motion(
            self.config.jump_start, self._pose, ranges.start_joint_rad, yaw, jumps, draws
        )
        feet, rotation = self._legs.position(first.joints), rotation_matrix(first.quaternion)
        places = torch.cat([feet, self._trunk.expand(self.count, -1, -1)], 1) @ rotation.mT
        z = height_above(self._boxes(), begin, places, self.robot.foot_radius)
        fresh = torch.cat([begin, z[:, None], first.quaternion, first.joints], -1)
        rows = mask[:, None]
        for kept, new in (
            (self._qpos, fresh),
            (self._qvel, first.velocity),
            (self._warmstart, torch.zeros_like(self._warmstart)),
        ):
            kept.copy_(torch.where(rows, new.to(kept.dtype), kept))

    def _bodies(self) -> BodyModel:
        memory = self.memory
        usual = {name: value for name, (value, _) in SOFT_RUBBER.items()}
        claimed = BodyModel(
            payload_kg=memory.payload_kg,
            com_shift=memory.com_shift,
            inertia_scale=1.0,
            friction=memory.friction,
            **usual,
        )
        return self._body.apply(claimed)

    def _push(self) -> None:
        """Changes the velocity of some robots at random times with the configured mean period."""
        ranges, push = self.config.randomisation, _PUSH.of(_DRAWS.of(self._draws).push)
        kick = ranges.push_mps * (2.0 * torch.stack([push.ahead, push.aside], -1) - 1.0)
        pushed = (push.when < DT / ranges.push_period_s)[:, None]
        self._qvel[:, :2] += (kick * pushed).to(self._qvel.dtype)

    def _look(self, fresh: Tensor) -> None:
        """Writes the command and what policy and critic see; `fresh` are robots that begin."""
        memory, drawn = self.memory, _DRAWS.of(self._draws)
        qpos, qvel = self._qpos.float(), self._qvel.float()
        rotation, position = rotation_matrix(qpos[:, 3:7]), qpos[:, :3]
        _, _, yaw = roll_pitch_yaw(rotation)
        standing = memory.standing & (memory.time_s - memory.first_time_s >= memory.led_s)
        command = command_now(
            self.config.command, memory.drawn, memory.wide, standing, position[:, 1], yaw
        )
        pose = torch.cat([position, yaw[:, None]], -1)
        phase, arrived = self._scan_errors.arrives(memory.phase)
        late = torch.where(fresh[:, None], pose, memory.pose)
        write_memory(memory, fresh | arrived, image_pose=late)
        moved = fresh | self._scan_errors.moved(pose, memory.error_pose)
        error = self._scan_errors.changed(memory.error, fresh, moved, drawn.error)
        write_memory(memory, moved, error_pose=pose)
        write_memory(memory, command=command, phase=phase, pose=pose, error=error)
        true, _ = self._heights(pose)
        then, places = self._heights(memory.image_pose)
        told = self._scan_errors.observed(
            then, places, error, ScanDraws(memory.shift, memory.noise)
        )
        told = torch.where(self._is_exact[:, None], true, told)
        if self.config.blind:
            told = torch.full_like(told, -self._height)
        exact = self._observed(rotation, qpos, qvel, true, None)
        actor = self._observed(rotation, qpos, qvel, told, _SENSORS.of(drawn.sensors))
        self.actor.copy_(torch.nan_to_num(actor))
        known = torch.cat(
            [
                in_command_frame(qvel[:, :3], rotation),
                memory.friction[:, None],
                memory.payload_kg[:, None],
                memory.motor_strength[:, None],
                1e1 * memory.com_shift,
                memory.foot_touching.float(),
                memory.air_s,
                1e2 * memory.plan_delay_s[:, None],
            ],
            -1,
        )
        critic = torch.cat([exact, known], -1)
        self.critic.copy_(torch.nan_to_num(critic).clamp(-LIMIT, LIMIT))

    def _observed(
        self, rotation: Tensor, qpos: Tensor, qvel: Tensor, heights: Tensor, noise: Any
    ) -> Tensor:
        """The policy's vector, with noise where uniform numbers are given."""
        limits = self.config.sensors

        def noisy(value: Tensor, limit: float, draws: Tensor | None) -> Tensor:
            return value if draws is None else value + limit * (2.0 * draws - 1.0)

        def of(name: str) -> Tensor | None:
            return None if noise is None else getattr(noise, name)

        given = WalkerReadings(
            angular_velocity=noisy(qvel[:, 3:6], limits.angular_velocity, of("angular_velocity")),
            gravity=noisy(gravity_in_base(rotation), limits.gravity, of("gravity")),
            command=self.memory.command,
            joint_position=noisy(qpos[:, 7:], limits.joint_position, of("position")),
            joint_velocity=noisy(qvel[:, 6:], limits.joint_velocity, of("velocity")),
            action=self.memory.action,
            heights=heights,
        )
        return self._observer.vector(given)

    def _heights(self, pose: Tensor) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Ground at the scan's points above a base at x, y, z, yaw [m], shape (n, 187), and where
        they are.
        """
        places = SCAN.points_in_world(pose[:, :2], pose[:, 3])
        return self._boxes().height_at(*places) - pose[:, 2:3], places

    def _boxes(self) -> Boxes:
        memory = self.memory
        return Boxes(center=memory.center, half_size=memory.half_size, turn=memory.turn)

    @property
    def _time_limit_s(self) -> float:
        return self.config.time_limit_s
