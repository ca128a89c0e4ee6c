"""Where a gap lies: what was put in is said, for the right joints, and nothing is said of noise."""

import numpy as np
import pytest
from rig_logs import Rig, joints_log

from saltus.real2sim.problem.problem import ExplanatoryVariable
from saltus.real2sim.reporting.localise import (
    ResidualSignal,
    explanatory_variables_of,
    in_words,
    localise_gap,
)
from saltus.robots.robot import JOINTS

ROWS = 3000


def _channels(seed: int, gap: str, kind: str, size: float) -> list[ResidualSignal]:
    """Residuals of unit noise; those of one kind of joint have a gap that `gap` tells."""
    rng = np.random.default_rng(seed)
    time_s = np.linspace(0, 30, ROWS)
    channels = []
    for joint in JOINTS:
        torque = 20 * np.sin(2 * np.pi * rng.uniform(0.3, 3) * time_s + rng.uniform(0, 6))
        speed = 5 * np.sin(2 * np.pi * rng.uniform(0.3, 3) * time_s + rng.uniform(0, 6))
        variables = (
            ExplanatoryVariable(name="torque", unit="Nm", values=torque),
            ExplanatoryVariable(name="velocity", unit="rad/s", values=speed),
            ExplanatoryVariable(name="the direction of motion", unit="", values=np.sign(speed)),
            ExplanatoryVariable(name="time in the run", unit="s", values=time_s),
            ExplanatoryVariable(name="a constant", unit="", values=np.ones(ROWS)),
        )
        shape = {
            "torque": torque / 20,
            "velocity": speed / 5,
            "the direction of motion": np.sign(speed),
            "a constant": np.ones(ROWS),
            "beyond": np.where(np.abs(torque) > 15, np.sign(torque), 0),
        }[gap]
        residual = rng.normal(size=ROWS) + (size * shape if joint.endswith(kind) else 0)
        channels.append(
            ResidualSignal(signal="q", place=joint, residual=residual, variables=variables)
        )
    return channels


@pytest.mark.parametrize("gap", ["torque", "velocity", "the direction of motion", "a constant"])
def test_what_a_residual_grows_with_is_said_of_the_joints_that_have_it(gap: str) -> None:
    first = localise_gap(_channels(1, gap, "calf", 3.0))[0]
    assert first.variable == gap
    assert first.text.startswith("calf joints: q")
    assert set(first.places) == {joint for joint in JOINTS if joint.endswith("calf")}
    assert first.share > 0.5


def test_the_threshold_beyond_which_a_gap_lies_is_found() -> None:
    said = [
        s for s in localise_gap(_channels(2, "beyond", "calf", 4.0)) if "where |torque|" in s.text
    ]
    assert said
    assert said[0].text.startswith("calf joints")
    threshold = float(said[0].text.split("is above ")[1].split(" ")[0])
    assert threshold == pytest.approx(15, abs=1.5)


def test_a_regime_is_said_as_one() -> None:
    rng = np.random.default_rng(5)
    turning = (np.arange(ROWS) % 100 < 15).astype(float)
    variable = ExplanatoryVariable(
        name="just after reversals", unit="", values=turning, is_regime=True
    )
    residual = rng.normal(size=ROWS) * (1 + 3 * turning)
    (said,) = localise_gap(
        [ResidualSignal(signal="q", place="FR_hip", residual=residual, variables=(variable,))]
    )
    assert said.text.startswith("FR_hip: q is off by 3.9 sigma")
    assert "just after reversals, by 1.0 elsewhere" in said.text


def test_nothing_is_said_of_noise_even_if_it_is_coloured() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        channels = _channels(seed, "torque", "none", 0.0)
        for channel in channels:
            coloured = np.convolve(rng.normal(size=ROWS), np.ones(10), mode="same")
            channel.residual[:] = coloured
        assert localise_gap(channels) == ()


@pytest.mark.parametrize(
    ("named", "words"),
    [
        (JOINTS, "all joints"),
        (JOINTS[2::3], "calf joints"),
        (JOINTS[3:6], "FL leg"),
        (("FR_hip",), "FR_hip"),
        (("FR_hip", "RL_calf"), "FR_hip, RL_calf"),
        (JOINTS[1::3] + JOINTS[2::3], "calf, thigh joints"),
    ],
)
def test_places_in_words(named: tuple[str, ...], words: str) -> None:
    assert in_words(named, JOINTS) == words


def test_drivers_of_a_log_are_those_of_its_motion() -> None:
    log = joints_log(Rig(coulomb=0.3), seconds=4.0)
    times = np.linspace(0.1, 3.9, 500)
    variables = {
        variable.name: variable.values
        for variable in explanatory_variables_of(log, "FR_thigh", times)
    }
    assert log.joints.tau_est is not None
    np.testing.assert_allclose(
        variables["torque"], np.interp(times, log.joints.time_s, log.joints.tau_est[:, 1])
    )
    assert set(np.unique(np.sign(variables["the direction of motion"]))) == {-1.0, 0.0, 1.0}
    assert 0 < np.mean(variables["just after reversals"]) < 0.5
    assert (
        np.corrcoef(np.gradient(variables["velocity"], times), variables["acceleration"])[0, 1]
        > 0.5
    )
