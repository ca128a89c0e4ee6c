"""`python -m saltus.heightmap.scan.training`:
trains, evaluates and exports the network of the scan.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import torch

from saltus.config import load_changes
from saltus.errors import SaltusError, nearest_hint
from saltus.gpu import has_gpu
from saltus.heightmap.scan.training.card import scan_card
from saltus.heightmap.scan.training.evaluation import (
    EVAL_SEED,
    evaluate_scan,
    evaluation_rows,
    table_of,
    write_results,
)
from saltus.heightmap.scan.training.export import export_scan
from saltus.heightmap.scan.training.files import ScanTrainingProgress, trained_images
from saltus.heightmap.scan.training.scan_model import parameter_count
from saltus.heightmap.scan.training.settings import FlightSettings, ScanTrainSettings
from saltus.heightmap.scan.training.train import train_scan
from saltus.model_file import ModelFile
from saltus.onnx_export import weights_of
from saltus.provenance import current_commit


def main() -> int:
    """Runs the command; errors are one line."""
    parser = argparse.ArgumentParser(
        prog="python -m saltus.heightmap.scan.training", description=__doc__
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/scan"),
        help="folder of checkpoint, CSV, ONNX, tables",
    )
    parser.add_argument(
        "--config", type=Path, help="TOML file with the settings that are to be other ones"
    )
    parser.add_argument(
        "--start", type=Path, help="ONNX file of a network to begin with, as models/scan.onnx"
    )
    parser.add_argument("--commit", help="which code trains, where this machine has no repository")
    parser.add_argument("--seed", type=int, help="of weights and flights")
    parser.add_argument("--minutes", type=float, help="how long to train")
    parser.add_argument(
        "--updates", type=int, help="how many updates to make, in place of --minutes"
    )
    parser.add_argument("--batch", type=int, help="robots at once")
    parser.add_argument(
        "--robots", type=int, default=512, help="robots of each row of the evaluation; 0: none"
    )
    parser.add_argument(
        "--rows", help="rows of the evaluation, with commas between them, in place of all"
    )
    parser.add_argument(
        "--flight-seed", type=int, default=EVAL_SEED, help="of the evaluation's flights"
    )
    parser.add_argument("--device", default="cuda" if has_gpu() else "cpu")
    parser.add_argument(
        "--compile", action="store_true", help="compile network and rays; pays after minutes"
    )
    given = parser.parse_args()
    try:
        return _run(given)
    except SaltusError as error:
        print(error, file=sys.stderr)
        return 2


def _run(given: argparse.Namespace) -> int:
    settings = (
        load_changes(ScanTrainSettings(), given.config) if given.config else ScanTrainSettings()
    )
    changes = {
        name: getattr(given, name) for name in ("seed", "batch") if getattr(given, name) is not None
    }
    settings = replace(settings, **changes)
    if (given.minutes is None) == (given.updates is None):
        raise SaltusError("say how long to train, by --minutes or by --updates, e.g. --minutes 8")
    device = torch.device(given.device)
    torch.backends.cudnn.benchmark = True
    began, images = time.monotonic(), 0

    def show(found: ScanTrainingProgress) -> None:
        nonlocal began, images
        now = time.monotonic()
        speed = (found.images - images) / (now - began)
        began, images = now, found.images
        print(
            f"seed {settings.seed}  {found.seconds:6.0f} s  {found.update:7d} updates  "
            f"{speed:7.0f} images/s  "
            f"loss {found.loss:.4f}  seen {found.seen_mm:5.2f} of {found.map_mm:5.2f} mm  "
            f"unseen {found.unseen_mm:6.1f} mm  inside {100 * found.inside_seen:4.1f} "
            f"{100 * found.inside_all:4.1f} %  clipped {100 * found.clipped:4.1f} %  "
            f"rate {found.rate:.1e}",
            flush=True,
        )

    model = train_scan(
        settings, given.out, minutes=given.minutes, updates=given.updates, device=device,
        compiled=given.compile,
        progress=show, start=weights_of(ModelFile(given.start)) if given.start else None,
    )  # fmt: skip
    export_scan(model.cpu(), settings, given.out / "scan.onnx")
    if given.robots:
        rows = _rows(settings, given.rows)
        results = evaluate_scan(
            model.to(device), settings, robots=given.robots, device=device, rows=rows,
            seed=given.flight_seed,
        )  # fmt: skip
        write_results(results, given.out / "scan.json")
        text = scan_card(
            ModelFile(given.out / "scan.onnx").model_id,
            settings,
            results,
            parameter_count(model),
            trained_images(given.out),
            given.commit or current_commit(),
        )
        (given.out / "scan.md").write_text(text, encoding="utf-8")
        print(table_of(results), flush=True)
    return 0


def _rows(settings: ScanTrainSettings, names: str | None) -> dict[str, FlightSettings]:
    """Rows by name, or all; or `SaltusError`."""
    known = evaluation_rows(settings.flight)
    for name in names.split(",") if names else ():
        if name not in known:
            raise SaltusError(f"--rows: '{name}' is none: {nearest_hint(name, known)}")
    return {name: known[name] for name in names.split(",")} if names else known


if __name__ == "__main__":
    sys.exit(main())
