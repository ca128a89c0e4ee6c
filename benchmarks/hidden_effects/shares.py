"""Shares of runs with their intervals, and medians."""

from typing import Any

import numpy as np

Z95 = 1.959964


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if count == 0:
        return (0.0, 1.0)
    share, z2 = hits / count, Z95**2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = Z95 * np.sqrt(share * (1 - share) / count + z2 / (4 * count**2)) / (1 + z2 / count)
    return (float(middle - half), float(middle + half))


def share(flags: list[bool]) -> dict[str, Any]:
    """A row of the table that is a share of runs."""
    hits = sum(flags)
    low, high = wilson(hits, len(flags))
    return {
        "value": hits / len(flags) if flags else None,
        "hits": hits,
        "count": len(flags),
        "wilson95": [low, high],
    }


def median(values: list[float]) -> dict[str, Any]:
    """A row of the table that is a median."""
    return {"value": float(np.median(values)) if values else None, "count": len(values)}
