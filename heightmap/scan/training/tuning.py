"""`python -m saltus.heightmap.scan.training.tuning`: what each number of the classical map does, without a network.

The rival that a network has to beat deserves the best numbers, and the network starts from the same map.
"""

import sys
from dataclasses import replace

import torch

from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.evaluation import evaluate, rivals_of, rows_of
from saltus.heightmap.scan.training.settings import ScanTrainSettings

TRIED: dict[str, tuple[float, ...]] = {
    "depth_noise": (0.002, 0.008), "point_noise_m": (0.002, 0.005), "shared_noise": (0.1, 0.6), "drift": (0.003, 0.03),
    "least_m": (0.002, 0.008), "step_m": (0.001, 0.002, 0.008), "tilt_rad": (1e-5, 0.002, 0.008), "independent": (0.01, 0.1), "gate_m": (0.03, 0.1),
    "foot_gain": (0.05, 0.1, 0.4), "foot_noise_m": (0.003, 0.01), "surprise": (0.0, 0.03, 0.3),
}  # fmt: skip
"""Values beside the usual one, one number at a time."""


def main() -> int:
    """Prints errors [mm] of visible, remembered and all seen points of the scan."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    robots = int(sys.argv[1]) if len(sys.argv) > 1 else 256
    settings = ScanTrainSettings()
    variants: dict[str, MapSettings] = dict(rivals_of(settings.map))
    for name, values in TRIED.items():
        for value in values:
            variants[f"{name} {value:g}"] = replace(settings.map, **{name: value})
    rows = rows_of(settings.flight)
    for row in ("usual", "bad odometry", "good odometry"):
        scores = evaluate(None, settings, robots=robots, device=device, rows={row: rows[row]}, rivals=variants)
        kept = {(s.method, s.group): s for s in scores if s.family == "every" and s.grid == "scan"}
        for method in dict.fromkeys(method for method, _ in kept):
            found = [kept[method, group] for group in ("seen", "visible", "remembered", "never")]
            print(f"{row:14} {method:24} " + "  ".join(f"{s.error_mm:7.2f} {100 * s.inside:3.0f}%" for s in found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
