"""The problem of the joints, on logs of the plant with effects hidden in it."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from joint_logs import DT, KP, motion, noisy, of_one_leg
from samples import CURVE, ROBOT
from scipy.optimize import least_squares
from stated_values import check_stated_values

from saltus.arrays import Floats
from saltus.effects.body import BaseRoll
from saltus.effects.effect import Effect
from saltus.effects.joint_loads import JointSpring
from saltus.effects.motors import TorqueSaturation
from saltus.effects.profile import EFFECTS
from saltus.errors import RecordingError
from saltus.real2sim.problem.joints import uniform_log as joint_motion
from saltus.real2sim.problem.joints.candidates import KINDS, LOOP_RATE, LogRange
from saltus.real2sim.problem.joints.drives import JointDrives, lost_to_saturation
from saltus.real2sim.problem.joints.excitation import _step
from saltus.real2sim.problem.joints.joint_mechanics import bristle_slip, slowed_by_friction
from saltus.real2sim.problem.joints.problem import JointProblem
from saltus.real2sim.problem.joints.replay import replay_windows
from saltus.real2sim.saturation_curve import _fitted, _Pieces

PLACES = ("hip", "thigh", "calf")


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


def simulated(problem: JointProblem, drives: JointDrives) -> np.ndarray:
    """Means of angles, velocities and torques, as the problem replays them."""
    return replay_windows(problem._motion, problem._windows, drives, problem._averaged)


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


@pytest.mark.sample(2)
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


@pytest.mark.sample(2)
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
    reach = LogRange(
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
            velocity = slowed_by_friction(
                free, inverse, np.full(shape, dt * level), impulse, give, bent
            )
            bent, place = give * impulse, place + dt * velocity
        ends.append((float(place.item()), float(velocity.item())))
    assert ends[0] == pytest.approx((0.6 * bend, 0.0), rel=1e-3, abs=1e-7)
    assert ends[1][1] == pytest.approx(0.2 * level / 0.3, rel=1e-3)


@pytest.mark.parametrize("step", [0.01, 0.3, 2.0])
def test_bristles_slip_as_dahl_says_whatever_the_step(step: float) -> None:
    """And hold no more than their level once they have gone far, also back."""
    give, bent = np.full(1, 3.0), np.zeros(1)
    for way in (step, -step):
        before, to = bent[0], -np.sign(way)
        for k in range(1, round(6.0 / step) + 1):
            softer, older = bristle_slip(give, bent, np.full(1, step))
            bent = give * (older - way) / softer
            assert bent[0] == pytest.approx(to + (before - to) * np.exp(-k * step), abs=1e-9)


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
        lambda x: torque - lost_to_saturation(torque, *x) - table,
        x0=[0.4, 12.0, 1.0],
        bounds=(0.0, 40.0),
    )
    assert np.max(np.abs((torque - lost_to_saturation(torque, *fit.x)) / table - 1.0)) < 0.05


@pytest.mark.parametrize("level", [8.0, 15.0, 30.0])
def test_one_law_has_a_tanh_and_a_sharp_corner_at_its_ends(level: float) -> None:
    torque = np.linspace(0.0, 40.0, 200)
    tanh = torque - level * np.tanh(torque / level)
    np.testing.assert_allclose(
        lost_to_saturation(torque, 1.0, 1e-3 * level, 0.5 * level), tanh, atol=1e-4
    )
    sharp = 0.4 * np.maximum(torque - level, 0.0)
    np.testing.assert_allclose(lost_to_saturation(torque, 0.4, level, 1e-3), sharp, atol=1e-3)


@pytest.mark.parametrize("rounding", [0.05, 1.0, 20.0])
@pytest.mark.parametrize("corner", [1.0, 12.0, 34.0])
def test_a_small_torque_is_delivered_in_full_and_more_command_gives_more(
    corner: float, rounding: float
) -> None:
    """Else a saturation could pass for a drive that is weak at every torque."""
    torque = np.linspace(0.0, 40.0, 4001)
    loss = lost_to_saturation(torque, 1.0, corner, rounding)
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
