"""Laws of bodies: whoever starts again is as new, and the others do not notice."""

from dataclasses import fields

import numpy as np
from samples import setups_of

from saltus.config import TerrainConfig
from saltus.loop.body import Body
from saltus.plan import REST, Plan
from saltus.states import ProprioceptionArrays
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Trial
from saltus.wire.messages import ControllerMode

FLAT = make_terrain(TerrainConfig(terrain="flat"))
STEPS = 40
"""0.4 s of stepping on the spot: legs swing, and estimates have settled."""


def make_body(count: int) -> Body:
    return Body(setups_of([FLAT] * count, [Trial.draw(seed) for seed in range(count)]))


def step(body: Body, count: int) -> None:
    plan = Plan(
        **{
            f.name: np.repeat(np.asarray(getattr(REST, f.name))[None], count, 0)
            for f in fields(Plan)
        }
    )
    body.step(plan, ControllerMode.RUN)


def known(states: ProprioceptionArrays, robots: object) -> dict[str, np.ndarray]:
    return {f.name: np.asarray(getattr(states, f.name))[robots] for f in fields(states)[:-1]}


def test_who_starts_again_is_as_new_and_the_others_do_not_notice() -> None:
    body, again = make_body(3), np.array([True, False, True])
    new = known(body.states(), again)
    for _ in range(STEPS):
        step(body, 3)
    before = known(body.states(), ~again)
    assert np.ptp(known(body.states(), again)["leg_progress"]) > 0.0
    body.restart(again)
    np.testing.assert_equal(known(body.states(), again), new)
    np.testing.assert_equal(known(body.states(), ~again), before)
