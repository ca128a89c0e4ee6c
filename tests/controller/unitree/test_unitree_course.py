"""A simulated robot over DDS in the run of a controller process: the truth beside its states."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from memory_bus import MemoryBus, MemoryHub
from samples import put_run, setup_of
from stand_ins import PREFIX, StandIns, of
from unitree_processes import simulated as simulated_process

from benchmarks.unitree_link.command import own_domain
from benchmarks.unitree_link.in_memory import ROBOT, Wire, simulated
from saltus.config import Pace, RunConfig, TerrainConfig
from saltus.controller import __main__ as controller
from saltus.controller.rising import RISE_S
from saltus.controller.robot.unitree import on_course
from saltus.controller.robot.unitree.link import TRUTHS
from saltus.controller.robot.unitree.on_course import UnitreeOnCourse
from saltus.controller.robot.unitree.truth import SHAPES, read_truth, tick_of, truth_payload
from saltus.errors import StackError
from saltus.grid import DEFAULT_GRID, load_grid
from saltus.policy.level_run import LevelRun
from saltus.policy.planner import make_planner
from saltus.runtime.process import ProcessContext
from saltus.sim.plant_state import PlantState
from saltus.terrain import flat
from saltus.wire.bus import topic_of, unpack_sample
from saltus.wire.messages import Event, GroundTruth, JointLog, Message, RobotState

GRID = load_grid(DEFAULT_GRID)
FLAT = setup_of(TerrainConfig(terrain="flat"), robot=ROBOT)
SPEED = 0.05  # of runs in real time: seconds of the robot for each of a busy computer


@pytest.mark.parametrize("seed", range(20))
def test_truth_comes_out_as_it_went_in(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = {**SHAPES, "acceleration_base": 3, "joint_velocity": 12, "joint_torque": 12}
    state = PlantState(
        time_s=1.0, trunk_contact=False, foot_position_in_world=np.zeros((4, 3)),
        **{name: rng.normal(size=size) for name, size in sizes.items()},
    )  # fmt: skip
    tick, contacts = (int(number) for number in rng.integers(2**32, size=2))
    payload = truth_payload(state, flat.make(), tick=tick, contacts=contacts)
    came = read_truth(payload)
    assert (came.tick, tick_of(payload), came.contacts) == (tick, tick, contacts)
    assert came.terrain == flat.make().fingerprint
    for name, value in came.motion.items():
        np.testing.assert_array_equal(value, getattr(state, name))


class OnCourse:
    """A robot on flat ground, its wire, and our side of it."""

    def __init__(self, *faults: str, seed: int = 0) -> None:
        self.wire = Wire(simulated(*faults, seed=seed))
        self.wire.tick()
        self.robot = UnitreeOnCourse(self.wire, FLAT, self.wire, lockstep=False)  # type: ignore[arg-type]


@pytest.mark.sample(1)
@pytest.mark.parametrize("seed", range(2))
def test_truth_is_that_of_the_state_that_was_read_and_goes_on_where_states_end(seed: int) -> None:
    on = OnCourse("silent@3.6", seed=seed)
    on.robot.reset()
    run = LevelRun(on.robot, ROBOT, GRID, make_planner("scripted", ROBOT, GRID))
    while run.time_s < 5.7:
        run.step()
        truth = on.robot.truth(7, 3)
        assert (truth.time_ns, truth.step) == (7, 3)
        np.testing.assert_array_equal(on.robot.pose()[0], truth.position_base_in_world)
        if on.wire.robot.time_s < 3.6 or on.robot.fault:
            np.testing.assert_array_equal(truth.position_base_in_world, on.wire.robot.position)
        np.testing.assert_allclose(truth.height, -truth.position_base_in_world[2])
        assert on.robot.fault or not on.robot.take_trunk_contact()
        on.wire.tick()
    assert "no new state" in on.robot.fault
    assert on.robot.take_trunk_contact()  # damped, it has sunk to the ground
    on.robot.close()


def test_a_robot_without_truth_or_on_another_terrain_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(on_course, "CONNECT_S", 0.05)
    on = OnCourse()
    on.wire.take(TRUTHS)
    with pytest.raises(StackError, match="no `saltus robot simulate`"):
        on.robot.reset()
    on.wire.tick()
    stairs = replace(FLAT, terrain=setup_of(TerrainConfig(terrain="stairs")).terrain)
    elsewhere = UnitreeOnCourse(on.wire, stairs, on.wire, lockstep=False)  # type: ignore[arg-type]
    on.wire.tick()
    with pytest.raises(StackError, match="another terrain"):
        elsewhere.reset()


def messages_of_a_run(folder: Path, pace: Pace, limit_s: float) -> list[tuple[str, Message]]:
    """Messages of a controller process whose robot is in another process."""
    hub = MemoryHub()
    bus = MemoryBus(PREFIX, hub)
    stream = bus.stream()
    config = RunConfig(
        robot="go2", grid="line", terrain=TerrainConfig(terrain="flat"), time_limit_s=limit_s,
        pace=pace, speed=SPEED if pace == "realtime" else 1.0, link="dds", domain=own_domain(),
    )  # fmt: skip
    context = ProcessContext("controller", config, put_run(folder, config), bus)
    with StandIns(hub).running():
        controller.body(context)
    return [(raw.key, unpack_sample(topic_of(raw.key), raw)[1]) for raw in stream.drain()]


@pytest.mark.slow
def test_a_lockstep_run_rises_and_repeats_to_the_bit(tmp_path: Path) -> None:
    runs = []
    for _ in range(2):
        with simulated_process(own_domain(), "--pace", "lockstep", "--seed", "3", "--drawn"):
            runs.append(messages_of_a_run(tmp_path, "lockstep", 2.1))
    logs, states, truths = (of(runs[0], kind) for kind in (JointLog, RobotState, GroundTruth))
    stiffness = np.concatenate([log.kp for log in logs])[:, 0]
    rise = stiffness[: round(RISE_S / 0.002)]
    assert np.all(np.diff(rise) > 0.0)
    assert 0.2 < rise[0] / rise[-1] < 0.4
    last = {truth.step: truth for truth in truths}
    for state in states:  # of one instant
        np.testing.assert_allclose(state.joint_position, last[state.step].joint_position, atol=1e-5)
    assert truths[-1].position_base_in_world[2] == pytest.approx(ROBOT.stand_height, abs=0.03)
    for ours, theirs in zip(*(of(run, RobotState) for run in runs), strict=True):
        np.testing.assert_array_equal(ours.joint_position, theirs.joint_position)
        np.testing.assert_array_equal(ours.velocity_base_in_world, theirs.velocity_base_in_world)


@pytest.mark.slow
def test_a_run_whose_robot_is_lost_damps_it_says_so_and_ends(tmp_path: Path) -> None:
    with simulated_process(own_domain(), "--speed", str(SPEED), "--fault", "silent@1.0"):
        said = messages_of_a_run(tmp_path, "realtime", 60.0)
    (lost,) = (event for event in of(said, Event) if event.code == "robot_lost")
    assert lost.detail
    last = of(said, JointLog)[-1]
    assert last.time_ns - lost.time_ns > 1_000_000_000
