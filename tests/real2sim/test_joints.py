"""The problem of the joints, on logs of the plant with effects hidden in it."""

from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from samples import CURVE, ROBOT
from scipy.optimize import least_squares
from scipy.signal import lfilter
from stated_values import check_stated_values

from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT
from saltus.effects.body import BaseRoll
from saltus.effects.chain import ActuatorChain, BodyChain
from saltus.effects.effect import Effect
from saltus.effects.encoders import EncoderBias, VelocityScale
from saltus.effects.joint_loads import EndStop, JointSpring
from saltus.effects.motors import TorqueSaturation
from saltus.effects.profile import EFFECTS
from saltus.errors import RecordingError
from saltus.joint_command import JointCommand
from saltus.real2sim.problem.joints import motion as joint_motion
from saltus.real2sim.problem.joints.candidates import KINDS, LOOP_RATE, Reach
from saltus.real2sim.problem.joints.drives import Drives, lost
from saltus.real2sim.problem.joints.excitation import _step
from saltus.real2sim.problem.joints.mechanics import rubbed
from saltus.real2sim.problem.joints.problem import JointProblem
from saltus.real2sim.problem.joints.replay import replay
from saltus.real2sim.saturation_curve import _fitted, _Pieces
from saltus.real2sim.search.search import search
from saltus.recordings.run_log import JOINT_SIGNALS, JointTable, RunLog
from saltus.robots.robot import JOINTS
from saltus.sim.plant import Plant
from saltus.terrain import flat

DT = PHYSICS_DT
KP, KD = 40.0, 1.0
NOISE = (1e-3, 0.05, 0.2)  # rad, rad/s, Nm: typical of drives of this class
PLACES = ("hip", "thigh", "calf")


def commands() -> tuple[Floats, list[dict[str, Any]]]:
    """A chirp, a slow triangle, large steps and a ranking of holds, each twice."""
    t = np.arange(0.0, 1.5, DT)
    shapes = {
        "chirp": (np.sin(2.0 * np.pi * (0.5 * t + 3.0 * t**2)), (0.15, 0.2, 0.2)),
        "triangle": (2.0 * np.abs(((t / 0.75) % 2.0) - 1.0) - 1.0, (0.2, 0.3, 0.3)),
        "steps": (np.repeat([0.0, 1.0, -1.0], 250), (0.35, 0.9, 0.4)),
        "ranking": (np.repeat([0.0, 0.5, 1.0, 0.5, 0.0], 150), (0.1, 0.2, 0.2)),
    }
    parts, segments, start = [], [], 0.0
    for name, (shape, amplitude) in shapes.items():
        for repeat in range(2):
            parts.append(ROBOT.stand_pose + shape[:, None] * np.tile(amplitude, 4))
            end = start + len(shape) * DT
            segments.append({"name": f"{name}{repeat}", "t0": start, "t1": end, "condition": name})
            start = end
    return np.concatenate(parts), segments


@cache
def motion(
    *effects: Effect[Any], kp: float = KP, stretched: float = 0.0, integral: float = 0.0
) -> RunLog:
    """What a held robot does, without noise, with effects of drives and of what holds it.

    Knees may be told to be `stretched` by so much [rad]; drives may have an `integral` term
    [Nm/(rad s)], which belongs to no effect.
    """
    q_des, segments = commands()
    q_des = q_des + np.tile((0.0, 0.0, stretched), 4)
    stand = tuple(effect for effect in effects if effect.site == "stand")
    chain = ActuatorChain(tuple(effect for effect in effects if effect not in stand))
    plant = Plant(ROBOT, flat.make(), chain=chain, body=BodyChain(stand), held=True)
    zero, state = np.zeros(12), plant.state
    tau_ff = (
        0.8 * np.sin(2.0 * np.pi * 1.3 * (np.arange(len(q_des)) % 750) * DT)[:, None] * np.ones(12)
    )
    q, dq, tau_est = np.empty((3, len(q_des), 12))
    more = np.zeros(12)
    for k in range(len(q_des)):
        q[k], dq[k] = state.joint_position, state.joint_velocity
        more = more + integral * DT * (q_des[k] - q[k])
        torque = tau_ff[k] + more
        state = plant.step(
            JointCommand(
                position=q_des[k], velocity=zero, kp=zero + kp, kd=zero + KD, torque=torque
            )
        )
        tau_est[k] = state.joint_torque
    meta = {
        "schema": "saltus-run/1",
        "robot": "go1",
        "base": "fixed",
        "joints": list(JOINTS),
        "kp": kp,
        "kd": KD,
        "control_dt": DT,
        "excitation": {"text": "", "segments": segments},
        "terrain": "flat",
    }
    time_s = DT * np.arange(len(q_des))
    table = JointTable(
        time_s=time_s, q=q, q_des=q_des, dq=dq, dq_des=0.0 * q, tau_ff=tau_ff, tau_est=tau_est
    )
    return RunLog(meta=meta, joints=table)


def noisy(log: RunLog, correlation: float = 0.0, seed: int = 0) -> RunLog:
    """The log with noise on what is measured; `correlation` from one row to the next."""
    rng = np.random.default_rng(seed)
    signals = {}
    for name, spread in zip(("q", "dq", "tau_est"), NOISE, strict=True):
        noise = rng.standard_normal(log.joints.q.shape)
        noise = lfilter([np.sqrt(1.0 - correlation**2)], [1.0, -correlation], noise, axis=0)
        signals[name] = getattr(log.joints, name) + spread * noise
    return replace(log, joints=replace(log.joints, **signals))


@cache
def problem_of(*effects: Effect[Any], kp: float = KP) -> JointProblem:
    """Of the robot's log with white noise."""
    return JointProblem(noisy(motion(*effects, kp=kp)))


def unknowns(problem: JointProblem, values: dict[str, tuple[float, ...]]) -> Floats:
    """Unknowns with the same values of some effects at every joint, shape (blocks, unknowns)."""
    found = [
        value
        for c in problem.candidates
        for value in values.get(c.effect, (0.0,) * len(c.unknowns))
    ]
    return np.tile(found, (len(problem.blocks), 1))


@dataclass(frozen=True)
class Hidden:
    """An effect in the plant and the same in the coordinates of the search."""

    effect: Effect[Any]
    unknowns: tuple[float, ...]
    fitted: int = 1
    """How many of the unknowns are told by the log."""


def hidden(name: str, values: tuple[float, ...], **parameters: Any) -> Hidden:
    return Hidden(EFFECTS[name](**parameters), values)


CASES = (
    hidden("command_delay", (0.0033,), delay=0.0033),
    hidden("feedforward_delay", (0.012,), delay=0.012),
    hidden("actuator_lag", (0.004,), time_constant=0.004),
    hidden("torque_gain", (-0.1,), gain=0.9),
    hidden("battery_sag", (0.2,), loss_at_end=0.2, duration_s=12.0),
    hidden("viscous_friction", (0.1,), coefficient=0.1),
    hidden("coulomb_friction", (0.2, 0.0), torque=0.2),
    hidden("stiction", (0.4, 0.3, 0.0), breakaway=0.4, stribeck_velocity=0.3),
    hidden("armature", (0.002,), added=0.002),
    hidden("encoder_bias", (0.02,), bias=0.02),
    hidden("velocity_filter", (0.004,), time_constant=0.004),
    hidden("velocity_scale", (0.12,), scale=1.12),
)

COARSE = hidden("encoder_quantisation", (1.0, 0.006), step=0.006)


def name_of(case: Hidden) -> str:
    return case.effect.name


def simulated(problem: JointProblem, drives: Drives) -> np.ndarray:
    """Means of angles, velocities and torques, as the problem replays them."""
    return replay(problem._motion, problem._windows, drives, problem._averaged)


def test_the_replay_is_the_plant() -> None:
    """Without noise what is left is far below what a drive measures: 0.1 mrad."""
    log = motion()
    problem = problem_of()
    q, _, _ = simulated(problem, problem._candidates.drives(unknowns(problem, {})[None], DT))
    clean = JointProblem(log)
    apart = clean._measured[:, 0] - q.reshape(-1, 4, 3)[problem._sample]
    assert np.sqrt(np.mean(apart[50:] ** 2)) < 1e-4


@pytest.mark.sample(1)
@pytest.mark.parametrize("stairs", [2, 4])
def test_a_faster_loop_is_what_smaller_steps_make_of_it(
    stairs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The nuisance stands for a drive that evaluates its law several times
    in a step of the replay.
    """
    log = motion()
    coarse = JointProblem(log)
    sets = np.zeros((2, 4, coarse._candidates.count))
    sets[1, :, coarse._candidates.columns[LOOP_RATE, 0]] = 1.0 - 1.0 / stairs
    slow, fast = np.moveaxis(
        simulated(coarse, coarse._candidates.drives(sets, coarse._motion.dt_s))[0], -1, 0
    )
    monkeypatch.setattr(joint_motion, "SLOWEST_LOOP_S", coarse._motion.dt_s / stairs)
    fine = JointProblem(log)
    assert fine._motion.every == stairs * coarse._motion.every
    true = simulated(fine, fine._candidates.drives(sets[:1], fine._motion.dt_s))[0][..., 0]
    assert np.std(fast - true) < 0.1 * np.std(slow - true)


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_residuals_of_the_right_model_are_white(correlation: float) -> None:
    problem = JointProblem(noisy(motion(), correlation))
    residuals = problem.residuals(unknowns(problem, {})[None])[0]
    assert np.mean(residuals**2) == pytest.approx(1.0, abs=0.06 if correlation == 0.0 else 0.12)
    for signal in range(len(problem.signals)):
        one = residuals[:, problem.signal == signal]
        assert abs(np.mean(one[:, 1:] * one[:, :-1])) < (0.15 if correlation == 0.0 else 0.35)


@pytest.mark.sample(3)
@pytest.mark.parametrize("case", [*CASES, COARSE], ids=name_of)
def test_an_effect_shows_and_its_truth_leaves_noise(case: Hidden) -> None:
    problem = problem_of(case.effect)
    truth = {case.effect.name: case.unknowns}
    claimed, right = problem.residuals(np.stack([unknowns(problem, {}), unknowns(problem, truth)]))
    # repeats differ where the battery empties or coarse angles are fed back: noise is then taken
    # for more than it is
    least = {"battery_sag": 0.62, "encoder_quantisation": 0.8}.get(case.effect.name, 0.88)
    assert least < np.mean(right**2) < 1.12
    assert np.mean(claimed**2) > 1.2


@pytest.mark.sample(4)
@pytest.mark.parametrize("case", CASES, ids=name_of)
def test_fits_find_the_truth(case: Hidden) -> None:
    """Gauss-Newton on the effect's own unknowns, one value for all joints of a kind."""
    problem = problem_of(case.effect)
    candidates = [c for c in problem.candidates if c.effect == case.effect.name]
    free = np.array([i for i, u in enumerate(candidates[0].unknowns) if not u.is_shape])
    step = np.array([0.25 * candidates[0].unknowns[i].scale for i in free])
    value = np.array(case.unknowns)
    value[free] = 0.5 * value[free]  # shapes are given, sizes are looked for
    for _ in range(4):
        tries = [value] + [
            value + s * np.eye(len(value))[i] for i, s in zip(free, step, strict=True)
        ]
        r = problem.residuals(
            np.stack([unknowns(problem, {case.effect.name: tuple(t)}) for t in tries])
        )
        flat_residuals = r.reshape(len(tries), -1)
        slopes = (flat_residuals[1:] - flat_residuals[0]) / step[:, None]
        value[free] -= np.linalg.solve(slopes @ slopes.T, slopes @ flat_residuals[0])
    np.testing.assert_allclose(value, case.unknowns, rtol=0.05)


@pytest.mark.parametrize("slowest", [0.15, 0.4, 0.6, 0.79, 0.9, 1.0])
def test_fits_of_a_speed_limit_start_where_it_acts_also_if_one_leg_has_it(slowest: float) -> None:
    """A joint that is limited reaches its no-load speed at most, however fast the others are."""
    reach = Reach(
        speed=11.5, slowest=11.5 * slowest, torque=20.0, middle=0.0, side=1.0, end=1.0,
        to_limit=1.0, steps=(),
    )  # fmt: skip
    (kind,) = (kind for kind in KINDS if kind.effect == "torque_speed_limit")
    no_load = np.array([corner + span for _, corner, span in kind.at("calf", reach).starts])
    for speed in (reach.speed, reach.slowest):
        assert np.any((no_load > 0.7 * speed) & (no_load < 0.95 * speed))


@pytest.mark.sample(1)
@pytest.mark.parametrize("side", [0.0, 1.0], ids=["encoder at the joint", "encoder at the motor"])
def test_play_shows_on_the_side_of_its_encoder(side: float) -> None:
    """At the hips.

    On which tooth a light calf lies, where little torque is asked for, is up to chance.
    """
    problem = problem_of(EFFECTS["backlash"](width=0.02, motor_side=side))
    play = [{}, {"backlash": (0.02, side)}, {"backlash": (0.02, 1.0 - side)}]
    hips = problem.residuals(np.stack([unknowns(problem, p) for p in play]))[
        ..., problem.signal == 0
    ]
    claimed, right, other = np.mean(hips**2, axis=(1, 2))
    assert claimed - right > 0.7 * (claimed - 1.0)
    assert other > 2.0 * right


@pytest.mark.parametrize("bend", [1e-5, 3e-4, 1e-3])
def test_bristles_hold_like_springs_until_they_give_way(bend: float) -> None:
    """A mass on bristles under a steady push rests where spring and push are equal.

    A larger push moves it on.
    """
    dt, mass, level = 0.002, 0.02, 0.5
    inverse, shape = np.full((1, 1, 1, 1, 1), 1.0 / mass), (1, 1, 1, 1)
    give = np.full(shape[1:], bend / (level * dt**2))
    ends = []
    for push in (0.6 * level, 1.2 * level):
        place, velocity, impulse, bent = (np.zeros(shape) for _ in range(4))
        for _ in range(1000):
            free = velocity + dt * (push - 0.3 * velocity) / mass
            velocity = rubbed(free, inverse, np.full(shape, dt * level), impulse, give, bent)
            bent, place = give * impulse, place + dt * velocity
        ends.append((float(place.item()), float(velocity.item())))
    assert ends[0] == pytest.approx((0.6 * bend, 0.0), rel=1e-3, abs=1e-7)
    assert ends[1][1] == pytest.approx(0.2 * level / 0.3, rel=1e-3)


def test_a_spring_is_its_pull_at_the_mean_angle_and_its_stiffness() -> None:
    """The unknowns that the parameters mean leave noise, and slopes there lead nowhere else."""
    hidden_spring = {"torque": 0.8, "stiffness": 0.5}
    problem = problem_of(JointSpring(**hidden_spring))
    right = unknowns(problem, {})
    own = [i for i, c in enumerate(problem.candidates) if c.effect == "joint_spring"]
    starts = np.cumsum([0, *(len(c.unknowns) for c in problem.candidates)])
    for i in own:
        right[:, starts[i] : starts[i + 1]] = problem.candidates[i].unknowns_of(hidden_spring)
    columns = np.concatenate([np.arange(starts[i], starts[i + 1]) for i in own])
    tries = np.repeat(right[None], 1 + len(columns), axis=0)
    tries[np.arange(len(columns)) + 1, :, columns] += 0.01
    at, *moved = problem.residuals(tries).reshape(len(tries), -1)
    assert np.mean(at**2) == pytest.approx(1.0, abs=0.12)
    slopes = (np.array(moved) - at) / 0.01
    error = np.linalg.solve(slopes @ slopes.T, slopes @ at).reshape(-1, 2)
    assert np.abs(error).max(axis=0) == pytest.approx([0.0, 0.0], abs=0.05)


def test_the_step_of_an_encoder_is_read_from_its_angles() -> None:
    coarse, fine = problem_of(COARSE.effect), problem_of()
    starts = [c.starts for c in coarse.candidates if c.effect == "encoder_quantisation"]
    assert all(step == pytest.approx(0.006, rel=1e-3) for place in starts for _, step in place)
    assert "grid_calf" in coarse.signals
    assert "grid_calf" not in fine.signals


@pytest.mark.parametrize("apart", [0.003, 0.006])
@pytest.mark.parametrize(("share", "is_step"), [(0.25, False), (0.5, False), (1.0, True)])
def test_equal_ways_between_rows_are_a_step_only_if_they_last(
    apart: float, share: float, is_step: bool
) -> None:
    """A joint at one speed is read at multiples of an angle, an encoder reads them at any speed."""
    rng = np.random.default_rng(1)
    angles = rng.uniform(-0.3, 0.3, 4000)
    even = slice(0, round(share * len(angles)))
    angles[even] = apart * np.round(angles[even] / apart)
    found = _step(angles + rng.normal(scale=3e-4, size=len(angles)))
    assert found == (pytest.approx(apart, rel=1e-3) if is_step else None)


def test_what_a_log_cannot_show_is_said_with_numbers() -> None:
    log = motion(kp=2.0)
    still = replace(
        log.joints, q=log.joints.q[:1] + 0.0 * log.joints.q, dq=0.0 * log.joints.q, tau_ff=None
    )
    untestable = JointProblem(noisy(replace(log, joints=still))).untestable
    assert untestable["feedforward_delay"] == "the log has no tau_ff"
    assert "Nm" in untestable["torque_saturation"]
    assert "rad/s" in untestable["torque_speed_limit"]
    assert set(problem_of().untestable) == {"end_stop", "voltage_sag"}


def test_absent_signals_and_rows_are_left_out() -> None:
    log = noisy(motion())
    q = log.joints.q.copy()
    q[1000:1020, 2] = np.nan
    table = replace(log.joints, q=q, dq=None, dq_des=None, tau_est=None)
    problem = JointProblem(replace(log, joints=table))
    residuals = problem.residuals(unknowns(problem, {})[None])
    assert problem.signals == ("q_hip", "q_thigh", "q_calf")
    assert np.isfinite(residuals).all()
    assert np.mean(residuals**2) == pytest.approx(1.0, abs=0.1)


def test_a_base_that_moves_is_refused() -> None:
    log = motion()
    with pytest.raises(RecordingError, match="held base"):
        JointProblem(replace(log, meta={**log.meta, "base": "free"}))


def test_what_a_profile_has_is_taken_from_its_values_exactly() -> None:
    check_stated_values(problem_of())


def test_physical_parameters_of_a_saturation() -> None:
    """With a sharp corner, loss and corner mean the knee and the plateau that the effect has."""
    problem = problem_of()
    candidate = next(
        c for c in problem.candidates if c.effect == "torque_saturation" and c.where == "calf"
    )
    found = candidate.parameters(np.array([0.4, 12.0, 0.05]))
    plateau = found["plateau"].value
    effect = TorqueSaturation(knee=found["knee"].value, plateau=(18.0, 18.0, plateau) * 4).fitted(
        ROBOT
    )
    torque = np.linspace(0.0, 35.0, 12)[:, None] * np.ones(12)
    expected = torque[:, 2] - 0.4 * np.maximum(torque[:, 2] - 12.0, 0.0)
    np.testing.assert_allclose(effect.delivered(torque)[:, 2], expected, atol=0.02)


def test_a_rounded_corner_follows_the_dynamometer() -> None:
    """The table of the original from 0 to 35 Nm, within 5 %, by least squares."""
    asked, given = np.array(((0.0, 0.0), *CURVE)).T
    torque = np.linspace(0.5, 35.0, 200)
    table = np.interp(torque, asked, given)
    fit = least_squares(
        lambda x: torque - lost(torque, *x) - table, x0=[0.4, 12.0, 1.0], bounds=(0.0, 40.0)
    )
    assert np.max(np.abs((torque - lost(torque, *fit.x)) / table - 1.0)) < 0.05


@pytest.mark.parametrize("level", [8.0, 15.0, 30.0])
def test_one_law_has_a_tanh_and_a_sharp_corner_at_its_ends(level: float) -> None:
    torque = np.linspace(0.0, 40.0, 200)
    tanh = torque - level * np.tanh(torque / level)
    np.testing.assert_allclose(lost(torque, 1.0, 1e-3 * level, 0.5 * level), tanh, atol=1e-4)
    sharp = 0.4 * np.maximum(torque - level, 0.0)
    np.testing.assert_allclose(lost(torque, 0.4, level, 1e-3), sharp, atol=1e-3)


@pytest.mark.parametrize("rounding", [0.05, 1.0, 20.0])
@pytest.mark.parametrize("corner", [1.0, 12.0, 34.0])
def test_a_small_torque_is_delivered_in_full_and_more_command_gives_more(
    corner: float, rounding: float
) -> None:
    """Else a saturation could pass for a drive that is weak at every torque."""
    torque = np.linspace(0.0, 40.0, 4001)
    loss = lost(torque, 1.0, corner, rounding)
    assert loss[0] == 0.0
    share = np.diff(loss) / np.diff(torque)
    assert abs(share[0]) < 1e-3
    assert np.all((share > -1e-9) & (share < 1.0 + 1e-9))
    assert np.all(np.diff(share) > -1e-9)


def test_the_dynamometers_table_from_a_log() -> None:
    """Large steps, more than 35 Nm commanded at the calf: the table of the original within 5 %."""
    problem = JointProblem(of_one_leg(noisy(motion(TorqueSaturation(curve=CURVE), kp=70.0))))
    assert problem.reach[2].torque > 35.0
    columns = np.concatenate(
        [np.r_[problem.columns_of("torque_saturation", place)] for place in PLACES]
    )
    value, step = (
        np.array([0.6, 13.0, 3.0, 0.6, 13.0, 3.0, 0.6, 18.0, 3.0]),
        np.tile([0.01, 0.2, 0.2], 3),
    )
    fitted = unknowns(problem, {})
    for _ in range(4):
        tries = np.repeat(fitted[None], 10, axis=0)
        tries[:, :, columns] = (value + np.concatenate([np.zeros((1, 9)), np.diag(step)]))[:, None]
        r = problem.residuals(tries).reshape(10, -1)
        slopes = (r[1:] - r[0]) / step[:, None]
        value -= np.linalg.solve(slopes @ slopes.T, slopes @ r[0])
    fitted[:, columns] = value
    pieces = _Pieces.of_model(problem, fitted)
    slopes, _ = _fitted(
        problem, fitted, pieces, np.ones((len(problem.blocks), len(problem.time_s)))
    )
    calf = list(problem.places[0]).index("calf")
    curve = np.array([(a, b) for a, b in pieces.curve(slopes, calf) if a <= 35.0])
    asked, given = np.array(((0.0, 0.0), *CURVE)).T
    np.testing.assert_allclose(curve[:, 1], np.interp(curve[:, 0], asked, given), rtol=0.05)


def of_one_leg(log: RunLog) -> RunLog:
    """The log of the first leg alone."""
    own = {
        name: getattr(log.joints, name)[:, :3]
        for name in JOINT_SIGNALS
        if getattr(log.joints, name) is not None
    }
    return replace(
        log, meta={**log.meta, "joints": list(JOINTS[:3])}, joints=replace(log.joints, **own)
    )


HIDDEN = (
    JointSpring(torque=0.5),
    JointSpring(torque=(0.0, 0.0, 2.0) * 4, stiffness=(0.0, 0.0, 1.0) * 4),
    VelocityScale(scale=1.12),
)


@pytest.mark.slow
@pytest.mark.parametrize("effect", HIDDEN, ids=lambda effect: effect.name)
def test_an_effect_that_a_robot_hides_is_found_by_its_name(effect: Effect[Any]) -> None:
    findings = search(JointProblem(of_one_leg(noisy(motion(effect)))))
    assert (findings.verdict, {found.name for found in findings.effects}) == (
        "named",
        {effect.name},
    )
    found = findings.effects[0]
    joint = 0 if found.where == "all" else JOINTS.index(found.where[0])
    for name, interval in found.params.items():
        true = np.broadcast_to(getattr(effect, name), 12)[joint]
        assert interval.value == pytest.approx(true, rel=0.05, abs=0.02), name


def of_motion(log: RunLog, condition: str) -> RunLog:
    """The rows of one motion."""
    own = [s for s in log.meta["excitation"]["segments"] if s["condition"] == condition]
    kept = (log.joints.time_s > own[0]["t0"] - 0.5 * DT) & (
        log.joints.time_s < own[-1]["t1"] - 0.5 * DT
    )
    values = {f.name: getattr(log.joints, f.name) for f in fields(log.joints)}
    return replace(
        log, joints=JointTable(**{n: None if v is None else v[kept] for n, v in values.items()})
    )


@pytest.mark.slow
def test_a_soft_end_stop_is_found_where_knees_lean_on_it() -> None:
    """0.1 rad before the model's limit, at -0.888 rad."""
    log = motion(EndStop(upper=(np.inf, np.inf, -0.99) * 4, stiffness=250.0), stretched=0.5)
    findings = search(JointProblem(of_one_leg(noisy(log))))
    ((name, where, found),) = [(e.name, e.where, e.params) for e in findings.effects]
    assert (findings.verdict, name, where) == ("named", "end_stop", ("FR_calf",))
    assert found["upper"].value == pytest.approx(-0.99, abs=0.005)
    assert found["stiffness"].value == pytest.approx(250.0, rel=0.1)


GIVES = (0.002, 0.05, 1.0)
"""Of what holds the base [rad/Nm]: a stand that sways by a degree, a strap, a thread."""


@pytest.mark.sample(1)
@pytest.mark.parametrize("give", GIVES)
def test_a_base_that_rolls_moves_the_legs_as_the_replay_says(give: float) -> None:
    problem = problem_of(BaseRoll(give=give, damping=0.2))
    (candidate,) = [c for c in problem.candidates if c.effect == "base_roll"]
    truth = candidate.unknowns_of({"give": give, "damping": 0.2})
    gap, left = problem.residuals(
        np.stack([unknowns(problem, {}), unknowns(problem, {"base_roll": tuple(truth)})])
    )
    assert np.mean(left**2) < 0.01 * np.mean(gap**2)


@pytest.mark.slow
def test_a_base_that_rolls_is_found() -> None:
    findings = search(
        JointProblem(of_motion(noisy(motion(BaseRoll(give=0.05, damping=0.2))), "chirp"))
    )
    ((name, where, found),) = [(e.name, e.where, e.params) for e in findings.effects]
    assert (findings.verdict, name, where) == ("named", "base_roll", "all")
    assert found["give"].value == pytest.approx(0.05, rel=0.1)
    assert found["damping"].value == pytest.approx(0.2, rel=0.2)


def test_a_base_is_not_accused_where_joints_are_missing() -> None:
    assert "not all joints" in JointProblem(of_one_leg(noisy(motion()))).untestable["base_roll"]


@pytest.mark.slow
def test_an_integral_term_is_no_spring() -> None:
    """It pulls much as one does, and is in no library."""
    findings = search(JointProblem(of_one_leg(noisy(motion(integral=4.0)))))
    assert findings.verdict == "unexplained"
    assert {found.name for found in findings.nearest} == {"joint_spring"}


def test_effects_that_a_motion_cannot_tell_apart_come_as_a_set() -> None:
    """A slow motion near one pose asks an encoder bias and a pull for the same torque."""
    slow = of_motion(noisy(motion(EncoderBias(bias=0.1))), "triangle")
    (alike,) = search(JointProblem(of_one_leg(slow))).sets
    assert {"encoder_bias", "joint_spring"} <= set(alike)


@pytest.mark.parametrize("stretched", [0.0, pytest.param(0.5, marks=pytest.mark.slow)])
def test_an_ideal_robot_is_not_accused(stretched: float) -> None:
    """Also where its knees hit the limits that the model claims."""
    assert search(JointProblem(of_one_leg(noisy(motion(stretched=stretched))))).verdict == "no_gap"
