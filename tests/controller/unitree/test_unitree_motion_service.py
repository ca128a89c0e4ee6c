"""A robot is taken from its own motion service before it is commanded, or not commanded at all."""

import os
import subprocess
import time
from pathlib import Path

import pytest
from unitree_processes import saltus
from unitree_processes import simulated as simulated_process

from benchmarks.unitree_link.command import LOOPBACK, compiled, own_domain
from benchmarks.unitree_link.in_memory import ROBOT, Wire, simulated
from saltus.controller.robot.unitree import motion_service
from saltus.controller.robot.unitree.link import ANSWERS, COMMANDS, REQUESTS, STATES, UnitreeLink
from saltus.controller.robot.unitree.motion_service import MotionService, request
from saltus.controller.robot.unitree.simulated import MODE, holding_message
from saltus.errors import StackError

PATIENCE_S = 100.0


class Mute(Wire):
    """Answers that get lost, or are others'."""

    def __init__(self, *faults: str, lost: int, strange: bytes = b"") -> None:
        super().__init__(simulated(*faults))
        self.lost, self.strange = lost, strange

    def send(self, topic: str, payload: bytes) -> None:
        if topic == REQUESTS and self.lost:
            self.lost -= 1
            payload = self.strange or request(1001, 5)
        super().send(topic, payload)


def service(*faults: str) -> MotionService:
    return MotionService(Wire(simulated(*faults)))  # type: ignore[arg-type]


def test_a_mode_is_told_released_once_a_person_agrees_and_ended() -> None:
    assert service().mode() == ""
    assert service().release() == ""
    asked: list[str] = []
    own = service("mode")
    assert own.mode() == MODE
    assert own.release(asked.append) == MODE
    assert asked == [MODE]
    assert own.mode() == ""


def test_nothing_is_released_unless_a_person_agrees() -> None:
    def refuses(_mode: str) -> None:
        raise KeyboardInterrupt

    own = service("mode")
    with pytest.raises(KeyboardInterrupt):
        own.release(refuses)
    assert own.mode() == MODE


def test_a_mode_that_is_not_released_is_refused_in_one_line() -> None:
    own = service("kept")
    with pytest.raises(StackError, match=rf"'{MODE}' and was not released \(code 7008\)") as told:
        own.release()
    assert "\n" not in str(told.value)
    assert own.mode() == MODE


@pytest.mark.parametrize("lost", range(4))
def test_answers_that_are_lost_or_others_are_asked_for_again(
    lost: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(motion_service, "ANSWER_S", 0.02)
    for strange in (b"", b"\0\1\0\0", b"?" * 40, request(1001, 5)[:-3]):
        own = MotionService(Mute("mode", lost=lost, strange=strange))  # type: ignore[arg-type]
        if lost < motion_service.TRIES:
            assert own.mode() == MODE
        else:
            with pytest.raises(StackError, match="has not answered"):
                own.mode()


def test_a_robot_without_the_service_has_no_mode() -> None:
    """As unitree_mujoco: who answers nothing is not asked."""
    wire = Wire(simulated())
    wire.others = lambda _topic: ()  # type: ignore[method-assign]
    wire.send = lambda *_: pytest.fail("a request was sent")  # type: ignore[method-assign]
    assert MotionService(wire).mode() == ""  # type: ignore[arg-type]


def test_a_service_on_cyclone_0_10_is_released_and_survives(tmp_path: Path) -> None:
    peer = [str(compiled(tmp_path, "service")), str(own_domain())]
    with subprocess.Popen(peer, env=os.environ | {"CYCLONEDDS_URI": LOOPBACK}) as other:
        link = UnitreeLink(own_domain(), "lo", sends=[REQUESTS], takes=[ANSWERS])
        until_s = time.monotonic() + PATIENCE_S
        while not link.others(ANSWERS) and time.monotonic() < until_s:
            time.sleep(0.01)
        assert MotionService(link).release() == MODE
        assert other.wait(timeout=PATIENCE_S) == 0
    link.close()


@pytest.mark.slow
def test_a_robot_in_another_process_is_released_and_no_command_comes_before() -> None:
    where = ("--domain", str(own_domain()))
    lockstep = (*where, "--pace", "lockstep")
    motion = ("robot", "run", "--stage", "stand", "--seconds", "0.1", *lockstep)
    with simulated_process(own_domain(), "--pace", "lockstep", "--fault", "mode") as robot:
        with saltus(*motion, "--begin") as run:
            out, _ = run.communicate(timeout=PATIENCE_S)
        assert run.returncode == 0, out
        assert f"in mode '{MODE}'" in out
        assert "STAND after" in out
        link = UnitreeLink(own_domain(), "lo", sends=[REQUESTS], takes=[STATES, ANSWERS])
        assert MotionService(link).mode() == ""
        assert not link.others(COMMANDS)
        link.close()
    assert robot.returncode is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", ["robot run --pace lockstep", "up --link dds", "up --link dds --pace lockstep"]
)
def test_a_robot_that_is_not_simulated_is_not_released_for_what_needs_a_simulated_one(
    command: str, tmp_path: Path
) -> None:
    """It says states and answers, as a real one does, and no truth about itself."""
    real = UnitreeLink(own_domain(), "lo", sends=[STATES, ANSWERS], takes=[REQUESTS, COMMANDS])
    where = ("--domain", str(own_domain()), "--interface", "lo", "--begin", "--robot", "go2")
    out = ("--out", str(tmp_path / "run")) if command.startswith("up") else ()
    with saltus(*command.split(), *where, *out, stderr=subprocess.STDOUT) as run:
        told, _ = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 2, told
    assert (
        told.strip().splitlines()[-1].startswith("saltus: the robot is no `saltus robot simulate`")
    )
    assert not real.take(REQUESTS)
    assert not real.take(COMMANDS)
    real.close()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["run", "preflight"])
def test_a_robot_in_another_process_that_is_not_released_is_told_nothing(command: str) -> None:
    where = ("--domain", str(own_domain()), "--speed", "0.5")
    with (
        simulated_process(own_domain(), "--held", "--speed", "0.5", "--fault", "kept"),
        saltus("robot", command, *where, stdin=subprocess.PIPE, stderr=subprocess.STDOUT) as asks,
    ):
        listener = UnitreeLink(own_domain(), "lo", takes=[COMMANDS])
        out, _ = asks.communicate("\n", timeout=PATIENCE_S)
        heard = {arrived.payload for arrived in listener.take(COMMANDS)}
        listener.close()
    assert asks.returncode == (2 if command == "run" else 1)
    assert f"'{MODE}' and was not released" in out
    assert heard <= {holding_message(ROBOT)}  # of its own service alone
    if command == "preflight":
        assert "REFUSED service" in out
