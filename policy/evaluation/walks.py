"""Walks of one robot in one process: the deployed control loop and planner, without the bus."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count

from saltus.constants import PHYSICS_DT, POLICY_STEPS
from saltus.controller.control_loop import ControlLoop
from saltus.controller.robot.mujoco import MujocoRobot
from saltus.controller.tick import TickLaw
from saltus.drive.wish import Wish
from saltus.loop.heights import true_heightmap, true_heights
from saltus.loop.loop import Pushes
from saltus.policy.mover import Mover
from saltus.policy.process import PlannerProcess
from saltus.setup import Setup
from saltus.sim.plant_state import PlantState
from saltus.wire.messages import AnyPlan, ControllerMode, Heightmap, RobotState

TICK_NS = round(1e9 * PHYSICS_DT)
STEP_NS = TICK_NS * POLICY_STEPS

RobotHeightSource = Callable[[RobotState, PlantState], Heightmap]
"""Tells the heights of a state of one robot, which is asked for once a policy step."""
RobotHeightSourceFactory = Callable[[Setup], RobotHeightSource]
"""Makes it; can be sent to another process."""
WalkOperator = Callable[[float, PlantState], Wish]
"""Commands a robot that it sees: by the time of the run [s] and the robot's true state."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WalkStep:
    """One policy step of a walking robot, 10 ms: what held at its start and was asked then, and
    what came of it.
    """

    time_s: float
    """Since the start of the run."""
    truth: PlantState
    wish: Wish
    mode: ControllerMode
    """Mode of the controller at the start of the step."""
    touched: bool
    """The trunk touched the ground during the step."""


class TrueHeightSource:
    """Tells one walking robot the true heights; see `RobotHeightSource`."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup

    def __call__(self, state: RobotState, truth: PlantState) -> Heightmap:
        """The heights on the grid of the setup."""
        pose = truth.position_base_in_world, truth.quaternion_base_in_world
        grid = self._setup.grid
        heights = true_heights(self._setup.terrain, *pose, grid)
        return true_heightmap(grid.x, grid.y, heights, time_ns=state.time_ns, step=state.step)


def walk_steps(
    setup: Setup,
    movers: Sequence[Mover],
    source: RobotHeightSource,
    operator: WalkOperator,
    tick: TickLaw,
    push_ns: float = 0.0,
) -> Iterator[WalkStep]:
    """Runs a robot step by step, for as long as it is asked to.

    Args:
        setup: Of the robot; its grid is that of `source` and of the movers.
        movers: Of the planner, the first begins.
        source: Tells the heights.
        operator: Commands at each step.
        tick: Laws of the controller; may be used for several robots of this kind.
        push_ns: Of one push sideways [Ns], see `saltus.loop.loop`.
    """
    robot, loop = MujocoRobot(setup, compiled=True), ControlLoop(setup.robot, tick)
    process = PlannerProcess(setup.grid, *movers)
    pushes = Pushes(push_ns, [setup.terrain], [setup.trial])
    robot.reset()
    for step in count():
        start_ns = step * STEP_NS
        loop.sense(robot.read())
        truth, state = robot.state, loop.state(start_ns, step)
        wish = operator(1e-9 * start_ns, truth)
        plan = process.step(state, source(state, truth), start_ns, wish.at(state))
        robot.push(float(pushes.step(truth.position_base_in_world[:1])[0]))
        _act(robot, loop, plan, start_ns)
        yield WalkStep(
            time_s=1e-9 * start_ns, truth=truth, wish=wish, mode=state.mode,
            touched=robot.take_trunk_contact(),
        )  # fmt: skip


def _act(robot: MujocoRobot, loop: ControlLoop, plan: AnyPlan, start_ns: int) -> None:
    """Five ticks; the robot has been sensed for the first of them."""
    for tick in range(POLICY_STEPS):
        if tick:
            loop.sense(robot.read())
        age_s = 1e-9 * (start_ns + tick * TICK_NS - plan.time_ns)
        robot.write(loop.act(plan, age_s))
    loop.take_joint_log(0, 0)
