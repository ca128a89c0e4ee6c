"""The state of a training environment beside the physics:
tensors that are changed in place, one row for each robot.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor

from saltus.effects.chain import ActuatorState, ImuMemory
from saltus.effects.effect import State, map_arrays
from saltus.policy.bounds import ACTIONS
from saltus.policy.env.jump_rewards import TERMS
from saltus.policy.policy_features import RECALLED
from saltus.terrain.course_batch import COLUMNS


@dataclass(kw_only=True, eq=False)
class JumpMemory:
    """Memory of jumping robots in training, beside what the physics engine holds: gaits, estimates,
    plans, rewards so far.

    Shapes are for one robot; every tensor has a leading dimension.
    """

    # the leg controller, the estimator and the drives
    phase: Tensor
    liftoff: Tensor  # (4, 3)
    estimate: Tensor  # (4,)
    variance: Tensor  # (4,)
    actuators: ActuatorState  # see `saltus.effects.chain.ActuatorChain`
    imu: ImuMemory | None  # None where the IMU has no effects
    contact: Tensor  # (4,), bool
    progress: Tensor  # (4,)
    trusted: Tensor  # (4,), bool
    tracking_cost: Tensor
    # the present action
    plan: Tensor  # (10,), values within bounds
    plans: Tensor  # (length, 10): the same, and those before it
    # (steps, RECALLED): what the policy remembers, see `saltus.policy.policy_features.next_past`
    past: Tensor
    tick: Tensor  # physics steps since the plan
    excess: Tensor
    # the episode
    time_s: Tensor
    first_time_s: Tensor  # when the episode began: 0, but for a robot's first
    start_x: Tensor
    heading: Tensor
    cycle: Tensor
    goal_x: Tensor
    goal_z: Tensor
    goal_length: Tensor
    touched: Tensor  # (16,), bool: in the last 10 ms, as `saltus.sim.engine.TOUCHING`
    terms: Tensor  # (len(TERMS),): reward of the last 10 ms
    # what was drawn for it
    kind: Tensor  # int64
    level: Tensor
    friction: Tensor
    payload_kg: Tensor
    motor_strength: Tensor
    com_shift: Tensor  # (3,)
    delay_s: Tensor
    plan_delay_s: Tensor
    height_shift: Tensor  # (2,): ahead, up
    pitch_torque: Tensor
    low: (
        Tensor  # (COLUMNS,), as the three that follow: of `saltus.terrain.course_batch.CourseBatch`
    )
    high: Tensor
    top: Tensor
    finish_x: Tensor
    slope: Tensor
    floor: Tensor
    course: Tensor  # of a family of one's own: its place in `saltus.terrain.course_table`
    # drawn only where `saltus.policy.env.randomisation.WideSettings` is on
    joint_friction: Tensor
    joint_damping: Tensor
    softness: Tensor
    command_delay_s: Tensor
    push_mps: Tensor


_ROWS: dict[str, tuple[int, ...]] = {
    "liftoff": (4, 3),
    "estimate": (4,),
    "variance": (4,),
    "progress": (4,),
    "plan": (len(ACTIONS),),
    "terms": (len(TERMS),),
    "com_shift": (3,),
    "height_shift": (2,),
    "low": (COLUMNS,),
    "high": (COLUMNS,),
    "top": (COLUMNS,),
}
_FLAGS = {"contact": (4,), "trusted": (4,), "touched": (16,)}


def blank_jump_memory(
    kinds: Iterable[int], plans: int, past: int, device: torch.device
) -> JumpMemory:
    """Zeros for robots on the given kinds of terrain.

    Every episode begins with a reset that fills them.

    So many plans are kept, and so many steps of the past.
    """
    kind = torch.tensor(list(kinds), dtype=torch.int64, device=device)
    count = len(kind)
    tensors: dict[str, Any] = {"actuators": (), "imu": None}
    for f in fields(JumpMemory):
        if f.name in tensors:
            continue
        if f.name in _FLAGS:
            tensors[f.name] = torch.zeros(count, *_FLAGS[f.name], dtype=torch.bool, device=device)
        else:
            tensors[f.name] = torch.zeros(count, *_ROWS.get(f.name, ()), device=device)
    tensors["plans"] = torch.zeros(count, plans, len(ACTIONS), device=device)
    tensors["past"] = torch.zeros(count, past, RECALLED, device=device)
    tensors["kind"] = kind
    return JumpMemory(**tensors)


def write_memory(memory: Any, mask: Tensor | None = None, **values: Tensor) -> None:
    """Writes values of a memory in place: everywhere,
    or in the rows where `mask`, bool of shape (n,), is set.
    """
    for name, value in values.items():
        old = getattr(memory, name)
        if mask is not None:
            value = torch.where(mask.reshape(-1, *[1] * (old.ndim - 1)), value, old)
        old.copy_(value)


def write_effect_state(old: State, new: State) -> None:
    """Writes the state of effects over one that is built alike, in place."""
    map_arrays(lambda value, place: place.copy_(value), new, old)
