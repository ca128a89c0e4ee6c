"""Scripts, goals and the operator's process: what is wished at every moment."""

import io
import math
import os
import termios
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from samples import ROBOT
from stage import Stage

from saltus.cli.main import main
from saltus.config import RunConfig
from saltus.drive import gamepad
from saltus.drive.__main__ import AFTER_S, WishSource, body, by_goals, by_script
from saltus.drive.gamepad import GamepadWish
from saltus.drive.goals import REACHED_M, Goals
from saltus.drive.keyboard import MODES, MOST, STEP, VELOCITIES, pressed, unbuffered_keys
from saltus.drive.script import WishScript
from saltus.drive.wish import STAND, Wish
from saltus.errors import ConfigError
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.states import standing_state
from saltus.wire.messages import CommandMode, RobotState

HEAD = "time_s,mode,ahead_mps,left_mps,turn_rps,x_m,y_m\n"
STEP_NS = 10_000_000


def script(folder: Path, rows: str, head: str = HEAD) -> Path:
    path = folder / "script.csv"
    path.write_text(head + rows, encoding="utf-8")
    return path


def state(step: int, place=(0.0, 0.0), yaw: float = 0.0, velocity=(0.0, 0.0)) -> RobotState:
    """Odometry tells the place, or there is none and velocities are told."""
    zero = np.zeros(())
    return replace(
        standing_state(ROBOT),
        step=step,
        time_ns=step * STEP_NS,
        quaternion_base_in_world=quaternion_from_roll_pitch_yaw(zero, zero, np.asarray(yaw)),
        velocity_base_in_world=np.array([*velocity, 0.0]),
        position_base_in_odometry=np.zeros(0) if place is None else np.array([*place, 0.3]),
    )


def test_each_row_of_a_script_holds_until_the_next(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        times = np.cumsum(rng.uniform(0.1, 2.0, 5)).tolist()
        speeds = rng.uniform(-1.0, 1.0, (4, 3))
        rows = [
            f"{time!r},walk,{','.join(map(repr, row.tolist()))}\n"
            for time, row in zip(times, speeds, strict=False)
        ]
        wishes = WishScript(script(tmp_path, "".join([*rows, f"{times[4]!r},lie_down\n"])))
        assert wishes.wish(times[0] - 1e-9, state(0)) == STAND
        for k, row in enumerate(speeds):
            for time in (times[k], 0.5 * (times[k] + times[k + 1])):
                wish = wishes.wish(time, state(1))
                assert wish.mode == CommandMode.WALK
                assert [wish.ahead_mps, wish.left_mps, wish.turn_rps] == row.tolist()
        assert wishes.wish(1e6, state(2)).mode == CommandMode.LIE_DOWN


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("1,run\n", "line 2: no mode 'run'"),
        ("1,walk,fast\n2,stand\n", "line 2: ahead_mps = fast"),
        ("1,walk,11\n2,stand\n", "line 2: ahead_mps = 11: .* at most 10"),
        ("1,walk,nan\n2,stand\n", "ahead_mps = nan"),
        ("2,walk\n2,stand\n", "line 3: time_s = 2: times must ascend"),
        ("1,stand\n2,walk,1\n", "the last row must ask to stand"),
        ("1,stand\n2,walk,1,0,0,3,0\n", "the last row must ask to stand"),
        ("1,walk,0,0,0,3\n2,stand\n", "line 2: a row with x_m or y_m walks there: .* ahead_mps"),
        ("1,walk,1,0.1,0,,2\n2,stand\n", "line 2: a row with x_m .* no left_mps"),
        ("1,jump,1,0,0,3,0\n2,stand\n", "line 2: a row with x_m .* give mode walk"),
        ("1,walk,1,0,0,3,far\n2,stand\n", "line 2: y_m = far"),
        ("", "the last row must ask to stand"),
    ],
)
def test_a_script_that_is_wrong_is_refused_with_its_line(
    tmp_path: Path, rows: str, said: str
) -> None:
    path = script(tmp_path, rows)
    with pytest.raises(ConfigError, match=f"script.csv: .*{said}"):
        WishScript(path)


def test_columns_that_are_unknown_or_missing_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no column 'speed'"):
        WishScript(script(tmp_path, "", "time_s,mode,speed\n"))
    with pytest.raises(ConfigError, match="must name the columns"):
        WishScript(script(tmp_path, "1,walk\n", "time_s,ahead_mps\n"))


def test_a_script_begins_with_the_first_state_and_ends_after_its_last_row(tmp_path: Path) -> None:
    drive = by_script(script(tmp_path, "0.1,walk,0.5\n0.2,stand\n"))
    first, ends = 400, 400 + round(100 * (0.2 + AFTER_S))
    modes = {step: drive(state(step)) for step in range(first, ends + 2)}
    wished = {step: wish.mode for step, wish in modes.items() if wish is not None}
    assert [wished[first + k] for k in (0, 9, 10, 19, 20)] == [
        CommandMode.STAND, CommandMode.STAND, CommandMode.WALK, CommandMode.WALK, CommandMode.STAND,
    ]  # fmt: skip
    assert abs(max(wished) - ends) <= 1


def walked(drive: WishSource, start: int, goals: list[list[float]], most: int, odometry: bool):
    """A point that turns and moves as it is told, 100 times a second: its places, and the goals in
    their frame, of a drawn start."""
    rng = np.random.default_rng([start, 1])
    place, yaw = rng.uniform(-10.0, 10.0, 2), float(rng.uniform(-3.0, 3.0))
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    wanted = [place + turn @ np.array(goal) for goal in goals]
    visited, velocity = [], np.zeros(2)
    for step in range(most):
        wish = drive(state(step, tuple(place) if odometry else None, yaw, tuple(velocity)))
        if wish is None:
            return np.array(visited), wanted
        visited.append(np.array(place))
        assert abs(wish.turn_rps) <= 0.8
        assert 0.0 <= wish.ahead_mps <= 0.6
        ahead = np.array([math.cos(yaw), math.sin(yaw)])
        velocity = wish.ahead_mps * ahead
        place, yaw = place + 0.01 * velocity, yaw + 0.01 * wish.turn_rps
    raise AssertionError("it goes on and on")


@pytest.mark.sample(6)
@pytest.mark.parametrize("has_odometry", [True, False])
@pytest.mark.parametrize("start", range(4))
@pytest.mark.parametrize("by", ["goals", "script"])
def test_a_robot_that_obeys_reaches_all_goals_from_any_place_and_heading(
    tmp_path: Path, by: str, start: int, has_odometry: bool
) -> None:
    goals = np.random.default_rng(start).uniform(-1.5, 1.5, (4, 2)).tolist()
    if by == "goals":
        drive = by_goals(Goals([(x, y) for x, y in goals], 0.6, 0.8))
    else:  # 13 s for each way: up to 4.3 m, of which it turns on the spot at first
        rows = [f"{13 * i + 0.1!r},walk,0.6,0,0.8,{x!r},{y!r}\n" for i, (x, y) in enumerate(goals)]
        drive = by_script(script(tmp_path, "".join([*rows, "52.1,stand\n"])))
    left, wanted = walked(drive, start, goals, 20_000, has_odometry)
    for goal in wanted:  # in their order
        reached = np.linalg.norm(left - goal, axis=1) < REACHED_M + 0.02
        assert reached.any()
        left = left[int(np.argmax(reached)) :]


def test_a_goal_of_a_script_is_walked_to_and_stood_at_until_the_next_row(tmp_path: Path) -> None:
    goal = script(tmp_path, "0.1,walk,0.6,0,0,1,0.5\n30,jump\n31,stand\n")
    way, (wanted,) = walked(by_script(goal), 5, [[1.0, 0.5]], 4_000, odometry=True)
    stood = way[2_000:2_990]
    assert np.ptp(stood, axis=0).max() == 0.0
    assert np.linalg.norm(stood[0] - wanted) < REACHED_M


def test_each_key_changes_its_velocity_alone_and_others_the_mode() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        wish = STAND
        for key in rng.choice(list("wsadqejl x\n"), 30):
            after = pressed(wish, str(key))
            if key in MODES:
                assert after == Wish(mode=MODES[str(key)])
            elif key in VELOCITIES:
                name, step = VELOCITIES[str(key)]
                turns = wish.mode == CommandMode.JUMP and name == "turn_rps"
                before = wish if turns or wish.mode == CommandMode.WALK else STAND
                expected = min(max(getattr(before, name) + step, -MOST), MOST)
                assert getattr(after, name) == pytest.approx(expected)
                assert replace(after, **{name: getattr(before, name)}, mode=before.mode) == before
                assert after.mode == (CommandMode.JUMP if turns else CommandMode.WALK)
            else:
                assert after == wish
            wish = after


def test_keys_count_as_they_are_pressed_and_the_terminal_is_left_as_it_was() -> None:
    hand, terminal = os.openpty()
    before = termios.tcgetattr(terminal)
    with unbuffered_keys(terminal) as keys:
        assert keys.wish() == STAND
        os.write(hand, b"ww")
        assert keys.wish().ahead_mps == pytest.approx(2 * STEP)
        os.write(hand, "aé".encode())
        assert keys.wish().turn_rps == pytest.approx(STEP)
        os.write(hand, b" ")
        assert keys.wish() == STAND
    assert termios.tcgetattr(terminal) == before
    os.close(hand)
    os.close(terminal)


def test_the_process_answers_each_state_with_the_script_of_the_run(tmp_path: Path) -> None:
    path = script(tmp_path, "0.05,jump\n0.1,lie_down\n")
    config = RunConfig(robot="go1", grid="line", commands=str(path))
    with Stage("operator", body, config, tmp_path) as stage:
        states = stage.others.publisher("controller/state")
        commands = stage.others.latest("operator/command")
        said = []
        for step in range(20):
            states.put(state(step))
            sample = commands.wait(5.0)
            assert sample is not None
            assert (sample.message.step, sample.message.time_ns) == (step, step * STEP_NS)
            said.append(sample.message.mode)
    modes = [CommandMode.STAND, CommandMode.JUMP, CommandMode.LIE_DOWN]
    assert said == [modes[0]] * 5 + [modes[1]] * 5 + [modes[2]] * 10


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "give one of --script FILE.csv, --goals X,Y"),
        (["--goals", "1,2", "--script", "a.csv"], "give one of"),
        (["--goals", "1,2", "--keys"], "give one of"),
        (["--keys"], "--keys needs a terminal"),
        (["--gamepad", "missing"], "no gamepad at missing: No such file"),
        (["--goals", "1;2"], "--goals 1;2: a goal is X,Y"),
        (["--goals", "1,nan"], "--goals 1,nan"),
        (["--script", "no.csv"], "cannot read no.csv"),
        (["--goals", "1,2"], "is no folder of a run"),
    ],
)
def test_the_command_refuses_in_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    said: str,
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main(["drive", "--run-dir", str(tmp_path / "none"), *arguments]) == 2
    assert said in capsys.readouterr().err


@pytest.fixture
def pad() -> Iterator[tuple[GamepadWish, Callable[..., None], int]]:
    """A gamepad, what sends it an event in parts, and the end that sends."""
    device, sender = os.pipe()
    os.set_blocking(device, False)
    rng = np.random.default_rng(0)

    def send(kind: int, number: int, value: int) -> None:
        event, cut = gamepad.EVENT.pack(0, value, kind, number), int(rng.integers(1, 8))
        os.write(sender, event[:cut])
        driven.wish()
        os.write(sender, event[cut:])

    driven = GamepadWish(device)
    yield driven, send, sender
    os.close(device)


def test_sticks_of_a_gamepad_walk_within_what_policies_know_and_buttons_change_the_mode(pad):
    driven, send, _ = pad
    assert driven.wish() == STAND
    rng, most = np.random.default_rng(1), {name: abs(v) for name, v in gamepad.STICKS.values()}
    for _ in range(100):
        axis, value = int(rng.choice(list(gamepad.STICKS))), int(rng.integers(-32768, 32768))
        send(gamepad.AXIS, axis, value)
        wish, (name, _) = driven.wish(), gamepad.STICKS[axis]
        if abs(value) > gamepad.DEAD * gamepad.FULL + 1:
            assert wish.mode == CommandMode.WALK
            assert getattr(wish, name) * value < 0.0  # ahead and left are negative on the pad
            assert abs(getattr(wish, name)) <= most[name]
        elif wish.mode == CommandMode.WALK:
            assert getattr(wish, name) == pytest.approx(0.0, abs=1e-4)
    for number, mode in gamepad.MODES.items():
        send(gamepad.BUTTON, number, 1)
        send(gamepad.BUTTON, number, 0)
        send(gamepad.AXIS, 1, 100)  # a stick at rest
        assert driven.wish() == Wish(mode=mode)


@pytest.mark.parametrize("value", [-32767, -9000, 30000])
def test_the_stick_that_turns_steers_a_jump_and_the_others_end_it(pad, value):
    driven, send, _ = pad
    for axis, (name, _) in gamepad.STICKS.items():
        send(gamepad.BUTTON, 1, 1)
        send(gamepad.AXIS, axis, value)
        turns = name == "turn_rps"
        assert driven.wish().mode == (CommandMode.JUMP if turns else CommandMode.WALK)
        assert getattr(driven.wish(), name) * value < 0.0
        send(gamepad.AXIS, axis, 0)
        assert getattr(driven.wish(), name) == 0.0


def test_a_gamepad_starts_from_a_stand_and_ends_where_it_is_gone(pad):
    driven, send, sender = pad
    send(gamepad.AXIS | gamepad.INITIAL, 1, -32767)
    send(gamepad.BUTTON | gamepad.INITIAL, 1, 1)
    assert driven.wish() == STAND
    os.close(sender)
    assert driven.wish() is None
