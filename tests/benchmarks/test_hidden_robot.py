"""`saltus bench hidden_robot`: three effects that no training draws,
as a profile that the cycle can hide.
"""

from dataclasses import astuple

from benchmarks.hidden_robot import BEYOND, MENU, hidden_robot
from saltus.effects.profile import SHIPPED, load_profile
from saltus.robots.loading import load_robot


def test_each_robot_has_an_effect_of_each_kind_beyond_what_trainings_draw() -> None:
    shipped, seen = load_profile(SHIPPED, load_robot("go1")).effects, set[str]()
    for seed in range(60):
        changed = {
            name: e for name, e in hidden_robot(seed).effects.items() if shipped.get(name) != e
        }
        assert len(changed) == len(MENU)
        seen |= set(changed)
        for draws in MENU:
            (draw,) = (draw for draw in draws if draw.effect(draw.known).name in changed)
            known = draw.effect(draw.known)
            pairs = zip(astuple(changed[known.name]), astuple(known), strict=True)
            (value,) = (one for one, other in pairs if one != other)
            times = (value - draw.known) / (draw.furthest - draw.known)
            assert BEYOND[0] - 0.01 < (abs(times) if draw.mirrored else times) < BEYOND[1] + 0.01
    assert len(seen) == sum(len(draws) for draws in MENU)
    assert hidden_robot(7) == hidden_robot(7) != hidden_robot(8)
