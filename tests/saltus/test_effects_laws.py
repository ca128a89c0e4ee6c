"""Laws that every effect obeys."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pytest
import torch
from samples import CURVE, ROBOT

from saltus.effects import depth_errors, joint_loads, motors
from saltus.effects.backlash import Backlash
from saltus.effects.body import (
    BaseInertia,
    BaseRoll,
    BodyModel,
    ComOffset,
    ContactCompliance,
    FootFriction,
    PayloadMass,
    SoftFeet,
)
from saltus.effects.camera import CameraFov, CameraHeight, CameraPitch
from saltus.effects.delay_line import CommandDelay, FeedforwardDelay
from saltus.effects.effect import Effect, map_arrays
from saltus.effects.encoders import EncoderBias, EncoderQuantisation, VelocityFilter, VelocityScale
from saltus.effects.heightmap_shift import HeightmapShift
from saltus.effects.image_delivery import CameraLatency, FrameDrop, SampleAndHold, TemporalSmear
from saltus.effects.imu import ImuBias, ImuLatency, ImuReading
from saltus.effects.profile import EFFECTS, IDEAL, PARTS, Profile
from saltus.effects.signals import (
    CameraView,
    DepthImage,
    DriveTorque,
    EncoderReading,
    HeightQuery,
    Resistance,
)
from saltus.errors import ConfigError
from saltus.joint_command import JointCommand

ROBOTS = 5
STEPS = 12
PERIOD_S = {
    "command": 0.002,
    "torque": 0.002,
    "joint": 0.002,
    "joint_state": 0.002,
    "depth": 0.01,
    "view": 1.0,
    "heightmap": 0.01,
    "model": 1.0,
    "stand": 1.0,
    "imu": 0.002,
}
PER_JOINT_SMALL = tuple(0.01 * j for j in range(12))
PER_JOINT = tuple(0.5 + 0.1 * j for j in range(12))

_EXAMPLES: tuple[Effect[Any], ...] = (
    CommandDelay(delay=0.009),
    CommandDelay(delay=0.006),
    FeedforwardDelay(delay=0.010),
    FeedforwardDelay(delay=0.0033),
    motors.ActuatorLag(time_constant=0.004),
    motors.ActuatorLag(time_constant=(0.0, 0.002, 0.004) * 4),
    motors.TorqueSpeedLimit(corner=0.0, no_load=(30.0, 30.0, 20.0) * 4),
    motors.TorqueSpeedLimit(corner=10.0, no_load=21.0),
    motors.TorqueSaturation(curve=CURVE),
    motors.TorqueSaturation(knee=14.2, plateau=(17.2, 17.2, 25.9) * 4),
    motors.TorqueGain(gain=0.9),
    motors.TorqueGain(gain=PER_JOINT),
    motors.BatterySag(loss_at_end=0.2, duration_s=5.0),
    motors.VoltageSag(per_kw=0.2),
    motors.VoltageSag(per_kw=0.2, brown_out=0.7),
    Backlash(width=0.01),
    Backlash(width=PER_JOINT_SMALL),
    joint_loads.JointSpring(torque=0.2),
    joint_loads.JointSpring(torque=PER_JOINT, stiffness=PER_JOINT),
    joint_loads.EndStop(upper=0.5),
    joint_loads.EndStop(upper=PER_JOINT, lower=-0.2, stiffness=50.0),
    joint_loads.ViscousFriction(coefficient=0.2),
    joint_loads.ViscousFriction(coefficient=PER_JOINT),
    joint_loads.CoulombFriction(torque=0.3),
    joint_loads.Stiction(breakaway=0.3, stribeck_velocity=5.0),
    joint_loads.Stiction(breakaway=PER_JOINT, stribeck_velocity=PER_JOINT),
    joint_loads.Armature(added=0.002),
    EncoderBias(bias=-0.02),
    EncoderQuantisation(step=1e-3),
    EncoderQuantisation(step=(0.0, 1e-3, 2e-3) * 4),
    VelocityFilter(time_constant=0.004),
    VelocityFilter(time_constant=(0.0, 0.002, 0.004) * 4),
    VelocityScale(scale=1.15),
    SampleAndHold(period=0.03),
    depth_errors.DepthScale(scale=1.02),
    depth_errors.DepthBias(bias=-0.3),
    depth_errors.DepthNoise(subpixel_sigma=0.1),
    depth_errors.EdgeHoles(width=2.0),
    depth_errors.RangeClip(max=0.8),
    depth_errors.HoleFill(reach=1.0),
    FrameDrop(fraction=0.4),
    TemporalSmear(alpha=0.4),
    CameraLatency(latency=0.034),
    CameraLatency(latency=0.045, jitter=0.02),
    CameraPitch(offset=0.02),
    CameraHeight(offset=-0.01),
    CameraFov(scale=1.03),
    HeightmapShift(x=0.03, z=-0.02),
    HeightmapShift(x_range=0.08, z_range=0.05),
    PayloadMass(mass=-0.7),
    ComOffset(x=0.02, z=-0.01),
    BaseInertia(scale=1.2),
    FootFriction(coefficient=0.5),
    ContactCompliance(time_constant=0.012),
    SoftFeet(torsion=0.02, rolling=0.01),
    SoftFeet(touch=0.1, depth=0.01),
    BaseRoll(give=0.05, damping=0.2),
    ImuBias(gyro_x=0.02, gyro_z=-0.03),
    ImuBias(roll=0.02, pitch=-0.01),
    ImuLatency(delay=0.006),
    ImuLatency(delay=0.0053),
)
EXAMPLES = tuple(effect.fitted(ROBOT) for effect in _EXAMPLES)
NULLS = tuple(kind().fitted(ROBOT) for kind in EFFECTS.values())


def name(effect: Effect[Any]) -> str:
    return effect.name


def signals(site: str, batch: tuple[int, ...], dtype: Any = np.float64) -> list[Any]:
    """What an effect of a site gets at successive times."""
    rng = np.random.default_rng(7)

    def array(*shape: int, scale: float = 1.0) -> Any:
        return (scale * rng.standard_normal((*batch, *shape))).astype(dtype)

    def one(k: int) -> Any:
        if site == "command":
            return JointCommand(
                position=array(12),
                velocity=array(12),
                kp=array(12),
                kd=array(12),
                torque=array(12, scale=20.0),
            )
        if site == "torque":
            return DriveTorque(
                torque=array(12, scale=20.0), position=array(12), velocity=array(12, scale=15.0)
            )
        if site == "joint_state":
            return EncoderReading(position=array(12), velocity=array(12))
        if site == "joint":
            return Resistance(
                velocity=array(12), friction=array(12), damping=array(12), armature=array(12)
            )
        if site == "depth":
            depth, hit = abs(array(6, 4)), array(6, 4) > -1.0
            return DepthImage(depth=depth * hit, time_s=np.full(batch, PERIOD_S[site] * k))
        if site == "view":
            return CameraView(position=array(3), pitch=array(), tangent_scale=array())
        if site in ("model", "stand"):
            return BodyModel(
                payload_kg=array(),
                com_shift=array(3),
                inertia_scale=array(),
                friction=array(),
                contact_time_constant=array(),
                touch_impedance=array(),
                impedance_depth=array(),
                torsion=array(),
                rolling=array(),
                roll_give=array(),
                roll_damping=array(),
            )
        if site == "imu":
            quaternion = array(4)
            quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
            return ImuReading(
                quaternion_base_in_world=quaternion,
                angular_velocity_base=array(3),
                acceleration_base=array(3),
            )
        return HeightQuery(x=array(30), offset=array(1))

    if site == "depth":  # a camera at half the rate of those who look
        return [image for k in range(0, STEPS, 2) for image in [one(k)] * 2]
    return [one(k) for k in range(STEPS)]


def run(effect: Effect[Any], inputs: list[Any], state: Any) -> list[Any]:
    outputs = []
    for k, signal in enumerate(inputs):
        out, state = effect.apply(signal, k * PERIOD_S[effect.site], state)
        outputs.append(out)
    return outputs


def arrays(signal: Any) -> list[Any]:
    return [getattr(signal, f.name) for f in fields(signal)]


def started(effect: Effect[Any], batch: tuple[int, ...], seed: int = 3) -> Any:
    return effect.init(batch, np.random.default_rng(seed))


def test_every_effect_has_an_example() -> None:
    assert {e.name for e in EXAMPLES} == set(EFFECTS)
    assert {e.site for e in EXAMPLES} <= set(PARTS)


@pytest.mark.parametrize("batch", [(), (ROBOTS,)])
@pytest.mark.parametrize("effect", NULLS, ids=name)
def test_identity_at_null_to_the_bit(effect: Effect[Any], batch: tuple[int, ...]) -> None:
    assert effect.is_null()
    inputs = signals(effect.site, batch)
    for before, after in zip(inputs, run(effect, inputs, started(effect, batch)), strict=True):
        for a, b in zip(arrays(before), arrays(after), strict=True):
            assert np.asarray(a).tobytes() == np.asarray(b).tobytes()


@pytest.mark.parametrize("effect", EXAMPLES, ids=name)
def test_examples_change_something(effect: Effect[Any]) -> None:
    assert not effect.is_null()
    inputs = signals(effect.site, (ROBOTS,))
    outputs = run(effect, inputs, started(effect, (ROBOTS,)))
    assert any(
        not np.array_equal(a, b)
        for before, after in zip(inputs, outputs, strict=True)
        for a, b in zip(arrays(before), arrays(after), strict=True)
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("effect", EXAMPLES, ids=name)
def test_shape_and_dtype_are_kept_and_inputs_left_alone(effect: Effect[Any], dtype: Any) -> None:
    inputs = signals(effect.site, (2, 3), dtype)
    copies = [map_arrays(np.copy, signal) for signal in inputs]
    outputs = run(effect, inputs, started(effect, (2, 3)))
    for before, copy, after in zip(inputs, copies, outputs, strict=True):
        for a, c, b in zip(arrays(before), arrays(copy), arrays(after), strict=True):
            np.testing.assert_array_equal(a, c)
            assert (b.shape, b.dtype) == (a.shape, a.dtype)


@pytest.mark.parametrize("effect", EXAMPLES, ids=name)
def test_batched_is_one_by_one(effect: Effect[Any]) -> None:
    inputs = signals(effect.site, (ROBOTS,))
    state = started(effect, (ROBOTS,))
    together = run(effect, inputs, state)
    for i in range(ROBOTS):
        single = [map_arrays(lambda a, i=i: np.asarray(a[i]), signal) for signal in inputs]
        alone = run(effect, single, map_arrays(lambda a, i=i: np.asarray(a[i]), state))
        for batch_out, out in zip(together, alone, strict=True):
            for a, b in zip(arrays(batch_out), arrays(out), strict=True):
                np.testing.assert_array_equal(a[i], b)


@pytest.mark.parametrize("effect", EXAMPLES, ids=name)
def test_torch_is_numpy(effect: Effect[Any]) -> None:
    inputs = signals(effect.site, (ROBOTS,))
    state = started(effect, (ROBOTS,))
    outputs = run(
        effect, [map_arrays(torch.as_tensor, s) for s in inputs], map_arrays(torch.as_tensor, state)
    )
    for ours, theirs in zip(run(effect, inputs, state), outputs, strict=True):
        for a, b in zip(arrays(ours), arrays(theirs), strict=True):
            assert isinstance(b, torch.Tensor)
            np.testing.assert_allclose(a, b.numpy(), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("effect", EXAMPLES, ids=name)
def test_deterministic_by_seed(effect: Effect[Any]) -> None:
    inputs = signals(effect.site, (ROBOTS,))
    first, again = (run(effect, inputs, started(effect, (ROBOTS,))) for _ in range(2))
    for one, two in zip(first, again, strict=True):
        for a, b in zip(arrays(one), arrays(two), strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("effect", EXAMPLES + NULLS, ids=name)
def test_toml_round_trip(effect: Effect[Any]) -> None:
    profile = IDEAL.having(effect)
    assert Profile.from_toml(profile.to_toml()) == profile


@pytest.mark.parametrize("bad", [-1e6, 1e6, float("nan"), "fast", (0.1, 0.2), None])
@pytest.mark.parametrize("kind", EFFECTS.values(), ids=lambda kind: kind.name)
def test_parameters_out_of_bounds_are_errors(kind: type[Effect[Any]], bad: Any) -> None:
    for parameter in fields(kind):
        if bad is None and "robot" in parameter.metadata:  # then it is the robot's
            continue
        with pytest.raises(ConfigError, match=f"{kind.name}.*{parameter.name}"):
            kind(**{parameter.name: bad})


@dataclass(frozen=True)
class Batched:
    effect: Effect[Any]
    parameter: str
    values: tuple[float, ...]


@pytest.mark.parametrize(
    "case",
    [
        Batched(CommandDelay(), "delay", (0.0, 0.002, 0.0051, 0.009, 0.01)),
        Batched(FeedforwardDelay(), "delay", (0.01, 0.002, 0.0051, 0.009, 0.0)),
        Batched(motors.ActuatorLag(), "time_constant", (0.0, 0.001, 0.002, 0.004, 0.008)),
        Batched(motors.TorqueGain(), "gain", (0.9, 0.95, 1.0, 1.05, 1.1)),
        Batched(CameraLatency(), "latency", (0.0, 0.03, 0.04, 0.052, 0.06)),
        Batched(FrameDrop(), "fraction", (0.0, 0.2, 0.4, 0.6, 1.0)),
        Batched(depth_errors.DepthScale(), "scale", (1.0, 0.9, 1.1, 1.02, 1.0)),
        Batched(depth_errors.DepthBias(), "bias", (0.0, -0.3, 0.3, 0.1, 0.0)),
        Batched(depth_errors.DepthNoise(), "subpixel_sigma", (0.0, 0.1, 0.2, 0.3, 1.0)),
        Batched(depth_errors.EdgeHoles(), "width", (0.0, 1.0, 2.0, 3.0, 0.0)),
        Batched(depth_errors.HoleFill(), "reach", (0.0, 1.0, 2.0, 3.0, 0.0)),
        Batched(depth_errors.RangeClip(), "max", (np.inf, 0.5, 1.0, 1.5, 2.0)),
        Batched(TemporalSmear(), "alpha", (1.0, 0.4, 0.6, 0.8, 0.9)),
        Batched(PayloadMass(), "mass", (0.0, -1.0, 0.5, 1.0, 3.0)),
        Batched(ComOffset(), "y", (0.0, -0.02, 0.01, 0.02, 0.03)),
        Batched(BaseInertia(), "scale", (1.0, 0.8, 0.9, 1.1, 1.2)),
        Batched(FootFriction(), "coefficient", (0.8, 0.3, 0.4, 0.6, 1.0)),
        Batched(ContactCompliance(), "time_constant", (0.005, 0.008, 0.01, 0.015, 0.02)),
        Batched(ImuBias(), "gyro_y", (0.0, -0.02, 0.01, 0.02, 0.05)),
        Batched(ImuBias(), "pitch", (0.0, -0.02, 0.01, 0.02, 0.05)),
        Batched(ImuLatency(), "delay", (0.0, 0.002, 0.0031, 0.006, 0.01)),
    ],
    ids=lambda case: case.effect.name,
)
def test_robots_of_a_batch_may_differ(case: Batched) -> None:
    """One effect with a value for each robot is that many effects."""
    site = case.effect.site
    joints = site in ("command", "torque")
    column = np.array(case.values)[:, None] if joints else np.array(case.values)
    effect = replace(case.effect, **{case.parameter: column})
    inputs, state = signals(site, (ROBOTS,)), started(effect, (ROBOTS,))
    together = run(effect, inputs, state)
    for i, value in enumerate(case.values):
        single = [map_arrays(lambda a, i=i: np.asarray(a[i]), signal) for signal in inputs]
        own = replace(case.effect, **{case.parameter: value})
        alone = run(own, single, map_arrays(lambda a, i=i: np.asarray(a[i]), state))
        for batch_out, out in zip(together, alone, strict=True):
            for a, b in zip(arrays(batch_out), arrays(out), strict=True):
                np.testing.assert_allclose(a[i], b, rtol=1e-13)
