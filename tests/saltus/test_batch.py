import dataclasses

import numpy as np
import pytest
from random_terrain import random_terrain
from samples import PROFILE, ROBOT

from saltus.config import TerrainConfig
from saltus.effects.chain import ActuatorChain
from saltus.effects.motors import ActuatorLag
from saltus.joint_command import JointCommand
from saltus.sim.batch_plant import BatchPlant
from saltus.sim.plant import Plant
from saltus.sim.plant_state import PlantState
from saltus.terrain.curriculum import FAMILIES, make_terrain

TURNED = random_terrain(1)
TERRAINS = [*(make_terrain(TerrainConfig(terrain=kind)) for kind in FAMILIES), TURNED]
COUNT = len(TERRAINS)
FRICTION = np.linspace(0.5, 1.0, COUNT)
PAYLOAD = np.linspace(0.0, 1.5, COUNT)
START = np.array([0.1, 1.4, 1.6, *[1.3] * (COUNT - 4), 1.4])
CHAIN = ActuatorChain((*PROFILE.actuator, ActuatorLag(time_constant=0.004)))


def command_for(rng: np.random.Generator, count: int) -> JointCommand:
    one = np.ones((count, 12))
    torque = rng.normal(0.0, 2.0, (count, 12))
    return JointCommand(
        position=ROBOT.stand_pose + rng.normal(0.0, 0.1, (count, 12)),
        velocity=0 * one,
        kp=50 * one,
        kd=one,
        torque=torque,
    )


def row(command: JointCommand, i: int) -> JointCommand:
    return JointCommand(
        **{f.name: getattr(command, f.name)[i] for f in dataclasses.fields(command)}
    )


def assert_row_equals(batch: PlantState, i: int, single: PlantState) -> None:
    for field in dataclasses.fields(PlantState):
        both = getattr(batch, field.name)[i], getattr(single, field.name)
        np.testing.assert_allclose(*both, atol=1e-9, err_msg=f"robot {i}, {field.name}")


def test_a_batch_equals_single_plants_through_resets() -> None:
    rng = np.random.default_rng(0)
    batch = BatchPlant(
        ROBOT, TERRAINS, COUNT, friction=FRICTION, payload_kg=PAYLOAD, chain=CHAIN, threads=1
    )
    singles = [
        Plant(ROBOT, terrain, friction=friction, payload_kg=payload, chain=CHAIN)
        for terrain, friction, payload in zip(TERRAINS, FRICTION, PAYLOAD, strict=True)
    ]
    batch.reset(position_x=START, yaw=0.1)
    for plant, x in zip(singles, START, strict=True):
        plant.reset(x, yaw=0.1)
    for step in range(160):
        if step == 60:
            batch.reset(np.array([1, 3]), position_x=0.3)
            singles[1].reset(0.3)
            singles[3].reset(0.3)
        command = command_for(rng, COUNT)
        state = batch.step(command)
        for i, plant in enumerate(singles):
            assert_row_equals(state, i, plant.step(row(command, i)))


@pytest.mark.parametrize("threads", [1, 2])
def test_threads_and_neighbours_change_nothing(threads: int) -> None:
    rng = np.random.default_rng(2)
    batch = BatchPlant(ROBOT, TERRAINS[1], 7, threads=threads)
    alone = BatchPlant(ROBOT, TERRAINS[1], 1, threads=1)
    for _ in range(100):
        command = command_for(rng, 7)
        state = batch.step(command)
        reference = alone.step(
            JointCommand(
                **{f.name: getattr(command, f.name)[4:5] for f in dataclasses.fields(command)}
            )
        )
    for field in dataclasses.fields(PlantState):
        np.testing.assert_array_equal(
            getattr(state, field.name)[4], getattr(reference, field.name)[0]
        )
