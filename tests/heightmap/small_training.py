"""A training that takes a moment."""

from pathlib import Path

from saltus.heightmap.settings import ModelSettings, PredictorTraining

SMALL = ModelSettings(channels=(2, 4, 4), hidden=32, head=(32,))
CONFIG = PredictorTraining(updates=30, batch=8, window=50, device="cpu", model=SMALL)


def quick(data: Path, out: Path) -> list[str]:
    """The command of a training of one update."""
    small = [
        "--updates",
        "1",
        "--batch",
        "2",
        "--window",
        "50",
        "--device",
        "cpu",
        "--model.hidden",
        "32",
    ]
    return ["heightmap", "train", "--data", str(data), "--out", str(out), *small]
