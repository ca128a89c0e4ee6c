import dataclasses
from typing import Any

import numpy as np
import pytest
from samples import PROFILE

from saltus.config import TerrainConfig
from saltus.effects.delay_line import FeedforwardDelay
from saltus.effects.heightmap_shift import HeightmapShift
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.motors import TorqueGain
from saltus.effects.profile import IDEAL, Profile
from saltus.errors import ConfigError
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.curriculum import FAMILIES, make_terrain
from saltus.trial import Outcome, Trial, TrialMonitor, judge

RANGES = {
    "position_x": (-0.2, 0.2),
    "yaw": (-0.05, 0.05),
    "friction": (0.5, 1.0),
    "payload_kg": (0.0, 1.5),
    "motor_strength": (0.9, 1.1),
    "camera_delay_s": (0.030, 0.060),
    "height_shift_x": (-0.08, 0.08),
    "height_shift_z": (-0.05, 0.05),
}
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def quaternion(roll: float = 0.0, pitch: float = 0.0) -> np.ndarray:
    return quaternion_from_roll_pitch_yaw(*(np.asarray(np.deg2rad(a)) for a in (roll, pitch, 30.0)))


def walk(kind: str, speed: float, **how: float) -> Outcome:
    """A trunk at constant speed; from `fault_x` on it is turned, or touches the ground."""
    terrain = make_terrain(TerrainConfig(terrain=kind))
    time_s = np.arange(0.0, 30.0, 0.01)
    x = how.get("start_x", 0.0) + speed * time_s
    faulty = x >= how.get("fault_x", np.inf)
    turned = quaternion(how.get("roll", 0.0), how.get("pitch", 0.0))
    position = np.stack([x, 0.1 * x, 0.3 + 0 * x], axis=-1)
    touch = faulty & bool(how.get("touch", 0.0))
    return judge(terrain, time_s, position, np.where(faulty[:, None], turned, LEVEL), touch)


def test_draws_fill_their_ranges_and_only_those() -> None:
    trials = [Trial.draw(seed) for seed in range(300)]
    for name, (low, high) in RANGES.items():
        values = np.array([getattr(trial, name) for trial in trials])
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values.max() <= high
    assert trials[7] == Trial.draw(7)
    assert len(set(trials)) == len(trials)
    assert Trial.from_toml(trials[7].to_toml()) == trials[7]
    assert len({trial.fingerprint for trial in trials}) == len(trials)


def test_a_trial_changes_the_robots_effects_and_the_nominal_one_does_not() -> None:
    trial = Trial.draw(5)
    for profile in (
        IDEAL,
        PROFILE,
        dataclasses.replace(PROFILE, actuator=(*PROFILE.actuator, TorqueGain(gain=0.8))),
    ):
        changed = trial.applied_to(profile)
        before = [e.gain for e in profile.actuator if isinstance(e, TorqueGain)] or [1.0]
        (gain,) = [e.gain for e in changed.actuator if isinstance(e, TorqueGain)]
        assert gain == pytest.approx(before[0] * trial.motor_strength)
        latency = [e.latency for e in changed.camera if isinstance(e, CameraLatency)]
        assert latency == ([pytest.approx(trial.camera_delay_s)] if profile.camera else [])
        nominal = Trial().applied_to(profile)
        assert nominal.actuator_chain == profile.actuator_chain
        assert nominal.camera == profile.camera


def test_a_trial_draws_around_what_was_found() -> None:
    found = Profile(
        actuator=(FeedforwardDelay(delay=0.04), TorqueGain(gain=(0.7, 0.8, 0.9) * 4)),
        camera=(CameraLatency(latency=0.13, jitter=0.01),),
    )
    shifted = dataclasses.replace(found, heightmap=(HeightmapShift(x=0.1, z_range=0.02),))
    changed: list[Any] = [Trial.draw(seed).applied_to(found) for seed in range(300)]
    shifts = np.array([Trial.draw(seed).height_shift(shifted) for seed in range(2000)])
    values = {
        (0.04, 0.04): [profile.actuator[0].delay for profile in changed],
        (0.9 * 0.8, 1.1 * 0.8): [profile.actuator[1].gain[1] for profile in changed],
        (0.110, 0.140): [profile.camera[0].latency for profile in changed],
        (0.015, 0.015): [profile.camera[0].jitter for profile in changed],
        (0.02, 0.18): shifts[:, 0],
        (-0.07, 0.07): shifts[:, 1],
    }
    with pytest.raises(ConfigError, match="heightmap_shift"):
        Trial().applied_to(shifted)
    for (low, high), drawn in values.items():
        room = 0.05 * (high - low) + 1e-12
        assert low - 1e-12 <= min(drawn) <= low + room
        assert high - room <= max(drawn) <= high + 1e-12
    latest = [
        Trial.draw(seed).applied_to(Profile(camera=(CameraLatency(latency=0.5),)))
        for seed in range(50)
    ]
    assert max(e.latency for p in latest for e in p.camera if isinstance(e, CameraLatency)) == 0.5


@pytest.mark.parametrize("kind", FAMILIES)
@pytest.mark.parametrize("speed", [0.6, 1.37])
def test_a_steady_trunk_succeeds_at_its_speed(kind: str, speed: float) -> None:
    terrain = make_terrain(TerrainConfig(terrain=kind))
    outcome = walk(kind, speed)
    assert outcome.success
    assert outcome.cause == ""
    assert outcome.mean_speed_mps == pytest.approx(speed, rel=1e-6)
    assert outcome.time_s == pytest.approx((terrain.finish_x - terrain.timing_x) / speed, rel=1e-6)
    assert outcome.distance_m == pytest.approx(terrain.finish_x, rel=1e-6)


@pytest.mark.parametrize("kind", FAMILIES)
@pytest.mark.parametrize("start_x", [-0.2, 0.2])
def test_where_it_starts_does_not_change_the_speed(kind: str, start_x: float) -> None:
    assert walk(kind, 0.9, start_x=start_x).mean_speed_mps == pytest.approx(0.9, rel=1e-6)


@pytest.mark.parametrize("kind", FAMILIES)
@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ({"roll": 61.0}, "not_upright"),
        ({"roll": -61.0}, "not_upright"),
        ({"pitch": 61.0}, "not_upright"),
        ({"pitch": -61.0}, "not_upright"),
        ({"roll": 180.0}, "not_upright"),
        ({"touch": 1.0}, "trunk_contact"),
    ],
)
@pytest.mark.parametrize("fault_x", [0.0, 0.5, 2.0])
def test_falls_are_failures(kind: str, fault: dict[str, float], cause: str, fault_x: float) -> None:
    outcome = walk(kind, 0.9, fault_x=fault_x, **fault)
    assert not outcome.success
    assert outcome.cause == cause
    assert outcome.distance_m == pytest.approx(fault_x, abs=0.01)


@pytest.mark.parametrize("angle", [{"roll": 59.0}, {"pitch": 59.0}, {"pitch": -59.0}])
def test_leaning_is_no_fall(angle: dict[str, float]) -> None:
    assert walk("stairs", 0.9, fault_x=0.5, **angle).success


@pytest.mark.parametrize("kind", FAMILIES)
def test_slow_trunks_run_out_of_time(kind: str) -> None:
    outcome = walk(kind, 0.1)
    assert outcome.cause == "time_limit"
    assert outcome.distance_m == pytest.approx(2.0, abs=0.01)


def test_nothing_changes_an_outcome() -> None:
    monitor = TrialMonitor(make_terrain(TerrainConfig()))
    monitor.step(0.0, np.zeros(3), LEVEL, False)
    outcome = monitor.step(0.01, np.zeros(3), LEVEL, True)
    assert outcome is not None
    assert monitor.step(0.02, np.array([50.0, 0.0, 0.3]), LEVEL, False) is outcome
    assert monitor.end("ended") is outcome
    assert TrialMonitor(make_terrain(TerrainConfig())).end().cause == "ended"
