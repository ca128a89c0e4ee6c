"""Makes the checkpoint that is shipped of one that a training wrote, at 56 % of its size.

python tools/shipped_checkpoint.py runs/policy/checkpoint.pt models/checkpoints/policy.pt

Adam's moments are rounded to bfloat16, whose exponents are those of float32; all else stays to the
bit. torch turns them into float32 again where a training resumes. The archive is compressed, which
torch itself never does, though it reads it.
"""

import argparse
import zipfile
from pathlib import Path

import torch

from saltus.files import atomic_write
from saltus.policy.training.checkpoint import read_policy_checkpoint, write_checkpoint

MOMENTS = ("exp_avg", "exp_avg_sq")


def compress(path: Path) -> None:
    """Compresses an archive in place; its entries keep their names, dates and order."""
    with zipfile.ZipFile(path) as archive:
        entries = [(entry, archive.read(entry)) for entry in archive.infolist()]
    with atomic_write(path) as partial, zipfile.ZipFile(partial, "w") as archive:
        for entry, content in entries:
            archive.writestr(entry, content, zipfile.ZIP_DEFLATED, compresslevel=9)


def main() -> None:
    """Writes the smaller file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("shipped", type=Path)
    arguments = parser.parse_args()
    state = read_policy_checkpoint(arguments.checkpoint)
    for moments in state["optimizer_state_dict"]["state"].values():
        for name in MOMENTS:
            moments[name] = moments[name].to(torch.bfloat16)
    write_checkpoint(arguments.shipped, state)
    compress(arguments.shipped)


if __name__ == "__main__":
    main()
