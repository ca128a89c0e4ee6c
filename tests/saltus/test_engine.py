from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from samples import ROBOT

from saltus.effects.body import claimed_body
from saltus.effects.effect import map_arrays
from saltus.sim.cpu_engine import CpuEngine
from saltus.sim.warp_engine import WarpEngine
from saltus.terrain.boxes import Boxes

COUNT, BOXES = 3, 4


def prepared(engine, pitch=0.0, yaw=0.0, **feet):
    """Robots just above their own terrains: level, raised, and a step under the front feet.

    Or all that turned.
    """
    center, half = torch.zeros(COUNT, BOXES, 3), torch.ones(COUNT, BOXES, 3)
    center[..., 2] = -1.0
    half[:, 0, 0], center[:, 1, 0], center[:, 2, 0] = 0.1, 1.1, -1.1
    center[:, 3, 2], half[:, 3, 0] = -1.2, 6.0
    center[1, :, 2] += 0.1
    center[2, 1, 2] += 0.05
    turn = torch.tensor([pitch, yaw]).expand(COUNT, BOXES, 2)
    engine.set_terrain(Boxes(center=center, half_size=half, turn=turn if pitch or yaw else None))
    shift = torch.tensor([[0.0, 0.0, 0.0], [0.02, 0.0, 0.01], [0.0, -0.02, 0.0]])
    body = replace(
        map_arrays(torch.tensor, claimed_body((COUNT,))),
        friction=torch.tensor([0.5, 0.8, 1.0]),
        payload_kg=torch.tensor([0.0, 0.75, 1.5]),
        com_shift=shift,
        **{name: torch.full((COUNT,), value) for name, value in feet.items()},
    )
    engine.set_bodies(body)
    qpos, qvel = torch.as_tensor(engine.qpos), torch.as_tensor(engine.qvel)
    qpos.zero_()
    qvel.zero_()
    qpos[:, 3] = 1.0
    qpos[:, 7:] = torch.tensor(ROBOT.stand_pose)
    qpos[:, 2] = torch.tensor([0.29, 0.39, 0.34])
    torch.as_tensor(engine.warmstart).zero_()
    torch.as_tensor(engine.trunk_wrench)[:, 4] = 1.0
    return engine


def run(engine, steps):
    qpos, qvel = torch.as_tensor(engine.qpos), torch.as_tensor(engine.qvel)
    ctrl = torch.as_tensor(engine.ctrl)
    states, touches = [], []
    for _ in range(steps):
        ctrl[:] = 60.0 * (torch.tensor(ROBOT.stand_pose) - qpos[:, 7:]) - 2.0 * qvel[:, 6:]
        engine.step()
        states.append(torch.cat([qpos, qvel], 1).double().clone().numpy())
        touches.append(torch.as_tensor(engine.touching()).clone().numpy())
    return np.stack(states), np.stack(touches)


@pytest.fixture(scope="module")
def results():
    engines = [
        prepared(CpuEngine(ROBOT, COUNT, BOXES, threads=1)),
        prepared(WarpEngine(ROBOT, COUNT, BOXES, device="cpu")),
    ]
    return [run(engine, 120) for engine in engines]


def test_both_engines_simulate_the_same_robots(results):
    (exact, touch), (other, other_touch) = results
    assert np.abs(exact - other).max() < 2e-3
    assert (touch == other_touch).mean() > 0.99


def test_both_engines_have_feet_that_resist_rolling(results):
    feet = {"torsion": 0.02, "rolling": 0.03, "touch_impedance": 0.2, "impedance_depth": 0.01}
    kinds = (partial(CpuEngine, threads=1), partial(WarpEngine, device="cpu"))
    (exact, _), (other, _) = (
        run(prepared(kind(ROBOT, COUNT, BOXES, dimensions=6), **feet), 120) for kind in kinds
    )
    assert np.abs(exact - other).max() < 5e-3
    assert np.abs(exact - results[0][0]).max() > 0.02


def test_both_engines_know_turned_boxes_and_forget_them():
    engines = [
        CpuEngine(ROBOT, COUNT, BOXES, threads=1),
        WarpEngine(ROBOT, COUNT, BOXES, device="cpu"),
    ]
    (level, _), (exact, touch), (other, other_touch), (again, _) = (
        run(prepared(engine, *turn), 120)
        for engine, turn in zip(
            [engines[0], *engines, engines[0]], [(), (0.1, 0.4), (0.1, 0.4), ()], strict=True
        )
    )
    assert np.abs(exact - other).max() < 5e-3
    assert (touch == other_touch).mean() > 0.99
    assert np.abs(exact - level).max() > 0.05
    np.testing.assert_array_equal(again, level)


def test_robots_stand_on_their_own_terrain(results):
    states, touch = results[0]
    height = states[-1, :, 2]
    assert abs(height[1] - height[0] - 0.1) < 0.01
    assert 0.01 < height[2] - height[0] < 0.05
    assert touch[-1, :, :4].any(axis=1).all()
    assert not touch[:, :, 12:].any()
