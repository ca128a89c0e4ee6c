"""Experiments that are proposed: they separate,
and the rig that made the log can do and see them.
"""

from itertools import combinations

import pytest
from samples import ROBOT

from saltus.real2sim.experiments.footage import FootageCamera
from saltus.real2sim.experiments.menu import EXPERIMENTS
from saltus.real2sim.experiments.next_experiment import (
    measure_separations,
    next_experiment,
    separations,
)
from saltus.real2sim.search.findings import FoundEffect, ParameterInterval
from saltus.real2sim.sensors import SENSORS

HELD, STANDING = {"base": "fixed"}, {"base": "free"}
NO_RIVALS = {
    "feedforward_delay",
    "voltage_sag",
}  # the one needs tau_ff, the other is not searched for
DRIVES = [
    effect
    for effect in next(sensor.effects for sensor in SENSORS if sensor.name == "joints")
    if effect not in NO_RIVALS
]


@pytest.mark.parametrize("pair", list(combinations(DRIVES, 2)), ids="-".join)
def test_a_held_robot_is_asked_for_what_can_be_done_held(pair: tuple[str, str]) -> None:
    proposed = next_experiment(ROBOT, [pair], (), [HELD])
    assert proposed is not None
    assert EXPERIMENTS[proposed.name].base == "fixed"
    assert proposed.expected_separation > 10.0


def test_a_weak_drive_and_a_heavy_trunk_part_where_no_leg_carries_the_trunk() -> None:
    rivals = [
        FoundEffect(
            name=name, where="all", params={p: ParameterInterval(value=v, ci90=(v, v), unit="")}
        )
        for name, p, v in (("payload_mass", "mass", 0.4), ("torque_gain", "gain", 0.967))
    ]
    proposed = next_experiment(ROBOT, [("payload_mass", "torque_gain")], rivals, [STANDING])
    assert proposed is not None
    assert EXPERIMENTS[proposed.name].base == "fixed"
    table = separations()[proposed.name]
    assert table.alike("payload_mass", "torque_gain") == 0.0
    large = table.nats("payload_mass", "torque_gain", {"torque_gain": 0.1})
    assert table.nats("payload_mass", "torque_gain", {"torque_gain": 0.05}) == pytest.approx(
        large / 4.0
    )


@pytest.mark.slow
def test_a_camera_that_looks_down_is_not_sent_to_a_wall() -> None:
    ahead = FootageCamera.on(ROBOT).claim()
    down = ahead | {"pitch": 1.2}
    assert FootageCamera.of(ahead).claim() == ahead
    alike = [
        _alike(measure_separations(EXPERIMENTS["wall_two_ranges"], ROBOT, FootageCamera.of(claim)))
        for claim in (ahead, down)
    ]
    assert alike[0] < 0.9
    assert alike[1] > 0.99


def test_a_large_image_is_pooled_and_looks_the_same_way() -> None:
    small = FootageCamera.on(ROBOT).claim()
    large = {
        n: 4 * v if n in ("fx", "fy", "cx", "cy", "width", "height") else v
        for n, v in small.items()
    }
    assert FootageCamera.of(large).claim() == small


def _alike(entry: dict) -> float:
    names = list(entry["visible"])
    return float(entry["cosine"][names.index("camera_height")][names.index("depth_scale")])
