"""Power of the joints in each motion of a recorded run."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from saltus.effects.motors import VoltageSag
from saltus.recordings.summary import motion_powers
from saltus.robots.robot import JOINTS
from saltus.wire.messages import ControllerMode, JointLog

MODES = (ControllerMode.STAND, ControllerMode.RUN, ControllerMode.LANDING)


@pytest.mark.parametrize("seed", range(10))
def test_each_motion_has_the_power_of_its_own_ticks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    steps = int(rng.integers(5, 30))
    modes = [MODES[int(number)] for number in rng.integers(len(MODES), size=steps)]
    torque, speed = rng.normal(size=(2, steps, 5, 12))
    logs = [
        SimpleNamespace(step=step, dt_s=0.002, torque_estimated=torque[step], velocity=speed[step])
        for step in range(steps)
    ]
    states = [SimpleNamespace(step=step, mode=modes[step]) for step in range(steps)]
    sag = VoltageSag(per_kw=float(rng.uniform(0.0, 2.0)))
    recording = SimpleNamespace(
        of=lambda kind: logs if kind is JointLog else states,
        setup=SimpleNamespace(profile=SimpleNamespace(actuator=(sag,))),
    )
    powers = motion_powers(cast(Any, recording))
    assert [each.motion for each in powers] == [m.name.lower() for m in dict.fromkeys(modes)]
    for each in powers:
        own = [step for step in range(steps) if modes[step].name.lower() == each.motion]
        ticks = (torque[own] * speed[own]).reshape(-1, 12)
        assert each.seconds == pytest.approx(0.002 * len(ticks))
        assert each.peak_w == pytest.approx(max(sum(row) for row in ticks))
        asked_w = max(sum(row[row > 0.0]) for row in ticks)
        assert each.voltage_left == pytest.approx(1.0 / (1.0 + 1e-3 * sag.per_kw * asked_w))
        driving = [max(sum(row), 0.0) for row in ticks]
        assert each.driving_w == pytest.approx(sum(driving) / len(driving))
        assert each.joint_w == pytest.approx(ticks.max())
        assert each.joint == JOINTS[int(np.unravel_index(ticks.argmax(), ticks.shape)[1])]


def test_a_run_without_joints_has_none() -> None:
    assert motion_powers(cast(Any, SimpleNamespace(of=lambda _: []))) == ()
