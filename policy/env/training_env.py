"""Any environment of a training: thousands of robots in lockstep,
between what learns and the physics.

All its state lives in tensors that every stage changes in place, so that on a GPU each stage is
replayed as a CUDA graph and nothing waits for the processor.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor

from saltus.arrays import Array
from saltus.constants import PHYSICS_DT
from saltus.effects.chain import ActuatorChain, Torques
from saltus.effects.effect import map_arrays
from saltus.joint_command import JointCommand
from saltus.policy.env.jump_memory import write_effect_state, write_memory
from saltus.robots.legs import LegKinematics
from saltus.sim.engine import Engine

_COMPILATIONS = 10_000
"""Compilations of one function in a process: each environment compiles it for its own tensors.
Torch would stop at 8 of them."""
_WARM_UPS = 3  # as PyTorch's notes on CUDA graphs do: lazy initialisation is over by then
_UNROLLED = 17  # sums of up to 16 terms are written out: the longest product here is of 16 terms


class EnvStage:
    """A function that changes tensors in place, always the same ones.

    Called a few times before it is replayed.
    """

    def __init__(self, function: Callable[[], None], device: torch.device) -> None:
        self._function = function
        self._device = device
        self._graph: torch.cuda.CUDAGraph | None = None

    def prepare(self) -> None:
        """Compiles and records the function, which changes the tensors; nothing on a CPU."""
        if self._device.type != "cuda":
            return
        self._function()  # what is computed once and kept is not to be traced
        compiled = self.compiled(_fusing_backend())
        beside = torch.cuda.Stream()
        beside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(beside):
            for _ in range(_WARM_UPS):
                compiled()
        torch.cuda.current_stream().wait_stream(beside)
        self._graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(
            self._graph, capture_error_mode="thread_local"
        ):  # NCCL has threads of its own
            compiled()

    def compiled(self, backend: Callable[..., object] | str) -> Callable[[], None]:
        """The function as one graph, which is made by its first call."""
        from torch._dynamo import config  # half a second, of which what runs on a CPU has no use

        compiled = torch.compile(self._function, backend=backend, dynamic=False, fullgraph=True)

        def call() -> None:
            with config.patch(
                recompile_limit=_COMPILATIONS, accumulated_recompile_limit=_COMPILATIONS
            ):
                compiled()

        return call

    def __call__(self) -> None:
        """Does it."""
        if self._graph is None:
            self._function()
        else:
            self._graph.replay()


def _fusing_backend() -> Callable[..., object]:
    """The default compiler, with products of small matrices written out.

    A leg controller multiplies thousands of 3 x 3 matrices. As calls of a library each is a kernel
    of its own that goes through memory; as sums of products they join the arithmetic around them.
    """
    from torch._inductor.compile_fx import compile_fx
    from torch._inductor.decomposition import select_decomp_table

    table = {
        **select_decomp_table(),
        torch.ops.aten.bmm.default: _written_out_bmm,
        torch.ops.aten.mm.default: _written_out_mm,
    }
    return partial(
        compile_fx, decompositions=table, config_patches={"unroll_reductions_threshold": _UNROLLED}
    )


def _written_out_bmm(a: Tensor, b: Tensor) -> Tensor:
    return (a[:, :, :, None] * b[:, None, :, :]).sum(2)


def _written_out_mm(a: Tensor, b: Tensor) -> Tensor:
    return (a[:, :, None] * b[None, :, :]).sum(1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Transition:
    """Result of a step of training robots: observations, rewards, who ended; nothing in it changes
    with the next step.
    """

    actor: Tensor
    """Inputs of the policy, after resets, shape (n, some)."""
    critic: Tensor
    """Inputs of the critic alone, shape (n, some)."""
    reward: Tensor
    """Shape (n,)."""
    done: Tensor
    """The episode is over and the next has begun, bool, shape (n,)."""
    timed_out: Tensor
    """It ended at the time limit or at the end of the course, which is no failure.

    Bool, shape (n,).
    """


class TrainingEnv(ABC):
    """Training environment of many robots: their joints follow the commands of a network, or of a
    law that is given the network's plans.

    Args:
        engine: The physics, on the same device.
        device: Of all tensors.
        seed: Of all random numbers.
        outputs: Size of the network's output.
    """

    substeps: ClassVar[int]
    """Physics steps in a step of the policy."""
    memory: Any
    """Its tensors, among them `kind` (int64) and `level` of each robot, shape (n,)."""
    _draws: Tensor
    """Uniform numbers for resets and observations, filled before each."""
    _shown: Transition
    """The last one, in tensors that the next step changes."""
    _sums: tuple[Tensor, ...]
    """Tallies, which begin anew with the episodes."""

    def __init__(self, engine: Engine, device: str, seed: int, outputs: int) -> None:
        self.robot, self.count = engine.robot, engine.count
        self.device = torch.device(device)
        self._engine = engine
        self._qpos, self._qvel = torch.as_tensor(engine.qpos), torch.as_tensor(engine.qvel)
        self._ctrl = torch.as_tensor(engine.ctrl)
        self._legs = LegKinematics(self.robot)
        self._generator = torch.Generator(self.device).manual_seed(seed)
        self._output = torch.zeros(self.count, outputs, device=self.device)

    def step(self, output: Tensor) -> Transition:
        """One step of the policy with the network's output, shape (n, outputs)."""
        plan, control, *sense, finish = self.stages
        self._output.copy_(output)
        plan()
        for _ in range(self.substeps):
            control()
            self._engine.step()
            for stage in sense:
                stage()
        self._draws.uniform_(generator=self._generator)
        finish()
        return self.transition()

    def transition(self) -> Transition:
        """The last one; before the first step, with the first observation."""
        shown: Transition = map_arrays(torch.clone, self._shown)
        return shown

    def crowded_share(self) -> float:
        """Share of the robots whose contacts found no room in the physics since the last call."""
        return float(torch.as_tensor(self._engine.crowded()).float().mean())

    @abstractmethod
    def grow(self, steps: float) -> None:
        """Ranges are drawn from as after so many environment steps of all processes."""

    def set_levels(self, level: Tensor) -> None:
        """Starts every robot again on a course of the given level, shape (n,)."""
        write_memory(self.memory, level=level)
        self._begin(prepare=False)

    def _equip(self, drives: ActuatorChain) -> None:
        """Gives the robots drives, and these blank memories."""
        self._drives = drives
        zero: Array = torch.zeros(self.count, 12, device=self.device)
        still = JointCommand(position=zero, velocity=zero, kp=zero, kd=zero, torque=zero)
        _, state = drives.step(still, zero, zero, self._time_s(), drives.blank)
        self.memory.actuators = map_arrays(torch.zeros_like, state)

    def _start(self, *stages: Callable[[], None]) -> None:
        """Makes stages of functions: plan, control, perhaps sense, finish;
        and starts all robots.
        """
        self.stages = [EnvStage(function, self.device) for function in stages]
        """The work of a step around the physics."""
        self._begin(prepare=True)

    @torch.no_grad()
    def _begin(self, prepare: bool) -> None:
        """Starts an episode of every robot, at a random age so that not all end at once."""
        self._draws.uniform_(generator=self._generator)
        everyone = torch.ones(self.count, dtype=torch.bool, device=self.device)
        self._reset(everyone)
        self._look(everyone)
        if prepare and self.device.type == "cuda":
            for stage in self.stages:
                stage.prepare()  # which runs it
            self.memory.level.zero_()
            self._begin(prepare=False)
            return
        age = torch.rand(self.count, generator=self._generator, device=self.device)
        write_memory(self.memory, time_s=age * self._time_limit_s)
        write_memory(self.memory, first_time_s=self.memory.time_s)
        for tally in self._sums:
            tally.zero_()

    def _drive(self, command: JointCommand, position: Tensor, velocity: Tensor) -> Torques:
        """Passes a command through the drives to the physics.

        Args:
            command: For all joints.
            position: Of the joints [rad], shape (n, 12).
            velocity: Of the joints [rad/s], shape (n, 12).
        """
        memory = self.memory
        torque, actuators = self._drives.step(
            command, position, velocity, self._time_s(), memory.actuators, self._fresh()
        )
        self._ctrl.copy_(torque.applied)
        if (resistance := torque.resistance) is not None:
            self._engine.set_joints(resistance.friction, resistance.damping, resistance.armature)
        write_effect_state(memory.actuators, actuators)
        return torque

    def _time_s(self) -> Tensor:
        """In the run of each robot, shape (n,)."""
        time_s: Tensor = self.memory.time_s + PHYSICS_DT * self.memory.tick
        return time_s

    def _fresh(self) -> Tensor:
        """Robots whose episode begins with the coming physics step, bool, shape (n,)."""
        memory = self.memory
        fresh: Tensor = (memory.time_s == memory.first_time_s) & (memory.tick == 0.0)
        return fresh

    @property
    @abstractmethod
    def _time_limit_s(self) -> float:
        """Length of an episode [s]."""

    @abstractmethod
    def _reset(self, robots: Tensor) -> None:
        """Starts the next episode of `robots`, bool, shape (n,)."""

    @abstractmethod
    def _look(self, fresh: Tensor) -> None:
        """Writes what policy and critic see; `fresh`, bool, shape (n,), are robots that begin."""
