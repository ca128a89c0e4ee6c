"""Processes that share tasks, and what they tell on the way."""

from collections import Counter

import pytest

from saltus.workers import in_order, tell_progress


def work(task: int) -> int:
    for _ in range(task):
        tell_progress(0.5)
    return task * task


@pytest.mark.parametrize("processes", [1, 2])
def test_whoever_listens_hears_all_that_tasks_tell(processes: int) -> None:
    heard: list[float] = []
    assert list(in_order(work, [3, 1, 4], processes, heard.append)) == [9, 1, 16]
    assert Counter(heard) == {0.5: 8}
    assert list(in_order(work, [3, 1, 4], processes)) == [9, 1, 16]
    assert Counter(heard) == {0.5: 8}


def test_nobody_need_listen() -> None:
    assert work(2) == 4
