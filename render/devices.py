"""Where arrays live."""

from saltus.arrays import Array


def on_host(array: Array) -> bool:
    """True where an array, numpy's or torch's, is in the memory of the processor.

    There a program may look at values and go by what it finds. On a GPU it would have to wait for
    all that has been asked of the GPU so far.
    """
    return str(array.device) == "cpu"
