"""Sizes of effects of the linear problem, place by place."""

import itertools

from linear_problem import WHERES

BLOCKS = ("FR", "FL")


def sizes(effect: str, size: float) -> dict[tuple[str, str, str], float]:
    return {(effect, where, block): size for where, block in itertools.product(WHERES, BLOCKS)}
