"""The state of a walking environment beside the physics.

Tensors that are changed in place, one row for each robot.
"""

from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor

from saltus.grid import SCAN
from saltus.policy.walking.walk_rewards import TERMS


@dataclass(kw_only=True, eq=False)
class WalkMemory:
    """Memory of walking robots in training, beside what the physics engine holds; shapes are for
    one robot.
    """

    actuators: Any  # states of the effects of the drives, see `saltus.effects.chain.ActuatorChain`
    tick: Tensor  # physics steps since the action
    time_s: Tensor
    first_time_s: Tensor  # when the episode began: 0, but for a robot's first
    led_s: Tensor  # time for which a robot that begins in a jump is led ahead, before it may stand
    action: Tensor  # (12,)
    last_action: Tensor  # (12,): the one before it
    torque: Tensor  # (12,): in the last physics step
    joint_velocity: Tensor  # (12,): at the last step
    foot_touching: Tensor  # (4,), bool: at the last step
    air_s: Tensor  # (4,): since each foot touched the ground
    terms: Tensor  # (len(TERMS),): reward of the last step
    # the command
    drawn: Tensor  # (3,), see `saltus.policy.walking.commands`
    standing: Tensor  # bool
    command: Tensor  # (3,)
    # the episode
    kind: Tensor  # int64, place of its family in `GroundSettings.shares`
    wide: Tensor  # bool, see `GroundSettings.wide`
    level: Tensor
    course: Tensor  # int64, place in the table
    way_m: Tensor  # as commanded, along the command
    asked_m: Tensor
    # what the scan shows
    phase: Tensor  # of the camera
    pose: Tensor  # (4,): x, y, z, yaw of the base at the last step
    image_pose: Tensor  # (4,): the same at the last image
    error: Tensor  # (187,)
    error_pose: Tensor  # (4,): of the base when errors changed
    shift: Tensor
    noise: Tensor
    # the ground: boxes, the nearest
    center: Tensor  # (boxes, 3)
    half_size: Tensor  # (boxes, 3)
    turn: Tensor  # (boxes, 2)
    # the body
    friction: Tensor
    payload_kg: Tensor
    motor_strength: Tensor
    com_shift: Tensor  # (3,)
    delay_s: Tensor
    plan_delay_s: Tensor


_ROWS: dict[str, tuple[int, ...]] = {
    "action": (12,),
    "last_action": (12,),
    "torque": (12,),
    "joint_velocity": (12,),
    "air_s": (4,),
    "terms": (len(TERMS),),
    "drawn": (3,),
    "command": (3,),
    "pose": (4,),
    "image_pose": (4,),
    "error_pose": (4,),
    "error": (SCAN.size,),
    "com_shift": (3,),
}
_FLAGS = {"foot_touching": (4,), "standing": ()}


def blank_walk_memory(kind: Tensor, wide: Tensor, boxes: int) -> WalkMemory:
    """Zeros for robots on the given families; a reset fills them."""
    count, device = len(kind), kind.device
    rows = _ROWS | {"center": (boxes, 3), "half_size": (boxes, 3), "turn": (boxes, 2)}
    given: dict[str, Any] = {
        "actuators": (),
        "kind": kind,
        "wide": wide,
        "course": torch.zeros_like(kind),
    }
    blank: dict[str, Any] = {
        f.name: torch.zeros(
            count,
            *_FLAGS.get(f.name, rows.get(f.name, ())),
            dtype=torch.bool if f.name in _FLAGS else torch.float32,
            device=device,
        )
        for f in fields(WalkMemory)
        if f.name not in given
    }
    return WalkMemory(**given, **blank)
