"""Stages of a training step: plain functions on a CPU.

Compiled, and replayed as CUDA graphs, on a GPU.
"""

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

_COMPILATIONS = 10_000
"""Compilations of one function in a process: each environment compiles it for its own tensors.
Torch would stop at 8 of them."""
_WARM_UPS = 3  # as PyTorch's notes on CUDA graphs do: lazy initialisation is over by then
_UNROLLED = 17  # sums of up to 16 terms are written out: the longest product here is of 16 terms


class Stage:
    """A function that changes tensors in place, always the same ones.

    Called a few times before it is replayed.
    """

    def __init__(self, function: Callable[[], None], device: torch.device) -> None:
        self._function = function
        self._device = device
        self._graph: torch.cuda.CUDAGraph | None = None

    def prepare(self) -> None:
        """Compiles and records the function, which changes the tensors; nothing on a CPU."""
        if self._device.type != "cuda":
            return
        self._function()  # what is computed once and kept is not to be traced
        compiled = self.compiled(_fusing_backend())
        beside = torch.cuda.Stream()
        beside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(beside):
            for _ in range(_WARM_UPS):
                compiled()
        torch.cuda.current_stream().wait_stream(beside)
        self._graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(
            self._graph, capture_error_mode="thread_local"
        ):  # NCCL has threads of its own
            compiled()

    def compiled(self, backend: Callable[..., object] | str) -> Callable[[], None]:
        """The function as one graph, which is made by its first call."""
        from torch._dynamo import config  # half a second, of which what runs on a CPU has no use

        compiled = torch.compile(self._function, backend=backend, dynamic=False, fullgraph=True)

        def call() -> None:
            with config.patch(
                recompile_limit=_COMPILATIONS, accumulated_recompile_limit=_COMPILATIONS
            ):
                compiled()

        return call

    def __call__(self) -> None:
        """Does it."""
        if self._graph is None:
            self._function()
        else:
            self._graph.replay()


def _fusing_backend() -> Callable[..., object]:
    """The default compiler, with products of small matrices written out.

    A leg controller multiplies thousands of 3 x 3 matrices. As calls of a library each is a kernel
    of its own that goes through memory; as sums of products they join the arithmetic around them.
    """
    from torch._inductor.compile_fx import compile_fx
    from torch._inductor.decomposition import select_decomp_table

    table = {
        **select_decomp_table(),
        torch.ops.aten.bmm.default: _written_out_bmm,
        torch.ops.aten.mm.default: _written_out_mm,
    }
    return partial(
        compile_fx, decompositions=table, config_patches={"unroll_reductions_threshold": _UNROLLED}
    )


def _written_out_bmm(a: Tensor, b: Tensor) -> Tensor:
    return (a[:, :, :, None] * b[:, None, :, :]).sum(2)


def _written_out_mm(a: Tensor, b: Tensor) -> Tensor:
    return (a[:, :, None] * b[None, :, :]).sum(1)
