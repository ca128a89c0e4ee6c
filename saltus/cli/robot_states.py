"""`saltus robot states`: tells a heightmap service how a robot moves that others move."""

import contextlib
import time
from dataclasses import dataclass
from pathlib import Path

from saltus.cli.robot_link import DomainOptions, need_dds
from saltus.errors import SaltusError
from saltus.flags import EndpointOption

WAIT_S = 0.1
SILENT_S = 1.0
"""Silence of the robot that is worth a line."""


@dataclass(frozen=True, kw_only=True)
class TellStates(EndpointOption, DomainOptions):
    """Tells a heightmap service how a Go2 moves, whoever moves it; it sends nothing to the robot.

    The robot's joints, IMU and torques give its velocity and the feet that stand. Its images come
    from elsewhere: saltus ros2 --take, or a program of your own.

    For example:
      saltus router --robot go2 --grid scan --camera mine.toml --out runs/mine
      saltus heightmap serve --run-dir runs/mine
      saltus robot states --interface enp3s0 --domain 0 --run-dir runs/mine
    """

    run_dir: Path
    """Folder of `saltus router --robot go2`."""

    def run(self) -> int:
        """Runs until the router is gone, or Ctrl-C; 1 where the robot has said nothing."""
        need_dds()
        from saltus.clock import RunClock
        from saltus.controller.robot.unitree.link import STATES, UnitreeLink
        from saltus.controller.robot.unitree.observer import StateObserver
        from saltus.runtime.run_folder import endpoint_of, read_run
        from saltus.wire.zenoh_bus import ZenohBus

        found = read_run(self.run_dir)
        config, clock = found.config, RunClock.of(found.config)
        if config.epoch_ns:
            raise SaltusError(
                f"{self.run_dir} has a robot of its own: a folder of saltus router --robot go2 is "
                "needed"
            )
        observer, told, heard_s = StateObserver(found.setup.robot), 0, time.monotonic()
        with (
            ZenohBus(self.endpoint or endpoint_of(self.run_dir), config.prefix) as bus,
            contextlib.closing(UnitreeLink(self.domain, self.interface, takes=[STATES])) as link,
        ):
            states, silent = bus.publisher("controller/state"), True
            print(f"waiting for states in domain {self.domain} over {self.interface}", flush=True)
            while bus.connected():
                link.wait(STATES, WAIT_S)
                for arrived in link.take(STATES):
                    if observer.take(arrived.payload, 1e-9 * arrived.arrival_ns):
                        states.put(observer.state(clock.of_monotonic(arrived.arrival_ns)))
                        told, heard_s = told + 1, time.monotonic()
                was_silent, silent = silent, not told or time.monotonic() - heard_s > SILENT_S
                if silent != was_silent:
                    said = "has fallen silent" if silent else "is heard, and its states are told"
                    print(f"the robot {said}", flush=True)
        return 0 if told else 1
