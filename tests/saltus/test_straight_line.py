"""Laws of compiled laws: they are the same function.

Only what is asked for is computed, in the branch that asks.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from saltus.arrays import Array, namespace
from saltus.straight_line import straight_line
from saltus.symbols import noted_call


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    left: Array
    right: Array
    name: str = "pair"


def rotated(pair, angle):
    xp = namespace(angle)
    c, s = xp.cos(angle), xp.sin(angle)
    zero = xp.zeros_like(c)
    matrix = xp.stack([c, -s, zero, s, c, zero, zero, zero, zero + 1.0], -1).reshape((3, 3))
    near = xp.sum(pair.left * pair.left, axis=-1) < 1.0
    return Pair(
        left=xp.where(near, pair.left @ matrix.mT, xp.clip(pair.left, -0.5, None)),
        right=xp.minimum(
            xp.maximum(pair.right, xp.floor(pair.left)), xp.atan2(pair.left, pair.right)
        )
        / (s + 2.0),
    ), near


PAIR = Pair(left=np.zeros(3), right=np.zeros(3))


def test_a_compiled_law_is_the_law():
    compiled, rng = straight_line(rotated, PAIR, np.zeros(())), np.random.default_rng(0)
    for _ in range(200):
        pair, angle = (
            Pair(left=rng.normal(size=3), right=rng.normal(size=3)),
            np.asarray(rng.uniform(-4.0, 4.0)),
        )
        (one, near), (other, flag) = rotated(pair, angle), compiled(pair, angle)
        assert (other.name, flag, flag.dtype) == ("pair", near, np.bool_)
        np.testing.assert_allclose(other.left, one.left, atol=1e-15)
        np.testing.assert_allclose(other.right, one.right, rtol=1e-15, atol=1e-15)


def test_what_comes_back_as_it_came_is_the_same_array():
    pair = Pair(left=np.ones(3), right=np.ones(3))
    assert straight_line(lambda pair: pair, PAIR)(pair).left is pair.left


def test_a_float_comes_back_as_a_number_of_numpy():
    (same,) = straight_line(lambda number: (number,), 0.0)(2.5)
    assert same[..., None].tolist() == [2.5]


@pytest.mark.parametrize(("law", "value", "error"), [
    (lambda a: 1.0 / a, 0.0, ZeroDivisionError),
    (lambda a: namespace(a).sin(a), np.inf, ValueError),
])  # fmt: skip
def test_numbers_without_a_result_raise(law, value, error):
    with pytest.raises(error):
        straight_line(law, np.zeros(()))(np.asarray(value))


def test_a_branch_computes_for_itself_alone():
    """Where the condition is false, what would raise is not computed; a function is called once."""
    calls = []

    def halves(a, b):
        calls.append((a, b))
        return [0.5 * a, 0.5 * b]

    def law(a):
        xp = namespace(a)
        root = a
        for _ in range(20):
            root = xp.sqrt(root) * root
        return xp.where(a[0] >= 0.0, root, a), noted_call(halves, a, 2)

    kept, half = straight_line(law, np.zeros(2))(np.array([-1.0, -4.0]))
    assert (kept.tolist(), half.tolist(), calls) == ([-1.0, -4.0], [-0.5, -2.0], [(-1.0, -4.0)])
