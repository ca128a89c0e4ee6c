"""The whole way: hidden in a robot, found in its log, applied, and gone.

One sensor's failure is its own.
"""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from samples import ROBOT

from saltus.effects.image_delivery import CameraLatency
from saltus.effects.joint_loads import ViscousFriction
from saltus.effects.motors import TorqueSpeedLimit
from saltus.effects.profile import IDEAL, Profile
from saltus.errors import RecordingError
from saltus.real2sim.experiments import motions
from saltus.real2sim.experiments.menu import EXPERIMENTS
from saltus.real2sim.experiments.run import run_experiment
from saltus.real2sim.patch import load_patch
from saltus.real2sim.pipeline import examine_logs, find_in_logs, judge_logs
from saltus.real2sim.problem.log import load_rigs, segments_of
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.reporting.verdict_text import verdict_sentence
from saltus.real2sim.sensors import SENSORS
from saltus.real2sim.stacked_problem import RebasedProblem
from saltus.real2sim.verdict import Verdict
from saltus.recordings.run_log import RunLog, write_run_log

CALVES = (0.0, 0.0, 0.2) * 4
STIFF = Profile(actuator=(ViscousFriction(coefficient=CALVES),))
HELD = dataclasses.replace(
    EXPERIMENTS["joint_chirp"],
    sections=lambda robot: motions.repeat_motion(
        "chirp", 2, motions.sweep(robot, 2.0, 0.5, 8.0, 0.35)
    ),
)
SEEING = dataclasses.replace(
    EXPERIMENTS["heave_and_pitch"],
    sections=lambda robot: motions.repeat_motion(
        "rock", 2, motions.body_chirp(robot, 2.0, 0.5, 4.0, pitch_rad=0.1)
    ),
)


@pytest.fixture(scope="module")
def held() -> RunLog:
    return run_experiment(HELD, ROBOT, STIFF, seed=5)


@pytest.fixture(scope="module")
def seeing() -> RunLog:
    return run_experiment(SEEING, ROBOT, Profile(camera=(CameraLatency(latency=0.03),)), seed=5)


@dataclasses.dataclass(frozen=True)
class Found:
    """The result of `find_in_logs` for a log."""

    log: Path
    out: Path
    stages: list[float]
    verdict: Verdict


@pytest.fixture(scope="module")
def found(held: RunLog, tmp_path_factory: pytest.TempPathFactory) -> Found:
    log, out, stages = tmp_path_factory.mktemp("log") / "run", tmp_path_factory.mktemp("out"), []
    write_run_log(held, log)
    judgement = find_in_logs([log], out, progress=lambda _stage, share: stages.append(share))
    return Found(log, out, stages, judgement.verdict)


def test_what_was_hidden_is_found_and_after_the_patch_nothing_is(
    found: Found, tmp_path: Path
) -> None:
    first = found.verdict
    assert first.verdict == "named"
    (effect,) = first.effects
    assert effect.name == "viscous_friction"
    assert effect.where == ("FR_calf", "FL_calf", "RR_calf", "RL_calf")
    assert effect.params["coefficient"].value == pytest.approx(0.2, rel=0.05)
    assert "viscous_friction" in verdict_sentence(first)
    assert found.stages == sorted(found.stages)
    assert found.stages[-1] == 1.0
    assert json.loads((found.out / "verdict.json").read_text()) == first.to_dict()
    assert set(json.loads((found.out / "baselines.json").read_text())) == {
        "threshold",
        "lowest_training_error",
    }
    profile = load_patch(found.out / "patch.toml").applied_to(IDEAL, ROBOT)
    second = find_in_logs([found.log], tmp_path, profile=profile).verdict
    assert second.verdict == "no_gap"
    assert load_patch(tmp_path / "patch.toml").applied_to(IDEAL, ROBOT) == IDEAL
    assert "agrees" in verdict_sentence(second)


def test_a_simulator_with_the_effects_of_the_robot_leaves_noise(held: RunLog) -> None:
    inner = next(sensor for sensor in SENSORS if sensor.name == "joints").problem(held)
    nothing = np.zeros((1, len(inner.blocks), sum(len(c.unknowns) for c in inner.candidates)))
    with_effects = RebasedProblem(inner, STIFF)
    assert np.mean(with_effects.residuals(nothing) ** 2) == pytest.approx(1.0, abs=0.1)
    assert np.mean(inner.residuals(nothing) ** 2) > 2.0
    friction = next(
        c for c in with_effects.candidates if (c.effect, c.where) == ("viscous_friction", "calf")
    )
    assert friction.parameters(np.zeros(1))["coefficient"].value == pytest.approx(0.2)
    np.testing.assert_array_equal(
        RebasedProblem(inner, IDEAL).residuals(nothing), inner.residuals(nothing)
    )


def test_a_speed_limit_in_a_profile_is_there_altogether(held: RunLog) -> None:
    inner = next(sensor for sensor in SENSORS if sensor.name == "joints").problem(held)
    robot = Profile(actuator=(TorqueSpeedLimit(corner=0.2, no_load=1.0),))
    unknowns = np.zeros((1, len(inner.blocks), sum(len(c.unknowns) for c in inner.candidates)))
    with_limit = RebasedProblem(inner, robot).residuals(unknowns)
    at = 0
    for candidate in inner.candidates:
        if candidate.effect == "torque_speed_limit":
            # Weight, corner, and from there to the no-load speed
            unknowns[..., at : at + 3] = (
                1.0,
                0.2,
                0.8,
            )
        at += len(candidate.unknowns)
    np.testing.assert_allclose(with_limit, inner.holding(robot)[0].residuals(unknowns), atol=1e-3)
    assert np.mean(with_limit**2) > 1.2 * np.mean(inner.residuals(0.0 * unknowns) ** 2)


def test_an_effect_that_no_sensor_shows_is_untestable_and_says_why(found: Found) -> None:
    untestable = found.verdict.untestable
    assert untestable["camera_latency"] == "no depth images"
    assert untestable["payload_mass"] == "the base is held"
    assert "viscous_friction" not in untestable


def test_a_sensor_that_fails_does_not_lose_the_others(seeing: RunLog) -> None:
    def broken(log: RunLog) -> Problem:
        raise ValueError("a bad day")

    kept = {"camera"}
    sensors = [s if s.name in kept else dataclasses.replace(s, problem=broken) for s in SENSORS]
    (examined,) = examine_logs([seeing], sensors=sensors)
    verdict = judge_logs((examined,), ()).verdict
    assert len(examined.failures) == 2
    assert any("a bad day" in fault for fault in verdict.log_faults)
    assert "a bad day" in verdict.untestable["payload_mass"]
    assert verdict.verdict in ("named", "set")
    assert "camera_latency" in {e.name for e in verdict.effects} | {
        name for names in verdict.sets for name in names
    }
    none = [dataclasses.replace(sensor, problem=broken) for sensor in SENSORS]
    with pytest.raises(RecordingError, match="a bad day"):
        judge_logs(examine_logs([seeing], sensors=none), ())


def test_a_damaged_log_is_judged_by_nothing_else(held: RunLog) -> None:
    degrees = dataclasses.replace(
        held, joints=dataclasses.replace(held.joints, q=np.rad2deg(held.joints.q))
    )
    (examined,) = examine_logs([degrees])
    judgement = judge_logs((examined,), ())
    assert judgement.verdict.verdict == "bad_log"
    assert not examined.comparisons
    assert not judgement.patch.effects
    assert verdict_sentence(judgement.verdict).startswith("The log contradicts itself")


def test_runs_of_different_rigs_are_compared_apart(
    held: RunLog, seeing: RunLog, tmp_path: Path
) -> None:
    for name, log in (("a", held), ("b", seeing), ("c", held)):
        write_run_log(log, tmp_path / name)
    both, other = load_rigs([tmp_path / name for name in "abc"])
    assert {segment.name.split("/")[0] for segment in segments_of(both)} == {"a", "c"}
    assert len(other.joints.q) == len(seeing.joints.q)
