"""Saltus as a library: a terrain, a policy on it, a recorded run, and the predictor on arrays.

    python examples/library.py runs/<run>/recording.mcap

The recording is that of any `saltus demo`.
"""

import argparse
from pathlib import Path

import numpy as np

from saltus.config import TerrainConfig
from saltus.depth import model_image
from saltus.heightmap.service.features import proprioception_of
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.policy.evaluation.rollout import Rollout
from saltus.policy.planner import make_planner
from saltus.recordings.recording import Recording, read_recording
from saltus.resources import resource
from saltus.robots.loading import load_robot
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain
from saltus.trial import Trial
from saltus.wire.messages import DepthFrame, GroundTruth, RobotState

ROBOT = load_robot("go1")


def look_at(terrain: Terrain) -> None:
    """A terrain knows its height at any place, exactly; x, y in the world [m]."""
    heights = terrain.height_at(np.array([1.0, 1.6, 1.9]), np.zeros(3))
    print(f"{terrain.kind}: {len(terrain.boxes)} boxes, heights {heights.tolist()} m, finish at {terrain.finish_x:g} m")


def roll_out(terrain: Terrain, robots: int) -> None:
    """The shipped policy drives several robots at once, on true heights; each draws its own friction and payload."""
    trials = [Trial.draw(seed) for seed in range(robots)]
    rollout = Rollout(ROBOT, [terrain] * robots, trials, make_planner("learned", ROBOT))
    top = [float(step.truth.position_base_in_world[:, 2].max()) for step in rollout.run()]
    outcomes = [outcome for outcome in rollout.outcomes if outcome is not None]
    print(f"{sum(outcome.success for outcome in outcomes)} of {robots} robots crossed, up to {max(top):.2f} m high")


def predict(recording: Recording) -> None:
    """The network on the arrays of a recorded run, tick by tick, beside the true heights."""
    network = HeightmapNetwork(ROBOT, resource("models/heightmap.onnx"))
    frames = {frame.frame_id: frame for frame in recording.of(DepthFrame)}
    image, hidden, shown, heights = np.stack([np.ones((48, 16)), np.zeros((48, 16))]), np.zeros(256), -1, []
    for state in recording.of(RobotState):
        age_s, new = np.inf, state.depth_due != shown
        if new:
            shown = state.depth_due
            seen = model_image(frames[shown])
            image = np.stack([seen.depth, seen.valid])
        if shown >= 0:
            age_s = 1e-9 * (state.time_ns - frames[shown].time_ns)
        tick = network.tick(image, age_s, new, proprioception_of(state, network.legs), hidden)
        hidden = tick.hidden
        heights.append(tick.height)
    true = [truth.height for truth in recording.of(GroundTruth)][: len(heights)]
    error = np.abs(np.array(heights) - true)[100:].mean()
    print(f"{len(heights)} ticks of {recording.path.name}: heights are {1e3 * error:.1f} mm off after the first second")


def main() -> None:
    """All of it, on stairs of 10 cm and one recording of `saltus demo`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path, help="recording.mcap of a run in lockstep")
    recording = read_recording(parser.parse_args().recording)
    stairs = make_terrain(TerrainConfig(terrain="stairs", steps=3, rise_m=0.10))
    look_at(stairs)
    roll_out(stairs, robots=2)
    predict(recording)


if __name__ == "__main__":
    main()
