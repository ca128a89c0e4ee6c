"""Laws of the body problem, on logs of the plant."""

import dataclasses

import numpy as np
import pytest
from samples import ROBOT
from standing_robot import Motion, run_log
from stated_values import check_stated_values

from saltus.effects.body import ComOffset, FootFriction, PayloadMass, SoftFeet
from saltus.effects.effect import Effect
from saltus.effects.joint_loads import EndStop, JointSpring
from saltus.effects.motors import TorqueSaturation, TorqueSpeedLimit
from saltus.effects.profile import Profile
from saltus.errors import RecordingError
from saltus.real2sim.problem.body import problem as body_problem
from saltus.real2sim.problem.body.problem import BodyProblem
from saltus.real2sim.problem.body.replay import FINE, GROUNDS, likeliest_solver
from saltus.real2sim.problem.body.windows import body_windows
from saltus.real2sim.problem.log import segments_of
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.sensors import SENSORS, carried_by
from saltus.real2sim.stacked_problem import NOT_HELD, RebasedProblem
from saltus.recordings.run_log import RunLog
from saltus.sim.free_robots import ContactSolver

STAND = (Motion(name="stand", duration_s=0.7),)
SHORT = (
    Motion(name="squat", duration_s=1.0, frequency_hz=2.0, z=0.04),
    Motion(name="pitch", duration_s=1.0, frequency_hz=2.0, pitch=0.15),
)


def at(problem: Problem, **values: float) -> np.ndarray:
    """Residuals, shape (m,), with some unknowns off 0; "__" stands for the dot in a name."""
    unknowns = np.array([start for c in problem.candidates for start in c.starts[0]])
    for name, value in values.items():
        unknowns[problem.names.index(name.replace("__", "."))] = value
    return problem.residuals(unknowns[None, None])[0, 0]


@pytest.fixture(scope="module")
def claimed() -> BodyProblem:
    return BodyProblem(run_log(motions=STAND + SHORT[:1]))


@pytest.fixture(scope="module")
def standing() -> BodyProblem:
    """A stand on a ground that the log claims; how contacts are computed is not asked."""
    log = run_log(motions=STAND * 2)
    ground = {"friction": 0.6, "contact_time_constant": 0.01}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(body_problem, "likeliest_solver", lambda _: GROUNDS[0])
        return BodyProblem(dataclasses.replace(log, meta={**log.meta, "ground": ground}))


def test_residuals_are_noise_where_the_model_is_right(claimed: BodyProblem) -> None:
    residuals = at(claimed)
    assert 0.4 < np.mean(residuals**2) < 1.15
    assert residuals.shape == claimed.segment.shape == claimed.signal.shape == claimed.time_s.shape


@pytest.mark.parametrize("delay_s", [0.0, 0.01, 0.02, 0.04, 0.05])
def test_simulations_start_at_the_rates_that_a_late_gyroscope_tells(delay_s: float) -> None:
    log = run_log(motions=(dataclasses.replace(SHORT[1], duration_s=4.0),))
    assert log.imu is not None
    late = dataclasses.replace(log.imu, time_s=log.imu.time_s + delay_s)
    own, other = (
        body_windows(each, segments_of(log)).qvel[:, 3:6]
        for each in (log, dataclasses.replace(log, imu=late))
    )
    assert np.abs(own).max() > 1.0
    np.testing.assert_allclose(other, own, atol=0.1)  # 5 ms at the most that they change


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("effect", "name", "value"),
    [
        (PayloadMass(mass=0.5), "payload_mass__mass", 0.5),
        (ComOffset(x=0.01), "com_offset__x", 0.01),
        (FootFriction(coefficient=0.1), "foot_friction__less", 0.7),
    ],
    ids=lambda value: str(getattr(value, "name", "")),
)
def test_the_true_effect_removes_the_gap(effect: Effect, name: str, value: float) -> None:
    problem = BodyProblem(run_log([effect], motions=SHORT[:1]))
    gap, closed = np.mean(at(problem) ** 2), np.mean(at(problem, **{name: value}) ** 2)
    assert gap > 1.5 * closed
    assert closed < 1.2
    assert np.mean(at(problem, **{name: 0.7 * value}) ** 2) > closed


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect",
    [
        TorqueSaturation(curve=((3.0, 3.0), (10.0, 9.0))),
        TorqueSpeedLimit(corner=0.0, no_load=2.5),
        JointSpring(torque=-2.0, stiffness=5.0),
        EndStop(upper=tuple(ROBOT.stand_pose + 0.05), stiffness=50.0),
    ],
    ids=lambda effect: effect.name,
)
def test_a_simulator_with_what_drives_have_leaves_noise(effect: Effect) -> None:
    """Also where no unknown of the body says it."""
    problem = BodyProblem(run_log([effect], motions=SHORT[:1]))
    held = RebasedProblem(problem, Profile(actuator=(effect,)))
    gap, closed = np.mean(at(problem) ** 2), np.mean(at(held) ** 2)
    assert gap > 1.5 * closed
    assert closed < 1.2


@pytest.mark.parametrize("substeps", [1, FINE])
@pytest.mark.parametrize("true", GROUNDS)
@pytest.mark.parametrize(
    "ground", [(1.0, 1.0, 0.0), (1.4, 1.0, 0.0), (3.5, 1.0, 0.0), (1.0, 0.3, 0.0), (1.0, 1.0, 0.02)]
)
def test_soft_or_slippery_ground_is_not_taken_for_another_way_to_compute_contacts(
    true: ContactSolver, ground: tuple[float, float, float], substeps: int
) -> None:
    """A wrong way explains as little on any ground, the right one less where the ground is a tenth
    off, and with another step of time nearly as much.
    """
    true = dataclasses.replace(true, substeps=substeps)

    def squares(solver: ContactSolver, others: np.ndarray) -> np.ndarray:
        off = np.log((others + 0.01) / (np.array(ground) + 0.01))
        right = 1.0 + 100.0 * np.sum(off**2, axis=1)
        is_near = dataclasses.replace(solver, substeps=substeps) == true
        left = right * (1.0 if solver == true else 1.2) if is_near else np.full(len(others), 1.5)
        return np.asarray(left[:, None] * np.ones(3))

    assert likeliest_solver(squares) == true


@pytest.mark.parametrize("seed", range(5))
def test_no_other_way_to_compute_contacts_is_taken_by_chance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    left = {way: 2.0 * np.exp(0.03 * rng.standard_normal(9)) for way in GROUNDS}

    def squares(solver: ContactSolver, others: np.ndarray) -> np.ndarray:
        return np.tile(left[dataclasses.replace(solver, substeps=1)], (len(others), 1))

    assert likeliest_solver(squares) == GROUNDS[0]


@pytest.mark.slow
def test_feet_that_resist_rolling_close_the_gap() -> None:
    """But for what the choice of the contact solver leaves,
    which is made before anything is fitted.
    """
    problem = BodyProblem(run_log([SoftFeet(rolling=0.01)], motions=SHORT[:1]))
    gap, less, closed = (
        np.mean(at(problem, soft_feet__rolling=value) ** 2) for value in (0.0, 0.007, 0.01)
    )
    assert closed < less < gap
    assert closed - 1.0 < 0.05 * (gap - 1.0)


def test_a_profile_whose_feet_stiffen_as_no_replay_does_is_not_dropped_silently(
    claimed: BodyProblem,
) -> None:
    feet = [SoftFeet(rolling=0.01), SoftFeet(rolling=0.01, touch=0.1)]
    held, lost = (RebasedProblem(claimed, Profile(body=(each,))) for each in feet)
    assert "soft_feet" not in set(held.untestable) - set(claimed.untestable)
    assert lost.untestable["soft_feet"] == NOT_HELD


def test_what_a_profile_has_is_taken_from_its_values_exactly(claimed: BodyProblem) -> None:
    check_stated_values(claimed)


def test_sets_of_unknowns_do_not_mix(claimed: BodyProblem) -> None:
    start = np.array([s for c in claimed.candidates for s in c.starts[0]])
    sets = np.tile(start, (3, 1, 1))
    sets[1, 0, claimed.names.index("payload_mass.mass")] = 1.0
    sets[2, 0, claimed.names.index("soft_feet.rolling")] = 0.01
    together = claimed.residuals(sets)
    for one, alone in zip(sets, together, strict=True):
        np.testing.assert_allclose(claimed.residuals(one[None])[0], alone, atol=1e-6)


def test_a_stand_cannot_show_what_needs_slip_or_flight(standing: BodyProblem) -> None:
    assert "base_inertia" in standing.untestable
    assert "flight" in standing.untestable["base_inertia"]
    assert "payload_mass" not in standing.untestable


def test_a_robot_that_is_carried_poses_no_body_problem() -> None:
    log = run_log(motions=STAND)
    assert carried_by(log) == pytest.approx(1.0, abs=0.1)
    assert not lacks("body", log)
    carried = dataclasses.replace(
        log, joints=dataclasses.replace(log.joints, q_des=log.joints.q, dq=None)
    )
    assert "0% of its weight" in lacks("body", carried)
    assert lacks("joints", log)
    assert lacks("joints", carried)


def test_effects_on_the_ground_count_from_what_the_log_claims(standing: BodyProblem) -> None:
    by_name = {c.effect: c for c in standing.candidates}
    none = np.zeros(1)
    assert by_name["foot_friction"].parameters(none)["coefficient"].value == pytest.approx(0.6)
    assert by_name["contact_compliance"].parameters(none)["time_constant"].value == pytest.approx(
        0.01
    )


def lacks(name: str, log: RunLog) -> str:
    return next(sensor for sensor in SENSORS if sensor.name == name).lacks(log)


def test_without_a_measured_base_there_is_no_problem() -> None:
    log = run_log(motions=STAND, base=False)
    with pytest.raises(RecordingError, match=r"base\.csv"):
        BodyProblem(log)
