"""Policies of others, by their descriptions:
what they are told and say is ours in another dialect.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from samples import ROBOT
from torch import Tensor, nn
from walking_policies import OURS, put_policy

from saltus.config import load_config
from saltus.dialects import DIALECTS, Dialect
from saltus.errors import ConfigError, ModelError
from saltus.grid import SCAN
from saltus.onnx_export import write_onnx
from saltus.policy.joints.description import ObservationPart, PolicyDescription
from saltus.policy.joints.policy import JointPolicy
from saltus.policy.joints.walker import RISE_NS, Walker
from saltus.policy.mover import PlannerDecision
from saltus.robots.robot import JOINTS
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.states import standing_state
from saltus.wire.messages import ControllerMode, RobotState

EXAMPLE = Path(__file__).parents[2] / "examples" / "foreign_policy.toml"
STEP_NS = 10_000_000
SIZES = dict.fromkeys(
    ("linear_velocity", "angular_velocity", "gravity", "command"), 3
) | dict.fromkeys(("joint_position", "joint_velocity", "action"), 12)
BY_KIND = [f"{leg}_{part}_joint" for part in ("hip", "thigh", "calf") for leg in
           ("FL", "FR", "RL", "RR")]  # fmt: skip
"""Order of IsaacLab: all hips come first."""


class Linear(nn.Module):
    """Actions that are a matrix times the vector."""

    def __init__(self, matrix: np.ndarray) -> None:
        super().__init__()
        self.matrix = nn.Parameter(torch.tensor(matrix, dtype=torch.float32))

    def forward(self, obs: Tensor) -> Tensor:
        """Shape (n, 12)."""
        return obs @ self.matrix.T


def put(path: Path, description: PolicyDescription, matrix: np.ndarray) -> Path:
    """A linear policy and a TOML file about it."""
    onnx = path.with_suffix(".onnx")
    write_onnx(
        Linear(matrix), (torch.zeros(2, description.size),), onnx,
        inputs=("obs",), outputs=("actions",), metadata={},
    )  # fmt: skip
    path.write_text(replace(description, model=onnx.name).to_toml(), encoding="utf-8")
    return path


def drawn_description(rng: np.random.Generator) -> PolicyDescription:
    """All parts but heights in any order, scaled, clipped, with joints in any order."""
    names = rng.permutation(list(SIZES))
    parts = [
        ObservationPart(
            name=str(name),
            scale=float(rng.uniform(0.1, 3.0))
            if rng.random() < 0.5
            else tuple(rng.uniform(0.1, 3.0, SIZES[str(name)]).tolist()),
            clip=float(rng.uniform(0.2, 2.0)) if rng.random() < 0.5 else np.inf,
        )
        for name in names
    ]
    order = [str(name) for name in rng.permutation(BY_KIND)]
    places = [JOINTS.index(name.removesuffix("_joint")) for name in order]
    return replace(
        OURS,
        observation=(*parts, ObservationPart(name="heights")),
        joints=tuple(order),
        pose_rad=tuple((ROBOT.stand_pose + rng.uniform(-0.1, 0.1, 12))[places].tolist()),
        action_scale_rad=tuple(rng.uniform(0.1, 0.5, 12).tolist()),
        kp=tuple(rng.uniform(20.0, 60.0, 12).tolist()),
        dialect=DIALECTS[str(rng.choice(list(DIALECTS)))],
    )


def state(step: int, rng: np.random.Generator, mode: ControllerMode) -> RobotState:
    angles = [np.asarray(angle) for angle in rng.uniform(-0.3, 0.3, 3)]
    return replace(
        standing_state(ROBOT),
        step=step,
        time_ns=step * STEP_NS,
        mode=mode,
        quaternion_base_in_world=quaternion_from_roll_pitch_yaw(*angles),
        angular_velocity_base=rng.normal(size=3),
        velocity_base_in_world=rng.normal(size=3),
        joint_position=ROBOT.stand_pose + rng.normal(size=12),
        joint_velocity=rng.normal(size=12),
    )


def told_by_hand(
    d: PolicyDescription, s: RobotState, action: np.ndarray, heights: np.ndarray, command: Any
) -> np.ndarray:
    """The vector by the words of the description, joint by joint and number by number."""
    w, x, y, z = s.quaternion_base_in_world
    to_base = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
        [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
        [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    places = [JOINTS.index(name.removesuffix("_joint")) for name in d.joints]
    numbers = {
        "linear_velocity": to_base @ s.velocity_base_in_world,
        "angular_velocity": s.angular_velocity_base,
        "gravity": to_base @ [0.0, 0.0, -1.0],
        "command": command,
        "joint_position": [s.joint_position[k] - d.pose_rad[i] for i, k in enumerate(places)],
        "joint_velocity": [s.joint_velocity[k] for k in places],
        "action": action,
        "heights": d.dialect.observation(heights, SCAN),
    }
    return np.concatenate([
        np.clip(numbers[part.name], -part.clip, part.clip) * np.asarray(part.scale)
        for part in d.observation
    ])  # fmt: skip


@pytest.mark.parametrize("seed", range(6))
def test_any_description_is_told_in_its_order_and_its_targets_are_ours(
    seed: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    described = drawn_description(rng)
    described = replace(
        described,
        history=int(rng.integers(1, 4)),
        history_of=str(rng.choice(["vector", "part"])),
        newest_first=bool(rng.random() < 0.5),
    )
    matrix = rng.normal(size=(12, described.size)) * 0.02
    policy = JointPolicy(put(tmp_path / "theirs.toml", described, matrix))
    walker, command = Walker(ROBOT, policy), (0.4, -0.1, 0.3)
    heights, past, action = rng.normal(size=SCAN.size) * 0.1 - 0.3, [], np.zeros(12)
    first = RISE_NS // STEP_NS + 1
    for step in [0, *range(first, first + 12, 2)]:
        now = state(step, rng, ControllerMode.WALK if step else ControllerMode.STAND)
        plan = walker.plan(PlannerDecision(state=now, heights=heights, velocity=command))
        if not step:
            continue
        past.append(told_by_hand(described, now, action, heights, command))
        recent = [past[max(0, len(past) - 1 - k)] for k in range(described.history)]
        recent = recent if described.newest_first else recent[::-1]
        if described.history_of == "part":
            ends = np.cumsum([SIZES.get(part.name, 187) for part in described.observation])[:-1]
            cut = [np.split(vector, ends) for vector in recent]
            given = np.concatenate([part for parts in zip(*cut, strict=True) for part in parts])
        else:
            given = np.concatenate(recent)
        action = np.clip(matrix @ given, -100.0, 100.0)
        scale, kp = np.broadcast_to(described.action_scale_rad, 12), described.kp
        for i, name in enumerate(described.joints):
            ours = JOINTS.index(name.removesuffix("_joint"))
            target = described.pose_rad[i] + scale[i] * action[i]
            assert plan.joint_position[ours] == pytest.approx(target, abs=1e-4)
            assert plan.kp[ours] == kp[i]


def test_our_own_policy_told_as_somebody_elses_walks_the_same(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    matrix = rng.normal(size=(12, OURS.size)) * 0.02
    own = Walker(ROBOT, JointPolicy(put(tmp_path / "own.toml", OURS, matrix)))
    places = [JOINTS.index(name.removesuffix("_joint")) for name in BY_KIND]
    scales = {"angular_velocity": 0.25, "joint_velocity": 0.05, "heights": 5.0}
    blocks = dict(zip([part.name for part in OURS.observation], np.split(
        matrix[places], np.cumsum(OURS.sizes)[:-1], axis=1), strict=True))  # fmt: skip
    for name in ("joint_position", "joint_velocity", "action"):
        blocks[name] = blocks[name][:, places]
    names = ("heights", "action", "command", "joint_velocity", "gravity", "joint_position",
             "angular_velocity")  # fmt: skip
    theirs = replace(
        OURS,
        observation=tuple(
            ObservationPart(name=name, scale=scales.get(name, 1.0)) for name in names
        ),
        joints=tuple(BY_KIND),
        pose_rad=tuple(OURS.pose[places].tolist()),
        dialect=Dialect(outer_axis="x", offset_m=0.5, clip_m=1.0),
    )
    by_x = np.arange(SCAN.size).reshape(SCAN.shape[::-1]).T.reshape(-1)
    blocks["heights"] = blocks["heights"][:, by_x]
    mixed = np.concatenate([blocks[name] / scales.get(name, 1.0) for name in names], axis=1)
    other = Walker(ROBOT, JointPolicy(put(tmp_path / "theirs.toml", theirs, mixed)))
    first = RISE_NS // STEP_NS + 1
    for step in [0, *range(first, first + 40, 2)]:
        now = state(step, rng, ControllerMode.WALK if step else ControllerMode.STAND)
        heights = rng.normal(size=SCAN.size) * 0.1 - 0.3
        decision = PlannerDecision(state=now, heights=heights, velocity=(0.5, 0.0, 0.1))
        plans = [walker.plan(decision) for walker in (own, other)]
        np.testing.assert_allclose(plans[1].joint_position, plans[0].joint_position, atol=1e-4)


def test_the_example_is_a_description() -> None:
    described = load_config(PolicyDescription, EXAMPLE)
    assert described.dialect == DIALECTS["legged_gym"]
    assert described.size == 235  # legged_gym's num_observations on rough ground
    assert described.pose[JOINTS.index("RR_thigh")] == 1.0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"joints": ("FR_hip",) * 12}, "joints: 1 names"),
        ({"joints": (*JOINTS[:11], "RL_knee")}, "no joint 'RL_knee'"),
        ({"pose_rad": (0.0,) * 11}, "pose_rad: 11 numbers"),
        (
            {"observation": (ObservationPart(name="gravity", scale=(1.0, 2.0)),)},
            "gravity has 2 scales",
        ),
        ({"rate_hz": 500.0}, "rate_hz = 500"),
        ({"history": 0}, "history = 0"),
        ({"grid": "none"}, "none"),
    ],
)
def test_a_wrong_description_is_refused_with_what_is_wrong(
    changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        replace(OURS, **changes)


def test_a_network_that_does_not_take_what_its_description_says_is_refused(tmp_path: Path) -> None:
    onnx = put_policy(tmp_path / "walk.onnx", describes_itself=False)
    shorter = replace(OURS, model=onnx.name, observation=OURS.observation[:-1])
    path = tmp_path / "shorter.toml"
    path.write_text(shorter.to_toml(), encoding="utf-8")
    with pytest.raises((ModelError, ConfigError), match=r"48|45|grid"):
        JointPolicy(path)
    path.write_text(OURS.to_toml(), encoding="utf-8")
    with pytest.raises(ConfigError, match="'model' is missing"):
        JointPolicy(path)
