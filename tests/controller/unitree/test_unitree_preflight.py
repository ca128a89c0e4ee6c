"""Preflights find what is wrong with a robot, name it, and pass healthy ones."""

import json

import pytest
from unitree_processes import saltus
from unitree_processes import simulated as simulated_process

from benchmarks.unitree_link.command import own_domain
from benchmarks.unitree_link.in_memory import Wire, checks, simulated
from saltus.controller.robot.unitree.faults import KINDS
from saltus.controller.robot.unitree.messages import LOW_COMMAND, MOTORS
from saltus.robots.robot import JOINTS

PATIENCE_S = 100.0
FOUND_BY = {
    "lost": {"gaps"}, "silent": {"rate"}, "late": {"answers"}, "slow": {"rate", "gaps"},
    "frozen": {"rate", "clock"}, "stuck": {"clock"}, "crc": {"checksums"}, "tick": {"clock"},
    "hot": {"temperatures"}, "battery": {"battery"}, "imu": {"level"}, "dead": {"motors"},
    "sign": {"gravity", "follows", "ranges"}, "foreign": {"alone"},
    "button": {"clock"}, "kept": {"service", "alone"},
}  # fmt: skip
"""Checks of a hanging robot of which one at least refuses it, by the fault."""


def checked(wire: Wire, *, stands: bool = False) -> dict[str, bool]:
    return {check.name: check.passed for check in checks(wire, stands=stands)}


def refused(*faults: str, seed: int = 0, stands: bool = False) -> set[str]:
    wire = Wire(simulated(*faults, seed=seed, held=not stands))
    if "foreign" in faults:
        wire.strangers = ("sport",)
    return {name for name, passed in checked(wire, stands=stands).items() if not passed}


@pytest.mark.sample(2)
@pytest.mark.parametrize("kind", FOUND_BY)
def test_each_fault_of_a_hanging_robot_is_found_and_named(kind: str) -> None:
    found = refused(kind)
    assert found & FOUND_BY[kind]
    assert found <= FOUND_BY[kind] | ({"rate", "gaps", "follows"} if kind != "hot" else set())


def test_a_robot_that_moves_itself_is_released_where_it_hangs_and_only_told_where_it_stands() -> (
    None
):
    assert refused("mode") == set()
    wire = Wire(simulated("mode"))
    assert all(checked(wire, stands=True).values())
    assert wire.robot.mode
    wire.strangers = ("another",)
    assert not checked(wire, stands=True)["alone"]


def test_every_kind_of_fault_is_looked_for() -> None:
    assert {*FOUND_BY, "offset", "mode"} == {*KINDS}


@pytest.mark.sample(1)
@pytest.mark.parametrize("joint", JOINTS[3:])
def test_a_flipped_joint_is_found_wherever_it_is(joint: str) -> None:
    assert refused(f"sign:{joint}", seed=1) & FOUND_BY["sign"]


@pytest.mark.sample(2)
@pytest.mark.parametrize("joint", JOINTS)
def test_a_zero_that_is_off_is_found_of_a_standing_robot(joint: str) -> None:
    assert refused(f"offset:{joint}", stands=True) & {"legs", "ranges"}


def test_a_turned_imu_is_found_of_a_standing_robot() -> None:
    assert refused("imu", stands=True) == {"legs"}


@pytest.mark.sample(2)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("stands", [False, True], ids=["hangs", "stands"])
def test_healthy_robots_pass_all_checks(seed: int, stands: bool) -> None:
    wire = Wire(simulated(seed=seed, held=not stands))
    found = checked(wire, stands=stands)
    assert all(found.values())
    assert len(found) == (11 if stands else 16)
    if stands:
        assert not wire.sent
    else:  # it is left damped
        motors = LOW_COMMAND.read([wire.sent[-1]])[0]["motor_cmd"][:MOTORS]
        assert not motors["kp"].any()
        assert motors["kd"].all()


def test_states_from_before_are_not_counted() -> None:
    wire = Wire(simulated(held=False))
    for _ in range(300):
        wire.tick()
    assert all(checked(wire, stands=True).values())


@pytest.mark.sample(2)
@pytest.mark.parametrize("kind", ["crc", "battery", "foreign", "imu"])
def test_a_robot_that_is_refused_at_rest_is_told_nothing(kind: str) -> None:
    wire = Wire(simulated(kind, held=True), ["sport"] if kind == "foreign" else [])
    assert not all(checked(wire).values())
    assert not wire.sent


@pytest.mark.slow
def test_the_command_judges_a_robot_in_another_process() -> None:
    """Its figures depend on how busy this computer is; its form and the refusal do not."""
    where = ("--domain", str(own_domain()), "--speed", "0.5")
    with (
        simulated_process(own_domain(), "--held", "--speed", "0.5", "--fault", "crc"),
        saltus("robot", "preflight", *where, "--json") as process,
    ):
        out, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    told = json.loads(out.splitlines()[-1])
    assert told["passed"] is False
    by_name = {check["name"]: check for check in told["checks"]}
    assert int(by_name["checksums"]["found"].removesuffix(" wrong")) > 0
    assert "REFUSED checksums" in out
