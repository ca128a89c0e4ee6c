"""Runs the kernel's laws on numpy and torch, for one robot and for many,
each call with its shapes checked.
"""

import shape_checks  # noqa: F401 - before what it checks

# isort: split
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np
import torch

from saltus import rotations
from saltus.arrays import namespace
from saltus.controller.braking import Braking
from saltus.controller.estimator import Estimator
from saltus.controller.gait import standing_gait
from saltus.controller.leg_controller import LegController
from saltus.controller.stance_batched import BatchedSolver
from saltus.controller.yaw_frame import reference_of
from saltus.dialects import DIALECTS
from saltus.effects.camera import CameraChain
from saltus.effects.chain import ActuatorChain
from saltus.effects.effect import map_arrays
from saltus.effects.profile import load_profile
from saltus.effects.signals import DepthImage
from saltus.grid import LINE, SCAN
from saltus.joint_command import JointCommand
from saltus.plan import REST
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.states import SensorArrays, states_of
from saltus.terrain.boxes import Box, Boxes
from saltus.wire.messages import ControllerMode

ROBOT = load_robot(DEFAULT_ROBOT)
PROFILE = load_profile("shipped", ROBOT)
BATCHES: tuple[tuple[int, ...], ...] = ((), (5,), (2, 3))
TICKS = 3


def libraries() -> Iterator[Any]:
    """An array of each library, in the precision in which it is used."""
    yield np.zeros(1)
    yield torch.zeros(1)


def main() -> None:
    """Runs all laws."""
    for like in libraries():
        for batch in BATCHES:
            run(batch, like)


def run(batch: tuple[int, ...], like: Any) -> None:
    """The laws of robots of a batch."""
    xp, rng = namespace(like), np.random.default_rng(0)

    def drawn(*shape: int) -> Any:
        return xp.asarray(rng.uniform(-0.2, 0.2, (*batch, *shape)), dtype=like.dtype)

    angles = drawn(), drawn(), drawn()
    quaternion = rotations.quaternion_from_roll_pitch_yaw(*angles)
    turned = rotations.quaternion_product(quaternion, rotations.quaternion_inverse(quaternion))
    rotations.roll_pitch_yaw(rotations.rotation_matrix(turned))
    rotations.yaw_rotation(angles[2]), rotations.skew(drawn(3))
    for grid, dialect in ((LINE, "mjlab"), (SCAN, "isaaclab"), (SCAN, "legged_gym")):
        (
            grid.points_in_world(drawn(3), angles[2]),
            grid.points_in_world(drawn(2), angles[2], ahead=drawn()),
        )
        DIALECTS[dialect].observation(drawn(grid.size), grid)
    control(batch, like, quaternion, drawn)
    ground = Boxes.of(
        [
            Box.at((0.0, 0.0, -0.5), (4.0, 4.0, 1.0)),
            Box.at((1.0, 0.0, 0.1), (1.0, 1.0, 0.2), yaw=0.3),
        ]
    )
    of_batch = map_arrays(
        lambda value: np.broadcast_to(value, (*batch, *value.shape)).copy(), ground
    ).like(like)
    of_batch.height_at(drawn(7), drawn(7)), of_batch.extent, of_batch.quaternion
    image = DepthImage(depth=1.0 + drawn(48, 16), time_s=xp.zeros(batch, dtype=xp.float64))
    chain: CameraChain = PROFILE.camera_chain
    memory = map_arrays(lambda value: xp.asarray(value), chain.init(batch, rng))
    chain.step(image, 0.01, memory)


def control(batch: tuple[int, ...], like: Any, quaternion: Any, drawn: Any) -> None:
    """Estimator, law in every mode, braking, and drives."""
    xp = namespace(like)
    law, estimator, braking = (
        LegController(ROBOT, solver=BatchedSolver(ROBOT)),
        Estimator(ROBOT),
        Braking(ROBOT),
    )
    state, estimate = law.init(batch, like), estimator.init(batch, like)
    schedule = standing_gait(batch, like)
    joints = xp.asarray(ROBOT.stand_pose, dtype=like.dtype) + drawn(12)
    measured = SensorArrays(
        quaternion_base_in_world=quaternion, angular_velocity_base=drawn(3),
        acceleration_base=drawn(3),
        joint_position=joints, joint_velocity=drawn(12),
    )  # fmt: skip
    states = states_of(measured, estimate, schedule)
    rest = replace(
        REST, **{f.name: 0.0 * drawn(*getattr(REST, f.name).shape) + 1.0 for f in fields(REST)}
    )
    reference, ground = reference_of(rest, drawn()), braking.init(law._legs.position(joints))
    drives = ActuatorChain(PROFILE.actuator).fitted(ROBOT)
    memory = drives.blank
    for mode in (
        *(ControllerMode.RUN,) * TICKS,
        ControllerMode.LANDING,
        ControllerMode.STAND,
        ControllerMode.DAMP,
    ):
        command, state, diagnostics = law.step(reference, states, state, mode)
        estimate = estimator.step(states, diagnostics.gait.trusted, estimate)
        ground = braking.observe(diagnostics, ground)
        braked = braking.reference(diagnostics, states.base_height, drawn(), ground)
        (
            braking.catching(braked, ground),
            braking.is_slow(diagnostics),
            law.settled(state, diagnostics),
        )
        assert isinstance(command, JointCommand)
        time_s = xp.zeros(batch, dtype=like.dtype)
        _, memory = drives.step(command, joints, states.joint_velocity, time_s, memory)


if __name__ == "__main__":
    main()
