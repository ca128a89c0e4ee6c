"""The training environment: thousands of robots, each on its course, in lockstep at 100 Hz.

A step is: clip the action; five times control, physics, sense; then judge, reset who is done,
observe.
"""

import math
from dataclasses import fields, replace

import torch
from torch import Tensor

from saltus.arrays import Constant, namespace
from saltus.constants import GRAVITY, PHYSICS_DT, POLICY_DT, POLICY_STEPS
from saltus.controller.compensation import compensation_of
from saltus.controller.estimator import Estimator, EstimatorState
from saltus.controller.gait import GaitState
from saltus.controller.leg_controller import LawState, LegController
from saltus.controller.stance import StanceSolver
from saltus.controller.stance_batched import BatchedSolver
from saltus.controller.yaw_frame import reference_of
from saltus.effects.effect import map_arrays
from saltus.effects.imu import ImuReading
from saltus.effects.profile import Profile, load_profile
from saltus.effects.signal_chain import chosen_of
from saltus.errors import ConfigError
from saltus.grid import HeightGrid
from saltus.joint_command import JointCommand
from saltus.policy.bounds import ACTIONS, plan_from_values
from saltus.policy.env.curriculum import kinds_of_robots
from saltus.policy.env.env_observations import EnvObservations
from saltus.policy.env.episode import EpisodeResets
from saltus.policy.env.jump_memory import (
    JumpMemory,
    blank_jump_memory,
    write_effect_state,
    write_memory,
)
from saltus.policy.env.jump_rewards import JumpRewardInputs, jump_reward_terms
from saltus.policy.env.randomisation import training_drives
from saltus.policy.env.settings import JumpEnvSettings
from saltus.policy.env.training_env import TrainingEnv, Transition
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.sim.engine import Engine
from saltus.states import ProprioceptionArrays
from saltus.terrain.course_batch import CourseBatch
from saltus.wire.messages import ControllerMode


def engine_states(engine: Engine, memory: JumpMemory) -> ProprioceptionArrays:
    """IMU and encoders as the engine's positions and velocities say,
    estimates and schedule as remembered; tensors.
    """
    qpos, qvel = torch.as_tensor(engine.qpos).float(), torch.as_tensor(engine.qvel).float()
    force = torch.as_tensor(engine.qacc)[:, :3].float() + qpos.new_tensor([0.0, 0.0, GRAVITY])
    return ProprioceptionArrays(
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


class JumpEnv(TrainingEnv):
    """Robots that jump, given heights on a grid.

    Tensors are on the engine's device, stance forces by default of the batched solver.
    """

    substeps = POLICY_STEPS
    memory: JumpMemory

    def __init__(
        self,
        engine: Engine,
        config: JumpEnvSettings,
        grid: HeightGrid,
        *,
        seed: int,
        device: str = "cpu",
        solver: StanceSolver | None = None,
    ) -> None:
        super().__init__(engine, device, seed, len(ACTIONS))
        self.config = config
        self._stand_pose = Constant(self.robot.stand_pose)
        self._speed_limit = Constant(self.robot.speed_limit)
        profile = load_profile(config.profile, self.robot)
        self._law = LegController(
            self.robot,
            solver=solver or BatchedSolver(self.robot),
            compensation=compensation_of(profile, self.robot),
        )
        self._estimator = Estimator(self.robot)
        kinds = kinds_of_robots(config.curriculum.shares, self.count)
        plans = 1 + math.ceil(config.randomisation.plan_delay_s[1] / POLICY_DT)
        self.memory = blank_jump_memory(
            kinds, plans, max(config.past_steps, default=0), self.device
        )
        self._plans_ago = torch.arange(plans, device=self.device)
        self._blank_law = self._law.init((self.count,), self.memory.phase)
        self.standing = torch.zeros(self.count, dtype=torch.bool, device=self.device)
        """Robots that stand, whatever their plan; they begin to step when they do so no more. May
        be written in place, shape (n,)."""
        self.views = EnvObservations(
            self.robot, grid, self.memory, config, self.states, self._qpos, self._qvel
        )
        self._equip_with(profile)
        self.episodes = EpisodeResets(
            self.memory, config, engine, self._estimator, self.views, profile
        )
        ends, self._draws, self._sums = self.episodes, self.episodes.draws, (self.episodes.tally,)
        self._shown = Transition(
            actor=self.views.actor, critic=self.views.critic,
            reward=ends.reward, done=ends.done, timed_out=ends.timed_out,
        )  # fmt: skip
        self._start(self._plan, self._control, self._sense, self._finish)

    def _equip_with(self, profile: Profile) -> None:
        """Gives the robots drives and IMUs, and these blank memories.

        Raises:
            ConfigError: an effect that a training cannot hold.
        """
        if self.config.contact_dimensions(profile) > self._engine.dimensions:
            raise ConfigError(
                "soft_feet: contacts of this engine resist neither turning nor rolling; give it 6 "
                "dimensions, or leave "
                "torsion and rolling out of the profile, and softness out of the draws"
            )
        randomisation = self.config.randomisation
        self._equip(training_drives(self.robot, profile, randomisation, self.memory))
        self._imu = profile.imu_chain
        if self._imu.effects:
            reading = _reading(engine_states(self._engine, self.memory))
            now = self._imu.step(reading, self._time_s(), self._imu.blank)
            self.memory.imu = map_arrays(torch.zeros_like, now)

    def grow(self, steps: float) -> None:
        """Ranges are drawn from as after so many environment steps of all processes."""
        self.episodes.grow(steps)

    @torch.no_grad()
    def _plan(self) -> None:
        bounds = self.config.bounds
        wanted = bounds.denormalised(self._output)
        plan = bounds.clipped(wanted)
        beyond = bounds.normalised(wanted) - bounds.normalised(plan)
        excess = (0.25 * beyond * beyond).sum(-1)  # outputs span 2, ranges 1
        memory, latest = self.memory, plan[:, None]
        # Before its first plan a robot had none
        begins = (memory.time_s == memory.first_time_s)[:, None, None]
        plans = torch.where(begins, latest, torch.cat([latest, memory.plans[:, :-1]], 1))
        write_memory(
            memory, plan=plan, excess=excess, plans=plans, tick=torch.zeros_like(memory.tick)
        )
        self.memory.terms.zero_()
        self.memory.touched.zero_()

    @torch.no_grad()
    def _control(self) -> None:
        memory, true = self.memory, engine_states(self._engine, self.memory)
        states = self._sensed(true)
        reference = reference_of(plan_from_values(self._obeyed()), memory.heading)
        command, state, seen = self._law.step(
            reference, states, self._law_state(), ControllerMode.RUN
        )
        command = self._or_stand(command)
        self._drive(command, true.joint_position, true.joint_velocity)
        stands = self.standing[:, None]
        write_memory(
            memory,
            phase=torch.where(self.standing, 0.0, state.gait.phase),
            liftoff=state.liftoff,
            contact=seen.gait.contact | stands,
            progress=torch.where(stands, 0.0, seen.gait.progress),
            trusted=seen.gait.trusted | stands,
            tracking_cost=seen.tracking_cost,
            tick=memory.tick + 1.0,
        )

    def _obeyed(self) -> Tensor:
        """The newest plan that has arrived by now, shape (n, 10)."""
        memory = self.memory
        late = torch.ceil((memory.plan_delay_s / PHYSICS_DT - memory.tick) / POLICY_STEPS)
        ago = late.clamp(0.0, len(self._plans_ago) - 1.0)
        return torch.where((self._plans_ago == ago[:, None])[..., None], memory.plans, 0.0).sum(1)

    def _or_stand(self, command: JointCommand) -> JointCommand:
        """The command; that of the standing pose for robots that stand."""
        xp, gains, stands = namespace(command.torque), self.robot.gains, self.standing[:, None]
        zero = xp.zeros_like(command.torque)
        return JointCommand(
            position=xp.where(stands, zero + self._stand_pose.like(zero), command.position),
            velocity=xp.where(stands, zero, command.velocity),
            kp=xp.where(stands, zero + gains.stand_kp, command.kp),
            kd=xp.where(stands, zero + gains.stand_kd, command.kd),
            torque=xp.where(stands, zero, command.torque),
        )

    def _law_state(self) -> LawState:
        return LawState(
            gait=GaitState(phase=self.memory.phase),
            liftoff=self.memory.liftoff,
            landed=self._blank_law.landed,
            mode=ControllerMode.RUN,
            blend_from=self._blank_law.blend_from,
            rest=self._blank_law.rest,
            mode_time_s=0.0,
        )

    @torch.no_grad()
    def _sense(self) -> None:
        memory, true = self.memory, engine_states(self._engine, self.memory)
        if memory.imu:
            write_effect_state(
                memory.imu, self._imu.step(_reading(true), self._time_s(), memory.imu[1])
            )
        states = self._sensed(true)
        rotation = rotation_matrix(true.quaternion_base_in_world)
        old = EstimatorState(mean=memory.estimate, variance=memory.variance)
        new = self._estimator.step(states, memory.trusted, old)
        touching = torch.as_tensor(self._engine.touching())
        terms = jump_reward_terms(self.config.reward, self._reward_inputs(rotation, touching))
        write_memory(
            memory,
            estimate=new.mean,
            variance=new.variance,
            touched=memory.touched | touching,
            terms=memory.terms + terms,
        )

    def _reward_inputs(self, rotation: Tensor, touching: Tensor) -> JumpRewardInputs:
        memory = self.memory
        qpos, qvel = self._qpos.float(), self._qvel.float()
        position, velocity, angular_velocity = qpos[:, :3], qvel[:, :3], qvel[:, 3:6]
        foot, jacobian = self._legs.position_and_jacobian(qpos[:, 7:])
        foot_world = position[:, None] + foot @ rotation.mT
        relative = (jacobian @ qvel[:, 6:].reshape(-1, 4, 3, 1))[..., 0]
        relative = relative + torch.linalg.cross(angular_velocity[:, None].expand_as(foot), foot)
        foot_velocity = velocity[:, None] + relative @ rotation.mT
        places = torch.cat([foot_world, position[:, None]], 1)
        ground = self.courses().height_at(places[..., 0], places[..., 1])
        _, _, yaw = roll_pitch_yaw(rotation)
        return JumpRewardInputs(
            contact=memory.contact,
            foot_touching=touching[:, :4],
            leg_touching=touching[:, 4:8] | touching[:, 8:12],
            foot_speed_squared=foot_velocity[..., 0] ** 2 + foot_velocity[..., 1] ** 2,
            foot_clearance=foot_world[..., 2] - ground[:, :4] - self.robot.foot_radius,
            excess=memory.excess,
            stepping_frequency=memory.plan[:, 0],
            goal_error=(memory.goal_x - position[:, 0]) / memory.goal_length,
            height_error=memory.goal_z - position[:, 2],
            yaw_error=yaw - memory.heading,
            base_height=position[:, 2] - ground[:, 4],
            tracking_cost=memory.tracking_cost,
            joint_speed=qvel[:, 6:].abs() / self._speed_limit.like(qvel),
        )

    @torch.no_grad()
    def _finish(self) -> None:
        self.episodes.judge()
        self._reset(self.episodes.done)
        self.episodes.disturb()
        self._look(self.episodes.done | self.standing)

    def _look(self, fresh: Tensor) -> None:
        self.views.observe(self.episodes.height_noise, fresh)

    def _reset(self, robots: Tensor) -> None:
        self.episodes.reset(robots)
        if imu := self.memory.imu:
            now = self._imu.step(
                _reading(engine_states(self._engine, self.memory)), self._time_s(), imu[1], robots
            )
            write_effect_state(imu, chosen_of(robots, now, imu))
        self.views.set_goals(robots)

    def states(self) -> ProprioceptionArrays:
        """Returns what the robots know now."""
        return self._sensed(engine_states(self._engine, self.memory))

    def _sensed(self, true: ProprioceptionArrays) -> ProprioceptionArrays:
        """Returns what IMUs and encoders make of the true motion."""
        if self.memory.imu:
            reading = self.memory.imu[0]
            true = replace(true, **{f.name: getattr(reading, f.name) for f in fields(reading)})
        if not self._drives.senses_otherwise:
            return true
        motion = true.joint_position, true.joint_velocity
        joints = self._drives.measured(
            *motion, self._time_s(), self.memory.actuators, self._fresh()
        )
        return replace(true, joint_position=joints.position, joint_velocity=joints.velocity)

    @property
    def _time_limit_s(self) -> float:
        return self.config.episode.time_limit_s

    def courses(self) -> CourseBatch:
        """The terrain of every robot."""
        return self.views.courses()


def _reading(true: ProprioceptionArrays) -> ImuReading:
    return ImuReading(
        quaternion_base_in_world=true.quaternion_base_in_world,
        angular_velocity_base=true.angular_velocity_base,
        acceleration_base=true.acceleration_base,
    )
