"""Saltus: a legged robot that sees where it steps.

`import saltus` gives what docs/python.md shows. It loads nothing: each name is looked up when it is
used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from saltus.api import depth_frames as depth_frames
    from saltus.api import find_effects as find_effects
    from saltus.api import make_predictor as make_predictor
    from saltus.api import predict_heights as predict_heights
    from saltus.api import robot_states as robot_states
    from saltus.api import roll_out as roll_out
    from saltus.config import TerrainConfig as TerrainConfig
    from saltus.depth import D435I as D435I
    from saltus.depth import Intrinsics as Intrinsics
    from saltus.depth_camera import load_camera as load_camera
    from saltus.errors import SaltusError as SaltusError
    from saltus.grid import load_grid as load_grid
    from saltus.heightmap.service.service import HeightmapService as HeightmapService
    from saltus.loop.loop import Moment as Moment
    from saltus.loop.planner import Planner as Planner
    from saltus.policy.planner import make_planner as make_planner
    from saltus.real2sim.results import Judgement as Judgement
    from saltus.real2sim.verdict import Verdict as Verdict
    from saltus.recordings.recording import Recording as Recording
    from saltus.recordings.recording import read_recording as read_recording
    from saltus.robots.loading import load_robot as load_robot
    from saltus.robots.robot import Robot as Robot
    from saltus.terrain.boxes import Box as Box
    from saltus.terrain.curriculum import make_terrain as make_terrain
    from saltus.terrain.terrain import Terrain as Terrain
    from saltus.trial import Outcome as Outcome
    from saltus.trial import Trial as Trial
    from saltus.wire.messages import DepthFrame as DepthFrame
    from saltus.wire.messages import GroundTruth as GroundTruth
    from saltus.wire.messages import Heightmap as Heightmap
    from saltus.wire.messages import HeightmapStatus as HeightmapStatus
    from saltus.wire.messages import MotionPlan as MotionPlan
    from saltus.wire.messages import RobotState as RobotState

_HOMES = {
    "saltus.api": (
        "depth_frames", "find_effects", "make_predictor", "predict_heights", "robot_states",
        "roll_out",
    ),
    "saltus.config": ("TerrainConfig",),
    "saltus.depth": ("D435I", "Intrinsics"),
    "saltus.depth_camera": ("load_camera",),
    "saltus.errors": ("SaltusError",),
    "saltus.heightmap.service.service": ("HeightmapService",),
    "saltus.loop.loop": ("Moment",),
    "saltus.loop.planner": ("Planner",),
    "saltus.policy.planner": ("make_planner",),
    "saltus.real2sim.results": ("Judgement",),
    "saltus.real2sim.verdict": ("Verdict",),
    "saltus.recordings.recording": ("Recording", "read_recording"),
    "saltus.grid": ("load_grid",),
    "saltus.robots.loading": ("load_robot",),
    "saltus.robots.robot": ("Robot",),
    "saltus.terrain.boxes": ("Box",),
    "saltus.terrain.curriculum": ("make_terrain",),
    "saltus.terrain.terrain": ("Terrain",),
    "saltus.trial": ("Outcome", "Trial"),
    "saltus.wire.messages": (
        "DepthFrame", "GroundTruth", "Heightmap", "HeightmapStatus", "MotionPlan", "RobotState",
    ),
}  # fmt: skip
"""Where each name is defined: what is imported above for those who check types, said to those who
run."""

__all__ = [name for names in _HOMES.values() for name in names]

if not TYPE_CHECKING:  # a name that does not exist is an error for who checks types

    def __getattr__(name):
        """The object of that name."""
        for home, names in _HOMES.items():
            if name in names:
                found = globals()[name] = getattr(import_module(home), name)
                return found
        raise AttributeError(f"module 'saltus' has no attribute '{name}'")

    def __dir__():
        """Names that are offered, for completion."""
        return sorted({*globals(), *__all__})
