"""An update that a GPU repeats by itself: hundreds
of small calls cost a processor more than their arithmetic a GPU.
"""

from collections.abc import Callable

import torch

from saltus.heightmap.scan.training.seeded_random import SeededRandom

WARM_UP = 4
"""Updates before it is recorded: memory is taken and kernels are compiled meanwhile."""


class CudaGraph:
    """Runs an update of a training as a recorded CUDA graph: it calls `update` at first, then
    replays what was recorded of it, which works in place and waits for nothing.
    """

    def __init__(self, draws: SeededRandom, update: Callable[[], None]) -> None:
        self._draws, self._update = draws, update
        self._done = 0
        self._recorded: torch.cuda.CUDAGraph | None = None

    def step(self) -> None:
        """One update."""
        if self._recorded is not None:
            self._recorded.replay()
        elif self._done < WARM_UP:
            self._aside()
        else:
            self._recorded = torch.cuda.CUDAGraph()
            self._recorded.register_generator_state(self._draws.generator)
            with torch.cuda.graph(self._recorded):
                self._update()
            self._recorded.replay()
        self._done += 1

    def _aside(self) -> None:
        """On a stream of its own, as recording asks for."""
        stream = torch.cuda.Stream()
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            self._update()
        torch.cuda.current_stream().wait_stream(stream)
