"""Random robots: whatever the controller may meet, in batches."""

from collections.abc import Callable
from typing import Any

import pytest

from benchmarks.qp import random_robots

Draw = Callable[..., tuple[Any, Any]]


@pytest.fixture
def draw() -> Draw:
    """Of a generator and a batch: plans and robots."""
    return random_robots
