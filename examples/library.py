"""Saltus as a library: a terrain, the policy on it,
a recorded run, and the predictor on its images.

    python examples/library.py runs/<run>/recording.mcap

The recording is that of any `saltus demo`. docs/python.md explains the calls.
"""

import argparse
from pathlib import Path

import numpy as np

import saltus


def look_at(terrain: saltus.Terrain) -> None:
    """A terrain knows its height at any place, exactly; x, y in the world [m]."""
    heights = terrain.height_at(np.array([1.0, 1.6, 1.9]), 0.0)
    print(
        f"{terrain.kind}: {len(terrain.boxes)} boxes, heights {heights.tolist()} m, finish at "
        f"{terrain.finish_x:g} m"
    )


def roll_out(terrain: saltus.Terrain, robots: int) -> None:
    """The shipped policy drives several robots at once, on true heights.

    Each draws its own friction and payload.
    """
    outcomes = saltus.roll_out(saltus.load_robot("go1"), terrain, trials=robots)
    farthest = max(outcome.distance_m for outcome in outcomes)
    print(
        f"{sum(outcome.success for outcome in outcomes)} of {robots} robots crossed, up to "
        f"{farthest:.2f} m far"
    )


def predict(recording: saltus.Recording) -> None:
    """The predictor on the images and states of a recorded run, beside the true heights."""
    states, frames = recording.of(saltus.RobotState), recording.of(saltus.DepthFrame)
    heightmaps = saltus.predict_heights(recording.robot, frames, states)
    known = {truth.step: truth.height for truth in recording.of(saltus.GroundTruth)}
    after = [
        each
        for each in heightmaps
        if each.status == saltus.HeightmapStatus.OK and each.step in known
    ]
    errors = [np.abs(heightmap.height - known[heightmap.step]) for heightmap in after]
    print(
        f"{len(after)} heightmaps of {recording.path.name} are {1e3 * np.mean(errors):.1f} mm off"
    )


def main() -> None:
    """All of it, on stairs of 10 cm and one recording of `saltus demo`."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording", type=Path, help="recording.mcap of a run")
    recording = saltus.read_recording(parser.parse_args().recording)
    stairs = saltus.make_terrain(saltus.TerrainConfig(terrain="stairs", steps=3, rise_m=0.10))
    look_at(stairs)
    roll_out(stairs, robots=2)
    predict(recording)


if __name__ == "__main__":
    main()
