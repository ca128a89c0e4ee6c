"""`python -m saltus.heightmap.scan.training.timing`: how long an update takes, and what compiling brings."""

import sys
import time
from dataclasses import replace

import torch

from saltus.heightmap.scan.training.settings import ScanTrainSettings
from saltus.heightmap.scan.training.train import Trainer


def main() -> int:
    """Prints images a second of rounds of an eager and of a compiled training, for batches of two sizes."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    for compiled in (False, True):
        for batch in (256, 512):
            began = time.monotonic()
            trainer = Trainer(replace(ScanTrainSettings(), batch=batch, round=96), device, compiled=compiled)
            trainer.round(0.0, 0.01)
            first = time.monotonic() - began
            began = time.monotonic()
            trainer.round(0.01, 0.02)
            seconds = time.monotonic() - began
            print(
                f"batch {batch}, {'compiled' if compiled else 'eager'}: first round {first:.0f} s, then "
                f"{1e3 * seconds / 96:.1f} ms an update, {96 * batch / seconds:.0f} images/s, "
                f"{torch.cuda.max_memory_allocated() / 2**30:.1f} GiB", flush=True,
            )  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
