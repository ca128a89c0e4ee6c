"""`saltus policy train`, and this module under torchrun,
where N processes learn together on N GPUs.
"""

import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated

import tyro

from saltus.errors import SaltusError
from saltus.grid import DEFAULT_GRID
from saltus.policy.env.settings import JumpTrainSettings, for_gpu
from saltus.policy.training import command
from saltus.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True, kw_only=True)
class TrainPolicy(command.TrainPolicyCommand):  # noqa: D101 - that of the training below
    __doc__ = command.TrainPolicyCommand.__doc__

    training: Annotated[JumpTrainSettings, tyro.conf.arg(name="")] = field(
        default_factory=partial(for_gpu, DEFAULT_ROBOT, DEFAULT_GRID)
    )


def parse(arguments: Sequence[str] | None = None) -> command.TrainPolicyCommand:
    """The command line, read twice: first for what says where the defaults come from."""
    return tyro.cli(
        TrainPolicy, args=arguments, default=tyro.cli(TrainPolicy, args=arguments).defaults()
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Trains as the command line says; errors are one line. Returns the exit code."""
    for number in (
        signal.SIGTERM,
        signal.SIGHUP,
    ):  # of torchrun, schedulers and terminals: saves as Ctrl-C does
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    try:
        return parse(arguments).run()
    except SaltusError as error:
        print(error, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
