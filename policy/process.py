"""When the planner lets the robot go, and when it makes it stop:
a pure class, without bus and clock.
"""

from dataclasses import dataclass

import numpy as np

from saltus.grid import HeightGrid
from saltus.policy.mover import AT_REST, Mover, PlannerDecision
from saltus.wire.messages import (
    AnyPlan,
    CommandMode,
    ControllerMode,
    DriveCommand,
    Heightmap,
    HeightmapStatus,
    PlanStatus,
    RobotState,
)
from saltus.wire.topics import TOPICS, staleness_of

STAND_NS = 500_000_000
"""Time that the robot stands before the first jump: ten images, and the estimator settles."""
LOST_NS = round(1e9 * TOPICS["heightmap/heightmap"].invalid_age_s) - 10_000_000
"""Without a heightmap for this long the planner is blind. One policy step less than the greatest
age of a heightmap: the planner looks every 10 ms, and must report it within 110 ms of the last
arrival."""
NEAR_X_M, NEAR_Y_M, UNEVEN_M = (-0.4, 1.0), 0.2, 0.1
"""Ground on which a robot that jumps comes to rest: under it, and as far ahead as it may take to
stop. Where heights of it differ by so much [m], the landing, which does not see, is left to a mover
that walks, if there is one: half of the stairs' steps on which landings fall."""
ROUNDING_M = 1e-6
"""Rounding of points that went through text."""
_COMMANDS = TOPICS["operator/command"]
_TRUSTED = (HeightmapStatus.OK, HeightmapStatus.DEGRADED)


@dataclass(frozen=True, kw_only=True)
class PlannerNotice:
    """An event of the planner process for people, reported once."""

    code: str
    detail: str


class PlannerProcess:
    """Turns states and heightmaps into plans; decides between STAND, GO and STOP.

    STAND until the robot has stood for 0.5 s and a heightmap is OK; then GO, also on heightmaps
    that are degraded, on which a mover that walks begins, too. After the first command of an
    operator it goes only while the newest one says what one of the movers does (JUMP or WALK) and
    is not older than 0.5 s; else it stands, or lies down. From one mover to another it changes
    while the robot stands, and makes it stand for that; but a robot that jumps over uneven ground
    is caught by the mover that walks, if there is one, as soon as the other hands it over. The
    first mover begins; one that walks waits for a command. STOP, which is final, when heightmaps
    end, are invalid, or come from a hidden state that was reset; but STAND while the robot has not
    moved yet, as on a computer that is still busy with starting. A mover that walks comes to a
    stand then, on the last heights, and goes on when they can be trusted again.
    """

    def __init__(self, grid: HeightGrid, *movers: Mover) -> None:
        self._x, self._y, self._told_of_grid = np.array(grid.x), np.array(grid.y), False
        x, y = grid.points.T
        self._near = (x >= NEAR_X_M[0]) & (x <= NEAR_X_M[1]) & (np.abs(y) <= NEAR_Y_M)
        self._movers = {mover.follows: mover for mover in movers}
        self._mover, self._velocity = movers[0], AT_REST
        self._status = PlanStatus.STAND
        self._reason = "the robot has not stood long enough"
        self._first_ns: int | None = None
        self._heightmap: Heightmap | None = None
        self._arrival_ns = 0
        self._plan: AnyPlan | None = None
        self._command: DriveCommand | None = None
        self._lost = ""  # why a walking robot slows down, if because of its heights
        self.notices: list[PlannerNotice] = []
        """Notices of what has happened since the caller last emptied the list."""

    def step(
        self,
        state: RobotState,
        heightmap: Heightmap | None,
        now_ns: int,
        command: DriveCommand | None = None,
    ) -> AnyPlan:
        """Answers one robot state; the same step again gets the same plan again.

        A heightmap or a command is given once, when it has arrived since the last call; `now_ns` is
        in the run's clock.
        """
        self._command = command or self._command
        if heightmap is not None and self._fits(heightmap):
            self._heightmap, self._arrival_ns = heightmap, now_ns
        if self._plan is not None and self._plan.step == state.step:
            return self._plan
        if self._first_ns is None:
            self._first_ns = state.time_ns
        if self._status == PlanStatus.GO:
            self._consider_stopping(state, now_ns)
        elif self._status != PlanStatus.STOP:
            self._consider_going(state, now_ns)
        self._obey(state, now_ns)
        self._plan = self._planned(state)
        return self._plan

    def _fits(self, heightmap: Heightmap) -> bool:
        """True where a heightmap stands on the grid of the planner.

        Says once where one does not.
        """
        sides = ((heightmap.x, self._x), (heightmap.y, self._y))
        fits = all(len(a) == len(b) and float(np.abs(a - b).max()) <= ROUNDING_M for a, b in sides)
        if not fits and not self._told_of_grid:
            self._told_of_grid = True
            self.notices.append(
                PlannerNotice(code="heightmap_grid", detail="it is not that of the run")
            )
        return fits

    def _obey(self, state: RobotState, now_ns: int) -> None:
        """Stands or lies down where a command asks for it, or where commands have ended."""
        command, self._velocity = self._command, AT_REST
        if self._status == PlanStatus.STOP:
            return
        if command is None:
            if self._mover.waits:
                self._rest(state, PlanStatus.STAND, "no command yet")
        elif not staleness_of(_COMMANDS, command.time_ns, now_ns).usable:
            self._rest(state, _resting(command.mode), "commands have ended")
        elif not self._takes_over(command.mode, state):
            self._rest(state, _resting(command.mode), f"the command is {command.mode.name}")
        elif self._lost:
            self._rest(state, PlanStatus.STAND, self._lost)
        else:
            self._velocity = (command.velocity_x, command.velocity_y, command.yaw_rate)

    def _takes_over(self, mode: CommandMode, state: RobotState) -> bool:
        """True where the mover that follows a command has the robot, or takes one that rests."""
        if mode in self._movers and state.mode in (ControllerMode.STAND, ControllerMode.LIE):
            self._mover = self._movers[mode]
        return mode == self._mover.follows

    def _rest(self, state: RobotState, status: PlanStatus, reason: str) -> None:
        moves = self._status == PlanStatus.GO
        if not (moves and (self._awaits_catch(state) or self._mover.slows(state))):
            self._status, self._reason = status, reason

    def _awaits_catch(self, state: RobotState) -> bool:
        """True while a robot that jumps over uneven ground is yet to be caught by the mover that
        walks.
        """
        walker = self._movers.get(CommandMode.WALK)
        runs = state.mode in (ControllerMode.RUN, ControllerMode.COAST)
        if walker is None or walker is self._mover or not runs or self._heightmap is None:
            return False
        if np.ptp(np.asarray(self._heightmap.height)[self._near]) < UNEVEN_M:
            return False
        if self._mover.hands_over(state):
            self._mover = walker
        return self._mover is not walker

    def _consider_going(self, state: RobotState, now_ns: int) -> None:
        self._status = PlanStatus.STAND
        stood_ns = state.time_ns - (self._first_ns or 0)
        trusted = _TRUSTED if self._mover.waits else (HeightmapStatus.OK,)
        if self._heightmap is None:
            self._reason = "no heightmap yet"
        elif (trouble := self._trouble(now_ns)) is not None:
            self._reason = trouble.detail
        elif self._heightmap.status not in trusted:
            self._reason = f"the heightmap is {self._heightmap.status.name}"
        elif stood_ns < STAND_NS:
            self._reason = "the robot has not stood long enough"
        else:
            self._status, self._reason, self._lost = PlanStatus.GO, "", ""

    def _consider_stopping(self, state: RobotState, now_ns: int) -> None:
        trouble = self._trouble(now_ns)
        was_lost, self._lost = self._lost, ""
        if trouble is None:
            return
        if state.mode == ControllerMode.STAND:
            self._status, self._reason = PlanStatus.STAND, trouble.detail
            return
        if self._mover.waits:
            self._lost = trouble.detail
        else:
            self._status, self._reason = PlanStatus.STOP, trouble.detail
        if not was_lost:
            self.notices.append(trouble)

    def _trouble(self, now_ns: int) -> PlannerNotice | None:
        """Reason not to trust the newest heights; None where they can be trusted."""
        heightmap = self._heightmap
        if heightmap is None:
            return None
        old_ns = max(now_ns - self._arrival_ns, now_ns - heightmap.time_ns)
        if old_ns >= LOST_NS:
            return PlannerNotice(
                code="heightmap_lost", detail=f"no heightmap for {old_ns / 1e6:.0f} ms"
            )
        if heightmap.status in _TRUSTED:
            return None
        return PlannerNotice(
            code="heightmap_invalid",
            detail=f"the heightmap of step {heightmap.step} is {heightmap.status.name}",
        )

    def _planned(self, state: RobotState) -> AnyPlan:
        heights = half_width = None
        if self._status == PlanStatus.GO and self._heightmap is not None:
            seen = self._heightmap.height, self._heightmap.half_width_90
            heights, half_width = (np.asarray(each, dtype=np.float64) for each in seen)
        return self._mover.plan(
            PlannerDecision(
                state=state,
                heights=heights,
                half_width=half_width,
                velocity=self._velocity,
                status=self._status,
                reason=self._reason,
            )
        )


def _resting(mode: CommandMode) -> PlanStatus:
    """The rest in which a command leaves a robot: one that lies does not get up by itself."""
    return PlanStatus.LIE if mode == CommandMode.LIE_DOWN else PlanStatus.STAND
