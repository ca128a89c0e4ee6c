"""Laws of the IMU problem, on logs of the plant."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares
from standing_robot import MOTIONS, run_log
from stated_values import check_stated_values

from saltus.effects.effect import Effect
from saltus.effects.imu import ImuBias, ImuLatency
from saltus.errors import RecordingError
from saltus.real2sim.problem.imu import ImuProblem
from saltus.recordings.run_log import RunLog

MOVING = MOTIONS[3:7]


def fitted(problem: ImuProblem) -> dict[str, float]:
    """All unknowns at the least squares."""
    names = [f"{c.effect}.{u.name}" for c in problem.candidates for u in c.unknowns]
    scale = [u.scale for c in problem.candidates for u in c.unknowns]
    result = least_squares(
        lambda x: problem.residuals(x[None, None])[0, 0], np.zeros(len(names)), x_scale=scale
    )
    return dict(zip(names, result.x.tolist(), strict=True))


def held(log: RunLog) -> RunLog:
    """As if the base had been held."""
    return dataclasses.replace(log, meta={**log.meta, "base": "fixed"}, base=None)


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "effects",
    [
        (),
        (ImuBias(gyro_x=0.02, gyro_z=-0.01, roll=0.01, pitch=-0.02),),
        (ImuLatency(delay=0.006),),
        (ImuBias(gyro_y=0.02, pitch=0.02), ImuLatency(delay=0.008)),
    ],
    ids=["none", "bias", "latency", "both"],
)
def test_fit_recovers_what_is_hidden(effects: tuple[Effect, ...]) -> None:
    problem = ImuProblem(run_log(effects, motions=MOVING))
    check_stated_values(problem)
    found = fitted(problem)
    true = {
        f"{e.name}.{f.name}": getattr(e, f.name) for e in effects for f in dataclasses.fields(e)
    }
    tolerance = {"imu_latency.delay": 5e-4, "imu_bias.roll": 1e-3, "imu_bias.pitch": 1e-3}
    for name, value in found.items():
        if name.startswith("imu_"):
            assert value == pytest.approx(true.get(name, 0.0), abs=tolerance.get(name, 3e-3)), name
    residuals = problem.residuals(np.array([list(found.values())])[None])[0, 0]
    assert np.mean(residuals**2) == pytest.approx(1.0, abs=0.15)


def test_a_held_base_shows_bias_but_no_latency() -> None:
    problem = ImuProblem(held(run_log((ImuBias(gyro_x=0.02, roll=0.02),), motions=MOTIONS[:1] * 2)))
    assert "turns at most" in problem.untestable["imu_latency"]
    assert "imu_bias" not in problem.untestable
    unknowns = np.zeros((2, 1, sum(len(c.unknowns) for c in problem.candidates)))
    unknowns[1, 0, [0, 3]] = 0.02
    gap, closed = np.mean(problem.residuals(unknowns) ** 2, axis=(1, 2))
    assert gap > 3.0 * closed


def test_a_free_base_that_is_not_measured_is_an_error() -> None:
    with pytest.raises(RecordingError, match=r"base\.csv"):
        ImuProblem(run_log(motions=MOTIONS[:1], base=False))
