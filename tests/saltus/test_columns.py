"""Columns by name: each is read once, in order, and nothing is left over."""

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from saltus.arrays import ColumnNames

SHAPES = st.lists(st.one_of(st.just(()), st.tuples(st.integers(0, 5))), min_size=1, max_size=8)


@given(SHAPES)
def test_names_share_out_all_columns(shapes: list[tuple[int, ...]]) -> None:
    columns = ColumnNames(**{f"name_{k}": shape for k, shape in enumerate(shapes)})
    numbers = np.arange(3.0 * columns.count).reshape(3, columns.count)
    read = columns.of(numbers)
    assert [part.shape[1:] for part in read] == shapes
    np.testing.assert_array_equal(
        np.concatenate([part.reshape(3, -1) for part in read], axis=1), numbers
    )
    for part, same in zip(read, columns.of(torch.as_tensor(numbers)), strict=True):
        np.testing.assert_array_equal(part, same.numpy())
