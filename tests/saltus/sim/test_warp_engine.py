"""mujoco_warp on its processor device, against MuJoCo itself where both can answer."""

import mujoco
import numpy as np
import pytest
import torch
from samples import ROBOT

from saltus.sim.cpu_engine import CpuEngine
from saltus.sim.engine import Engine
from saltus.sim.warp_engine import WarpEngine
from saltus.terrain.boxes import Boxes

COUNT, BOXES = 3, 1
GROUND = Boxes(
    center=torch.tensor([0.0, 0.0, -1.0]).expand(COUNT, 1, 3), half_size=torch.ones(COUNT, 1, 3)
)
FRICTION, DAMPING, ARMATURE = 0.4, 0.3, 0.01


@pytest.fixture(scope="module")
def engines() -> tuple[Engine, Engine]:
    return CpuEngine(ROBOT, COUNT, BOXES, threads=1), WarpEngine(ROBOT, COUNT, BOXES, device="cpu")


def put_in_the_air(engine: Engine) -> None:
    """Robots high above the ground, whose joints turn: nothing touches."""
    qpos, qvel = torch.as_tensor(engine.qpos), torch.as_tensor(engine.qvel)
    qpos.zero_()
    qvel.zero_()
    qpos[:, 2], qpos[:, 3] = 5.0, 1.0
    qpos[:, 7:] = torch.tensor(ROBOT.stand_pose)
    qvel[:, 6:] = torch.linspace(-3.0, 3.0, COUNT * 12).reshape(COUNT, 12)
    torch.as_tensor(engine.warmstart).zero_()
    torch.as_tensor(engine.ctrl).zero_()


def joint_speeds(engine: Engine, steps: int) -> np.ndarray:
    put_in_the_air(engine)
    for _ in range(steps):
        engine.step()
    return torch.as_tensor(engine.qvel)[:, 6:].double().clone().numpy()


@pytest.mark.parametrize("rows", [1, COUNT])
def test_both_engines_turn_joints_alike_whatever_their_friction_and_inertia(
    engines: tuple[Engine, Engine], rows: int
) -> None:
    share = torch.linspace(0.5, 1.0, rows)[:, None] * torch.ones(rows, 12)
    results = []
    for engine in engines:
        engine.set_joints(FRICTION * share, DAMPING * share, ARMATURE * share)
        results.append(joint_speeds(engine, 5))
    np.testing.assert_allclose(results[1], results[0], atol=2e-3)


def test_friction_and_inertia_are_those_of_each_robot(engines: tuple[Engine, Engine]) -> None:
    none, one = torch.zeros(COUNT, 12), torch.ones(COUNT, 12)
    only_last = one * (torch.arange(COUNT) == COUNT - 1)[:, None]
    for engine in engines:
        engine.set_joints(none, none, none)
        free = joint_speeds(engine, 3)
        engine.set_joints(FRICTION * only_last, none, none)
        braked = joint_speeds(engine, 3)
        np.testing.assert_allclose(braked[:-1], free[:-1], atol=1e-5)
        assert np.abs(braked[-1]).mean() < np.abs(free[-1]).mean()
        engine.set_joints(none, none, 1e3 * only_last)  # so heavy that nothing turns it any more
        assert (
            np.abs(joint_speeds(engine, 3)[-1] - np.linspace(-3.0, 3.0, COUNT * 12)[-12:]).max()
            < 0.05
        )
        engine.set_joints(none, none, none)
        np.testing.assert_array_equal(joint_speeds(engine, 3), free)


def test_joints_without_more_have_the_inertia_of_their_rotors(
    engines: tuple[Engine, Engine],
) -> None:
    exact, _ = engines
    assert isinstance(exact, CpuEngine)
    model = exact.model
    data = mujoco.MjData(model)
    data.qpos[:] = [0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0, *ROBOT.stand_pose]
    data.qvel[6:] = np.linspace(-3.0, 3.0, COUNT * 12)[:12]
    for _ in range(3):
        mujoco.mj_step(model, data)
    for engine in engines:
        engine.set_joints(*(torch.zeros(1, 12) for _ in range(3)))
        np.testing.assert_allclose(joint_speeds(engine, 3)[0], data.qvel[6:], atol=1e-3)


def test_a_solver_that_is_stopped_early_prints_nothing(
    engines: tuple[Engine, Engine], capfd: pytest.CaptureFixture[str]
) -> None:
    _, engine = engines
    put_in_the_air(engine)
    qpos, qvel = torch.as_tensor(engine.qpos), torch.as_tensor(engine.qvel)
    engine.set_terrain(GROUND)
    qpos[:, 2] = torch.tensor([0.05, 0.1, 0.15])  # legs in the ground
    qvel[:, 0] = 10.0
    for _ in range(5):
        engine.step()
    assert "limit reached" not in capfd.readouterr().out


def test_robots_whose_contacts_find_no_room_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("saltus.sim.warp_engine.CONTACTS", 8)
    engine = WarpEngine(ROBOT, COUNT, BOXES, device="cpu")
    put_in_the_air(engine)
    engine.set_terrain(GROUND)
    engine.step()
    assert not engine.crowded().any()
    torch.as_tensor(engine.qpos)[:, 2] = 0.05  # whole legs in the ground: more than 8 contacts each
    engine.step()
    assert engine.crowded().any()
    assert not engine.crowded().any()


def test_the_processor_makes_room(engines: tuple[Engine, Engine]) -> None:
    assert not engines[0].crowded().any()
