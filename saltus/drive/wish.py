"""A wish of an operator, and the message that carries it."""

from dataclasses import dataclass

from saltus.wire.messages import CommandMode, DriveCommand, RobotState


@dataclass(frozen=True, kw_only=True)
class Wish:
    """A motion that the robot is to make from now on."""

    mode: CommandMode = CommandMode.STAND
    ahead_mps: float = 0.0
    left_mps: float = 0.0
    turn_rps: float = 0.0
    """To the left."""

    def at(self, state: RobotState) -> DriveCommand:
        """The message that answers a state."""
        return DriveCommand(
            time_ns=state.time_ns,
            step=state.step,
            mode=self.mode,
            velocity_x=self.ahead_mps,
            velocity_y=self.left_mps,
            yaw_rate=self.turn_rps,
        )


STAND = Wish()


def moving_wish(wish: Wish, velocity: str) -> Wish:
    """The wish in which one velocity, by its name, is then changed: to walk, or to jump on where
    the robot turns.
    """
    if wish.mode == CommandMode.WALK or (wish.mode == CommandMode.JUMP and velocity == "turn_rps"):
        return wish
    return Wish(mode=CommandMode.WALK)
