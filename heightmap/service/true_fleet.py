"""Heights as the simulated ground is, in place of a network's: the other half of a comparison."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from saltus.heightmap.service.fleet import RobotRequest
from saltus.loop.heights import true_heightmap
from saltus.runtime.process import ProcessContext
from saltus.setup import Setup
from saltus.wire.bus import Latest
from saltus.wire.messages import GroundTruth, Heightmap, HeightmapStatus, RobotState


@dataclass
class _Robot:
    truths: Latest
    setup: Setup
    newest: GroundTruth | None = None


class TrueFleet:
    """Answers states with the heights of the simulator, whose truth comes before each state."""

    def __init__(self, contexts: Iterable[ProcessContext]) -> None:
        self._robots = {
            context.bus.prefix: _Robot(
                context.bus.latest("plant/truth", rings=False), context.setup
            )
            for context in contexts
        }

    def step(self, arrivals: Mapping[str, RobotRequest]) -> dict[str, Heightmap]:
        """Answers those robots that ask, by name; WARMING where nobody tells the truth."""
        return {name: self._answer(name, arrival.state) for name, arrival in arrivals.items()}

    def _answer(self, name: str, state: RobotState) -> Heightmap:
        robot = self._robots[name]
        sample = robot.truths.take()
        if sample is not None:
            robot.newest = sample.message
        truth, grid = robot.newest, robot.setup.grid
        when = {"time_ns": state.time_ns, "step": state.step}
        if truth is None:
            level = [-robot.setup.robot.stand_height] * grid.size
            return replace(
                true_heightmap(grid.x, grid.y, level, **when), status=HeightmapStatus.WARMING
            )
        return true_heightmap(truth.x, truth.y, truth.height, **when)
