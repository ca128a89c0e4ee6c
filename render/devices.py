"""Where arrays live."""

from typing import Any


def on_host(array: Any) -> bool:
    """True where an array, numpy's or torch's, is in the memory of the processor.

    There a program may look at values and go by what it finds. On a GPU it would have to wait for all that has been
    asked of the GPU so far.
    """
    return str(array.device) == "cpu"
