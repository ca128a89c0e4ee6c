"""What single effects and their chains do."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import CURVE, PROFILE, ROBOT

from saltus.constants import PHYSICS_DT
from saltus.effects.camera import CameraChain
from saltus.effects.chain import ActuatorChain, Torques, proportional_derivative
from saltus.effects.delay_line import CommandDelay, FeedforwardDelay
from saltus.effects.effect import Effect
from saltus.effects.heightmap_shift import HeightmapShift
from saltus.effects.image_delivery import CameraLatency, FrameDrop, SampleAndHold
from saltus.effects.motors import ActuatorLag, TorqueGain, TorqueSaturation, TorqueSpeedLimit
from saltus.effects.profile import IDEAL, Profile, load_profile
from saltus.effects.random_fields import draw_keys, uniform_numbers
from saltus.effects.signals import DepthImage, DriveTorque, HeightQuery
from saltus.errors import ConfigError
from saltus.joint_command import JointCommand

ZERO = np.zeros(12)


def command(torque: float = 0.0, position: float = 0.0) -> JointCommand:
    return JointCommand(
        position=ZERO + position, velocity=ZERO, kp=ZERO + 20.0, kd=ZERO + 0.5, torque=ZERO + torque
    )


def drive(torque: Any, velocity: Any = 0.0) -> DriveTorque:
    return DriveTorque(torque=ZERO + torque, position=ZERO, velocity=ZERO + velocity)


def chain_run(effects: tuple[Effect[Any], ...], commands: list[JointCommand]) -> list[Torques]:
    chain = ActuatorChain(effects).fitted(ROBOT)
    state, results = chain.init((), np.random.default_rng(0)), []
    for k, sent in enumerate(commands):
        torques, state = chain.step(sent, ZERO, ZERO, k * PHYSICS_DT, state)
        results.append(torques)
    return results


@pytest.mark.parametrize("delay_s", np.linspace(0.0, 0.02, 21))
@pytest.mark.parametrize("kind", [CommandDelay, FeedforwardDelay])
def test_a_delay_moves_impulse_by_exactly_that_time(
    kind: type[CommandDelay] | type[FeedforwardDelay], delay_s: float
) -> None:
    """Impulse and centre of time of a pulse after the delay."""
    pulse = [command(torque=1.0 if k == 3 else 0.0) for k in range(20)]
    torque = np.array([t.applied[0] for t in chain_run((kind(delay=float(delay_s)),), pulse)])
    assert torque.sum() == pytest.approx(1.0)
    assert (torque * np.arange(20)).sum() * PHYSICS_DT - 3 * PHYSICS_DT == pytest.approx(
        delay_s, abs=1e-12
    )


def test_only_the_whole_packet_delays_the_feedback() -> None:
    steps = [command(position=0.0 if k < 3 else 0.1) for k in range(12)]
    late = [t.applied[0] for t in chain_run((FeedforwardDelay(delay=0.01),), steps)]
    whole = [t.applied[0] for t in chain_run((CommandDelay(delay=0.01),), steps)]
    assert late == pytest.approx([0.0] * 3 + [2.0] * 9)
    assert whole == pytest.approx([0.0] * 8 + [2.0] * 4)


def test_the_go1s_dynamometer_curve() -> None:
    saturation = TorqueSaturation(curve=CURVE).fitted(ROBOT)
    for asked, given in CURVE:
        scale = ROBOT.reduction / 9.495
        np.testing.assert_allclose(saturation.delivered(asked * scale), given * scale, rtol=1e-12)
        np.testing.assert_allclose(saturation.delivered(-asked * scale), -given * scale, rtol=1e-12)
    np.testing.assert_allclose(
        saturation.delivered(ROBOT.torque_limit)[:3], [17.24, 17.24, 25.86], atol=5e-3
    )


@pytest.mark.parametrize(("knee", "plateau"), [(14.2, 17.2), (10.0, 12.0), (20.0, 20.5)])
def test_knee_and_plateau_mean_what_they_say(knee: float, plateau: float) -> None:
    saturation = TorqueSaturation(knee=knee, plateau=(plateau, plateau, 1.5 * plateau) * 4).fitted(
        ROBOT
    )
    np.testing.assert_allclose(saturation.delivered(np.full(12, knee)), 0.95 * knee)
    np.testing.assert_allclose(
        saturation.delivered(ROBOT.torque_limit), np.tile([plateau, plateau, 1.5 * plateau], 4)
    )


@pytest.mark.parametrize(
    "parameters",
    [
        {"knee": 10.0},
        {"knee": 10.0, "plateau": 30.0},
        {"knee": 10.0, "plateau": 5.0},
        {"knee": 10.0, "plateau": 15.0, "curve": CURVE},
        {"curve": ((5.0, 5.0), (4.0, 6.0))},
        {"curve": ((5.0, 5.0), (6.0,))},
        {"curve": ((5.0, 50.0),)},
    ],
)
def test_a_saturation_that_cannot_be_is_an_error(parameters: Any) -> None:
    with pytest.raises(ConfigError, match="torque_saturation"):
        TorqueSaturation(**parameters).fitted(ROBOT)


def test_torque_speed_limit_only_along_the_motion() -> None:
    limit = TorqueSpeedLimit(corner=10.0, no_load=30.0).fitted(ROBOT)
    for velocity, share in ((0.0, 1.0), (10.0, 1.0), (20.0, 0.5), (30.0, 0.0), (35.0, 0.0)):
        for sign in (1.0, -1.0):
            along, _ = limit.apply(drive(sign * 100.0, sign * velocity), 0.0, None)
            against, _ = limit.apply(drive(-sign * 100.0, sign * velocity), 0.0, None)
            np.testing.assert_allclose(along.torque, sign * share * ROBOT.torque_limit, atol=1e-12)
            np.testing.assert_allclose(against.torque, -sign * ROBOT.torque_limit)


def test_one_joint_may_have_no_limit() -> None:
    limit = TorqueSpeedLimit(corner=0.0, no_load=(30.0,) * 11 + (float("inf"),)).fitted(ROBOT)
    out, _ = limit.apply(drive(1e4, 15.0), 0.0, None)
    np.testing.assert_allclose(out.torque, [*(0.5 * ROBOT.torque_limit[:11]), 1e4])


def test_lag_answers_a_step_exponentially() -> None:
    lag, state, torque = ActuatorLag(time_constant=0.005), None, []
    for k in range(10):
        out, state = lag.apply(drive(0.0 if k == 0 else 1.0), 0.0, state)
        torque.append(out.torque[0])
    instants = np.arange(10) * PHYSICS_DT
    # The integral of 1 - exp(-t / 0.005), but for a constant
    answer = instants + 0.005 * np.exp(-instants / 0.005)
    np.testing.assert_allclose(torque, [0.0, *np.diff(answer) / PHYSICS_DT], atol=1e-12)


def test_the_chain_has_one_order() -> None:
    effects = (
        TorqueGain(gain=0.5),
        TorqueSaturation(curve=CURVE),
        TorqueSpeedLimit(corner=0.0, no_load=30.0),
        ActuatorLag(time_constant=0.003),
        FeedforwardDelay(delay=0.01),
        CommandDelay(delay=0.004),
    )
    commands = [command(torque=5.0 * k, position=0.1 * k) for k in range(8)]
    forwards, backwards = chain_run(effects, commands), chain_run(effects[::-1], commands)
    for one, other in zip(forwards, backwards, strict=True):
        np.testing.assert_array_equal(one.applied, other.applied)
    assert [e.name for e in ActuatorChain(effects).effects][:3] == [
        "command_delay",
        "feedforward_delay",
        "actuator_lag",
    ]


def test_believed_torque_knows_delays_and_no_limits() -> None:
    effects = (CommandDelay(delay=0.002), TorqueSaturation(curve=CURVE), TorqueGain(gain=0.8))
    torques = chain_run(effects, [command(torque=0.0), command(torque=30.0), command(torque=30.0)])
    np.testing.assert_array_equal([t.believed[2] for t in torques], [0.0, 0.0, 30.0])
    np.testing.assert_allclose(torques[2].applied[2], 0.8 * 24.01)


def test_no_effects_are_the_law_of_the_drive() -> None:
    sent = command(torque=3.0, position=0.2)
    torques = chain_run(IDEAL.actuator, [sent])[0]
    np.testing.assert_array_equal(torques.applied, proportional_derivative(sent, ZERO, ZERO))
    np.testing.assert_array_equal(torques.applied, torques.believed)


@pytest.mark.parametrize(
    ("chain", "effects"),
    [
        (ActuatorChain, (TorqueGain(gain=0.9), TorqueGain(gain=0.8))),
        (ActuatorChain, (CameraLatency(latency=0.05),)),
        (CameraChain, (TorqueGain(gain=0.9),)),
        (CameraChain, (FrameDrop(fraction=0.1), FrameDrop(fraction=0.1))),
    ],
)
def test_a_chain_refuses_what_does_not_belong(chain: Any, effects: Any) -> None:
    with pytest.raises(ConfigError):
        chain(effects)


def image(k: int) -> DepthImage:
    return DepthImage(depth=np.full((2, 2), 1.0 + k), time_s=np.asarray(0.01 * k))


def test_before_the_first_image_there_is_none() -> None:
    chain = CameraChain((CameraLatency(latency=0.03),))
    state = chain.init((), np.random.default_rng(0))
    for k in range(3):
        seen, state = chain.step(image(k), 0.01 * k, state)
        assert seen.time_s == -np.inf
        assert not seen.depth.any()
    seen, state = chain.step(image(3), 0.03, state)
    assert (float(seen.time_s), float(seen.depth[0, 0])) == (0.0, 1.0)


def test_looking_often_or_seldom_shows_the_same_images() -> None:
    """A latency does not depend on how often somebody looks."""
    effect = CameraLatency(latency=0.042, jitter=0.004)
    seen = []
    for looks in (1, 10):
        state: Any = effect.init((), np.random.default_rng(4))
        times = []
        for k in range(30):
            for look in range(looks):
                out, state = effect.apply(image(k), 0.01 * k + 0.01 * look / looks, state)
                if look == 0:
                    times.append(float(out.time_s))
        seen.append(times)
    assert seen[0] == seen[1]


@pytest.mark.parametrize("period_s", [0.01, 0.02, 0.05])
def test_sample_and_hold_keeps_its_period(period_s: float) -> None:
    effect, state, times = SampleAndHold(period=period_s), None, []
    for k in range(51):
        out, state = effect.apply(image(k), 0.01 * k, state)
        times.append(float(out.time_s))
    np.testing.assert_allclose(np.unique(times), np.arange(0.0, 0.501, period_s), atol=1e-12)


def test_drops_are_as_many_as_said() -> None:
    effect = FrameDrop(fraction=0.2)
    state: Any = effect.init((100,), np.random.default_rng(0))
    kept = 0.0
    for k in range(200):
        captured = np.full(100, 0.02 * k)
        out, state = effect.apply(
            DepthImage(depth=np.ones((100, 1, 1)), time_s=captured), 0.0, state
        )
        kept += np.mean(out.time_s == captured)
    assert kept / 200 == pytest.approx(0.8, abs=0.01)  # 3.5 standard deviations of 20,000 draws


def test_draws_are_uniform_and_independent() -> None:
    keys = draw_keys((200,), np.random.default_rng(0))
    draws = np.stack([uniform_numbers(keys, np.full(200, 0.02 * k)) for k in range(200)])
    counts = np.histogram(draws, bins=20, range=(0.0, 1.0))[0]
    assert (counts.sum(), draws.min() >= 0.0, draws.max() < 1.0) == (40_000, True, True)
    # chi-squared, 19 degrees of freedom, one in a thousand
    assert np.sum((counts - 2000.0) ** 2 / 2000.0) < 43.8
    assert abs(np.corrcoef(draws[:-1].ravel(), draws[1:].ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(draws[:, :-1].ravel(), draws[:, 1:].ravel())[0, 1]) < 0.02


def test_height_shift_reads_elsewhere_and_keeps_to_its_range() -> None:
    drawn = HeightmapShift(x_range=0.08, z_range=0.05)
    state = drawn.init((1000,), np.random.default_rng(0))
    query = HeightQuery(x=np.zeros((1000, 30)), offset=np.zeros((1000, 1)))
    out, after = drawn.apply(query, 0.0, state)
    assert after is state
    assert 0.075 < np.abs(out.x).max() <= 0.08
    assert 0.045 < np.abs(out.offset).max() <= 0.05
    assert np.ptp(out.x, axis=-1).max() == 0.0
    fixed = HeightmapShift(x=0.03, z=-0.01)
    out, _ = fixed.apply(query, 0.0, fixed.init((1000,), np.random.default_rng(0)))
    assert (np.all(out.x == 0.03), np.all(out.offset == -0.01)) == (True, True)


def test_profiles_by_name_and_by_file(tmp_path: Path) -> None:
    assert load_profile("go1", ROBOT) == PROFILE
    assert load_profile("ideal", ROBOT) == IDEAL == Profile()
    path = tmp_path / "mine.toml"
    path.write_text(PROFILE.to_toml())
    assert load_profile(str(path), ROBOT) == PROFILE
    assert [e.name for e in PROFILE.actuator_chain.effects] == [
        "feedforward_delay",
        "torque_speed_limit",
        "torque_saturation",
    ]
    assert [e.name for e in PROFILE.camera_chain.effects] == ["camera_latency"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[actuator.torque_gian]\ngain = 1.1", "torque_gain"),
        ("[actuator.torque_gain]\ngian = 1.1", "gain"),
        ("[actuator.torque_gain]\ngain = 7", "0 to 2"),
        ("[actuator.torque_gain]\ngain = true", "must be a number"),
        ("[actuator.torque_gain]\ngain = [1, 1]", "one value, or 12"),
        ("[actuator]\ntorque_gain = 1", "must be a table"),
        ("[camera.camera_latency]\nlatency = [0.1, 0.1]", "one value"),
        ("[camera.camera_latency]\ndt_s = 0", "dt_s"),
        ("[camera.torque_gain]\ngain = 1.1", "camera_latency"),
        ("[actuators.torque_gain]\ngain = 1.1", "actuator"),
        ("actuator = 3", "must be a table"),
        ("[", "TOML"),
    ],
)
def test_profile_errors_say_what_is_wrong(text: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        Profile.from_toml(text)


def test_a_profile_that_is_nowhere(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="'go1'"):
        load_profile("g1", ROBOT)
    with pytest.raises(ConfigError, match="cannot read"):
        load_profile(str(tmp_path / "none.toml"), ROBOT)


def test_a_profile_describes_one_robot() -> None:
    with pytest.raises(ConfigError, match="robot to robot"):
        Profile(actuator=(TorqueGain(gain=np.ones((3, 1))),)).to_toml()
