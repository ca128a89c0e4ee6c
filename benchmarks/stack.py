"""A real-time run of the whole stack: the rates it holds, the ages of its messages, the ticks that it misses.

    saltus bench stack

Prints a table and, last, one JSON object.
"""

import argparse
import json
import os
import tempfile
from pathlib import Path

from saltus.config import RunConfig, TerrainConfig
from saltus.recordings.recording import Recording, rates_and_ages, read_recording
from saltus.runtime.stack import Stack
from saltus.wire.messages import ProcessStatus


def main() -> None:
    """Runs and prints."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--terrain", default="flat")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    config = RunConfig(terrain=TerrainConfig(terrain=options.terrain), pace="realtime", seed=options.seed)
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as directory:
        with Stack(config, Path(directory)) as stack:
            stack.wait()
        recording = read_recording(Path(directory) / "recording.mcap")
    timing = rates_and_ages(recording)
    print(f"{'topic':22} {'rate Hz':>8} {'p50 ms':>8} {'p99 ms':>8} {'lost':>5}")
    for topic, row in timing.items():
        print(f"{topic:22} {row.rate_hz:8.1f} {row.age_p50_ms:8.2f} {row.age_p99_ms:8.2f} {row.lost:5d}")
    control = control_rate_hz(recording)
    print(f"control {control:.1f} Hz; load average at the start {load:.1f}")
    table = {topic: {"hz": r.rate_hz, "p50": r.age_p50_ms, "p99": r.age_p99_ms} for topic, r in timing.items()}
    print(json.dumps({"control_hz": control, "load": load, "topics": table}))


def control_rate_hz(recording: Recording) -> float:
    """Ticks that the control loop ran per second, from its first and last sign of life."""
    statuses = [m for _, _, m in recording.messages("status/controller") if isinstance(m, ProcessStatus)]
    if len(statuses) < 2:
        return float("nan")
    first, last = statuses[0], statuses[-1]
    return 1e9 * (last.ticks - first.ticks) / (last.time_ns - first.time_ns)


if __name__ == "__main__":
    main()
