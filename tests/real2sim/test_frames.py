"""Columns of IMU and base that are of other axes, or in another frame."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from rig_logs import body_log
from samples import ROBOT
from scipy.spatial.transform import Rotation

from saltus.effects.profile import IDEAL
from saltus.real2sim.experiments.menu import experiment_named
from saltus.real2sim.experiments.run import run_experiment
from saltus.real2sim.screening.base_faults import rig_faults
from saltus.recordings.run_log import RunLog


@pytest.fixture(scope="module")
def logs() -> list[RunLog]:
    """Logs of a body that heaves, rocks and turns, and of a robot that rocks."""
    rocking = run_experiment(experiment_named("pitch_rocking"), ROBOT, IDEAL, seed=3)
    return [body_log(seconds=4.0), rocking]


@pytest.mark.parametrize("order", list(permutations(range(3)))[1:])
def test_gyroscopes_whose_axes_are_exchanged_are_told(
    logs: list[RunLog], order: tuple[int, int, int]
) -> None:
    for log, turning in zip(logs, ("yz", "y"), strict=True):
        if order["xyz".index(turning[0])] == "xyz".index(turning[0]):
            continue  # the axis about which it turns most is at its place
        assert log.imu is not None
        values = log.imu.values.copy()
        values[:, 4:7] = values[:, [4 + axis for axis in order]]
        (fault,) = rig_faults(replace(log, imu=replace(log.imu, values=values)))
        assert fault.is_fatal
        assert fault.name == "imu_axes"
        for axis, shown in zip("xyz", ("xyz"[own] for own in order), strict=True):
            said = f"{axis} shows turns about {shown}" in fault.text
            assert said == (axis != shown and shown in turning), fault.text


@pytest.mark.parametrize("heading", [0.5, 1.6, np.pi, -2.5])
def test_a_velocity_in_the_frame_of_the_base_is_told(logs: list[RunLog], heading: float) -> None:
    turned = Rotation.from_euler("z", heading)
    for log in logs:
        assert log.base is not None
        values = log.base.values.copy()
        values[:, 0] += 0.3 * log.base.time_s  # carried ahead at 0.3 m/s
        values[:, 7] += 0.3
        own = turned * Rotation.from_quat(values[:, 3:7], scalar_first=True)
        values[:, 3:7] = own.as_quat(scalar_first=True)
        for columns in (slice(0, 3), slice(7, 10)):
            values[:, columns] = turned.apply(values[:, columns])
        there = replace(log, imu=None, base=replace(log.base, values=values))
        assert not rig_faults(there)
        values = values.copy()
        values[:, 7:10] = own.inv().apply(values[:, 7:10])
        (fault,) = rig_faults(replace(there, base=replace(log.base, values=values)))
        assert fault.is_fatal
        assert fault.name == "base_frame"
