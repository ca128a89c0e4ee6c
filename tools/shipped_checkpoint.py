"""Makes the checkpoint that is shipped of one that a training wrote: Adam's moments take half as much.

python tools/shipped_checkpoint.py runs/policy/checkpoint.pt models/checkpoints/policy.pt

The moments are rounded to bfloat16, whose exponents are those of float32; all else stays to the
bit. torch turns them into float32 again where a training resumes.
"""

import argparse
from pathlib import Path

import torch

from saltus.policy.training.checkpoint import read_checkpoint, write_checkpoint

MOMENTS = ("exp_avg", "exp_avg_sq")


def main() -> None:
    """Writes the smaller file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("shipped", type=Path)
    arguments = parser.parse_args()
    state = read_checkpoint(arguments.checkpoint)
    for moments in state["optimizer_state_dict"]["state"].values():
        for name in MOMENTS:
            moments[name] = moments[name].to(torch.bfloat16)
    write_checkpoint(arguments.shipped, state)


if __name__ == "__main__":
    main()
