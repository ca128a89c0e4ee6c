import dataclasses
from collections import Counter

import mujoco
import numpy as np
import pytest
from hidden_swing import swing

from benchmarks.hidden_effects import (
    joint_effects,
    mjcf,
    plan,
    sizes,
    stances,
)
from benchmarks.hidden_effects.body import BodyScene
from benchmarks.hidden_effects.camera import CameraScene
from benchmarks.hidden_effects.joints import JointScene
from benchmarks.hidden_effects.leg_kernel import STEP_S
from benchmarks.hidden_effects.legs import (
    Hidden,
    PacketTiming,
    Rig,
    _arrivals,
    mean_delay,
    simulate,
)
from benchmarks.hidden_effects.noise import coloured
from benchmarks.hidden_effects.robot import JOINTS, LOWER, STAND, UPPER
from benchmarks.hidden_effects.scene import Setting

CAMERA = ("camera",)


LEG = JOINTS[:3]


@pytest.fixture(scope="module")
def joint_scene():
    scene = JointScene(3, tuning=True, quiet=False, legs=(0,))
    # three segments are enough for laws
    rows = round(scene.segments[3].start_s / scene.rig.control_dt)
    scene.rig = dataclasses.replace(scene.rig, command=scene.rig.command[:rows])
    scene.segments = scene.segments[:3]
    scene._index()
    return scene


@pytest.fixture(scope="module")
def camera_scene():
    return CameraScene(2, tuning=True, static=False, flat=False)


def shown(scene: JointScene, residual: np.ndarray) -> float:
    return sizes.best_rms(scene, sizes.visible(scene, residual), LEG)


def swinging(rows: int, tick_steps: int) -> Rig:
    """Legs that swing for so many rows, on soft gains."""
    return Rig(
        command=swing(rows),
        kp=np.full(12, 30.0),
        kd=np.full(12, 1.0),
        control_dt=0.002,
        tick_steps=tick_steps,
    )


def test_legs_move_as_another_integrator_moves_them():
    rig = swinging(400, tick_steps=16)
    model = mujoco.MjModel.from_xml_string(
        mjcf.model_text(free=False, timestep=0.0005, integrator="RK4")
    )
    data = mujoco.MjData(model)
    data.qpos[:] = STAND
    expected = np.zeros((400, 12, 3))
    for k, row in enumerate(rig.command):
        torque = 30.0 * (row[:, 0] - data.qpos) + (row[:, 1] - data.qvel) + row[:, 2]
        expected[k] = np.stack([data.qpos, data.qvel, torque], axis=-1)
        data.ctrl[:] = torque
        mujoco.mj_step(model, data, nstep=4)
    # a fifth of the noise of each signal
    assert np.all(
        np.abs(simulate(rig, [Hidden()])[0] - expected) < 0.2 * np.array([1e-3, 0.05, 0.2])
    )


@pytest.mark.parametrize("kind", ["command", "forward"])
@pytest.mark.parametrize("delay", [3e-4, 2.1e-3, 7e-3])
def test_packets_are_late_by_their_delay(kind, delay):
    rig = swinging(4000, tick_steps=4)
    hidden = Hidden(**{f"{kind}_delay": np.full(12, delay)})
    late = mean_delay(rig, hidden)
    assert np.allclose(late[kind == "forward"], delay, atol=2e-5)
    assert np.all(late[kind == "command"] == 0)


def test_effects_of_joints_grow_from_nothing(joint_scene):
    rng = np.random.default_rng(0)
    settings = [joint_scene.draw(effect, LEG, rng) for effect in joint_scene.library]
    tiny = joint_scene.respond([(), *[(s.sized(0.0),) for s in settings]])
    assert np.all(tiny == tiny[0])
    found = sizes.one_sigma(joint_scene, settings)
    for setting, sigma in zip(settings, found, strict=True):
        base, one, more = joint_scene.respond(
            [
                (),
                (setting.sized(min(sigma, joint_scene.largest(setting))),),
                (setting.sized(min(1.6 * sigma, joint_scene.largest(setting))),),
            ]
        )
        if np.isfinite(sigma):
            assert shown(joint_scene, one - base) == pytest.approx(1.0, rel=0.15), setting.effect
            if 1.6 * sigma < joint_scene.largest(setting):
                assert shown(joint_scene, more - base) > 1.15, setting.effect


def test_a_clock_and_a_faster_drive_are_no_effects(joint_scene):
    ideal = joint_scene.respond([()])[0]
    rig = joint_scene.rig
    for change in ({"tick_steps": 1}, {"tick_steps": 16}):
        joint_scene.rig = dataclasses.replace(rig, **change)
        moved = joint_scene.respond([()])[0] - ideal
        joint_scene.rig = rig
        assert shown(joint_scene, moved) <= 0.5 * max(
            sizes.best_rms(joint_scene, moved, LEG), 0.2
        ), change
    late = Setting(effect="command_delay", size=6e-4, where=LEG)
    assert shown(joint_scene, joint_scene.respond([(late,)])[0] - ideal) < 0.2
    assert shown(joint_scene, joint_scene.respond([(late.sized(4e-3),)])[0] - ideal) > 1


def test_an_effect_at_one_joint_hardly_moves_another_leg(joint_scene):
    setting = Setting(effect="torque_gain", size=0.2, where=("RL_calf",), shape={"sign": -1.0})
    base, with_it = joint_scene.respond([(), (setting,)])
    assert np.all(base == with_it)


@pytest.mark.parametrize("curve", joint_effects.CURVES)
@pytest.mark.parametrize("size", [0.06, 0.1, 0.3])
def test_saturation_loses_what_its_parameters_say(curve, size):
    peak = joint_effects.Peak(speed=np.full(12, 10.0), torque=np.full(12, 15.0))
    shape = {"onset": 0.3, "curve": float(joint_effects.CURVES.index(curve)), "power": 1.5}
    setting = Setting(effect="torque_saturation", size=size, where=("FR_calf",), shape=shape)
    size = min(size, joint_effects.largest(setting, peak))
    setting = setting.sized(size)
    loss = joint_effects.lost_curve(setting, peak)[2]
    truth = joint_effects.parameters(setting, peak)
    command = np.linspace(0, 35.55, len(loss))
    assert np.all(np.diff(command - loss) >= -1e-9)
    # two shapes are sized by what they take at the largest torque of the log, of which the curve
    # has no point
    share, at = (size, 15.0) if curve in ("tanh", "clip") else (size, 35.55)
    assert np.interp(at, command, loss) == pytest.approx(at * share, rel=0.05)
    assert truth["plateau"] == pytest.approx(35.55 - loss[-1])
    assert np.interp(truth["knee"], command, loss) == pytest.approx(0.05 * truth["knee"], rel=0.1)


@pytest.mark.parametrize("effect", sorted(joint_effects.LIBRARY))
def test_the_truth_of_every_joint_is_told_where_joints_differ(effect, joint_scene):
    where = ("FR_hip", "FR_calf", "RL_thigh")
    setting = joint_scene.draw(effect, where, np.random.default_rng(3))
    told = joint_scene.parameters_at(setting)
    if not told:
        alone = [
            joint_scene.parameters(joint_scene.draw(effect, (j,), np.random.default_rng(3)))
            for j in where
        ]
        assert all(one == alone[0] for one in alone)
        return
    assert tuple(told) == where
    assert told[where[0]] == joint_scene.parameters(setting)
    assert len({str(params) for params in told.values()}) == len(where)


@pytest.mark.sample(2)
@pytest.mark.parametrize("tuning", [True, False])
@pytest.mark.parametrize("seed", range(2))
def test_commands_stay_within_the_joints(tuning, seed):
    scene = JointScene(seed, tuning=tuning, quiet=False, legs=(0,))
    position = scene.rig.command[..., 0]
    assert np.all(position > LOWER)
    assert np.all(position < UPPER)
    counts = Counter(segment.condition for segment in scene.segments)
    assert len(counts) >= 4
    assert min(counts.values()) >= 2


def test_effects_of_the_camera_are_what_they_are_called(camera_scene):
    def depth(effect: str, size: float, **shape: float) -> np.ndarray:
        setting = Setting(effect=effect, size=size, where=CAMERA, shape=shape)
        return camera_scene.frames((setting,), None).depth

    plain = camera_scene.frames((), None).depth
    seen = plain > 0
    assert np.allclose(depth("depth_scale", 0.02, sign=1.0)[seen], 1.02 * plain[seen], rtol=1e-5)
    assert np.allclose(depth("depth_bias", 0.01, sign=-1.0)[seen], plain[seen] - 0.01, atol=1e-5)
    holes = depth("edge_holes", 2.0)
    assert np.all(holes[holes > 0] == plain[holes > 0])
    assert (holes == 0).sum() > (plain == 0).sum()
    filled = depth("hole_fill", 3.0)
    assert np.all(filled[seen] == plain[seen])
    assert (filled == 0).sum() < (plain == 0).sum()
    clipped = depth("range_clip", 0.3)
    assert clipped.max() == pytest.approx(0.7 * camera_scene.farthest)
    smeared = depth("temporal_smear", 0.6)
    both = (smeared[9] > 0) & (smeared[10] > 0) & seen[10]
    assert np.allclose(smeared[10][both], (0.4 * plain[10] + 0.6 * smeared[9])[both], atol=1e-5)


def test_a_late_camera_shows_what_was(camera_scene):
    late = camera_scene.frames(
        (Setting(effect="camera_latency", size=0.02, where=CAMERA, shape={"sign": 1.0}),), None
    )
    assert np.allclose(late.arrival - late.capture, camera_scene.latency + 0.02)
    x, z, pitch = camera_scene.path.at(late.capture)
    assert np.isfinite([x, z, pitch]).all()
    assert camera_scene.parameters(
        Setting(effect="camera_latency", size=0.02, where=CAMERA, shape={"sign": 1.0})
    ) == {"latency": camera_scene.latency + 0.02}


def test_a_floor_alone_cannot_tell_scale_from_height():
    scene = CameraScene(1, tuning=True, static=True, flat=True)
    settings = [
        Setting(effect="depth_scale", size=0.01, where=CAMERA, shape={"sign": 1.0}),
        Setting(effect="camera_height", size=0.0035, where=CAMERA, shape={"sign": 1.0}),
    ]
    marks = sizes.signatures(scene, settings)
    assert sizes.nearest(marks[0], marks[1:])[0] > 0.95


def test_a_heavier_body_stands_lower_and_imu_effects_leave_it_alone(monkeypatch):
    monkeypatch.setattr(stances, "TUNING", {"hold": stances.hold, "rock": stances.rock})
    scene = BodyScene(0, tuning=True, imu=False)
    scene.position, scene.velocity = scene.position[:1500], scene.velocity[:1500]
    scene._ideal = scene._simulate({})
    plain = scene.read(())
    heavy = scene.read((Setting(effect="payload_mass", size=1.0, where=("trunk",)),))
    late = scene.read((Setting(effect="imu_latency", size=0.01, where=("trunk",)),))
    assert heavy["z"].mean() < plain["z"].mean() - 2e-4
    assert (heavy["load"] - plain["load"]).sum(axis=1).mean() == pytest.approx(9.81, rel=0.15)
    assert np.all(late["rpy"] == plain["rpy"])
    assert np.allclose(late["gyro"][100:], plain["gyro"][95:-5])
    assert np.linalg.norm(plain["acc"], axis=1).mean() == pytest.approx(9.81, rel=0.02)


@pytest.mark.parametrize("motor_side", [0.0, 1.0])
def test_play_is_logged_on_the_side_of_its_encoder(motor_side):
    """At the motor the law follows what is logged.

    At the joint, what is half a gap ahead of it or behind.
    """
    rig = swinging(1500, tick_steps=1)
    shape = {"stiffness": 2e4, "damped": 0.3, "motor_side": motor_side}
    setting = Setting(effect="backlash", size=0.02, where=JOINTS, shape=shape)
    peak = joint_effects.Peak(speed=np.full(12, 10.0), torque=np.full(12, 15.0))
    q, dq, believed = np.moveaxis(simulate(rig, [joint_effects.hidden((setting,), peak)])[0], -1, 0)
    law = 30.0 * (rig.command[..., 0] - q) + (rig.command[..., 1] - dq) + rig.command[..., 2]
    apart = np.median(np.abs(law - believed)[100:])
    assert apart < 0.1 if motor_side else apart == pytest.approx(30.0 * 0.01, rel=0.2)


@pytest.mark.parametrize("late", [0.0, 0.05])
@pytest.mark.parametrize("is_whole", [False, True])
def test_packets_keep_their_order(late, is_whole):
    way = PacketTiming(jitter=0.2, late=late, is_whole=is_whole)
    hidden = Hidden(command_delay=np.full(12, 5e-3), command_way=way)
    arrival, _ = _arrivals(4000, 16, hidden, seed=1)
    assert np.all(np.diff(arrival, axis=1) >= 0)
    waits = (arrival - 16 * np.arange(4000))[:, 1:]
    assert np.all(waits % (16 if is_whole else 1) == 0)
    # one that is late, by two times its way, holds up five others
    assert 1.0 + 2.0 * late < np.mean(waits) * STEP_S / 5e-3 < 1.15 + 6.0 * late


@pytest.mark.parametrize("effect", ["command_delay", "feedforward_delay"])
@pytest.mark.parametrize("periods", [0.1, 0.6, 1.0, 3.4])
def test_packets_come_in_whole_periods_from_one_period_on(joint_scene, effect, periods):
    """A delay below a period makes no packet a period late;
    `tau_ff` is never there before its packet.
    """
    shape = {"jitter": 0.02, "late": 0.0, "is_whole": 1.0}
    delay = Setting(
        effect=effect, where=LEG, size=periods * joint_scene.rig.control_dt, shape=shape
    )
    rows, steps = 4000, round(joint_scene.rig.control_dt / STEP_S)
    command, forward = _arrivals(rows, steps, joint_scene._as_logged((delay,)), seed=1)
    assert np.all(forward >= command)
    waits = ((command if effect == "command_delay" else forward) - steps * np.arange(rows))[:3, 1:]
    assert np.mean(waits) / steps == pytest.approx(periods, rel=0.05, abs=0.02)
    assert np.all(waits % steps == 0) == (periods >= 1.0)
    if effect == "command_delay":
        np.testing.assert_array_equal(command, forward)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_a_part_of_noise_lasts(share):
    """Unit variance, of which what is slow stays where half a second's mean is taken."""
    noise = coloured(
        np.random.default_rng(1), (60000, 4), 100.0, 500.0, True, slow_share=share, slow_hz=0.5
    )
    assert noise.std(axis=0) == pytest.approx(1.0, abs=0.1)
    means = noise.reshape(-1, 250, 4).mean(axis=1).var()
    assert 0.5 * share < means < share + 0.02


@pytest.mark.parametrize("name", plan.SEALED_OUTSIDE["joints"])
def test_outside_effects_of_joints_grow_from_nothing(joint_scene, name):
    setting = joint_scene.draw(name, LEG, np.random.default_rng(1))
    ideal, none, some = joint_scene.respond(
        [(), (setting.sized(0.0),), (setting.sized(2 * setting.size),)]
    )
    assert np.all(ideal == none)
    assert sizes.best_rms(joint_scene, some - ideal, LEG) > 0.1


@pytest.mark.parametrize("name", plan.SEALED_OUTSIDE["camera"])
def test_outside_effects_of_the_camera_grow_from_nothing(camera_scene, name):
    setting = camera_scene.draw(name, CAMERA, np.random.default_rng(1))
    ideal, none, some = camera_scene.respond([(), (setting.sized(0.0),), (setting,)])
    assert np.allclose(ideal, none, atol=1e-3)
    assert sizes.best_rms(camera_scene, some - ideal, CAMERA) > 0.1
