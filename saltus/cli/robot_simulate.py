"""`saltus robot simulate`: a robot that is commanded over its own protocol."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

from saltus.cli.robot_link import LinkOptions, PaceOptions, check_speed
from saltus.cli.run_options import CourseOptions, SizedCourse
from saltus.flags import Flag, flag_help

if TYPE_CHECKING:
    from saltus.controller.robot.unitree.simulated import SimulatedUnitree
    from saltus.robots.robot import Robot


@dataclass(frozen=True, kw_only=True)
class Simulate(PaceOptions, LinkOptions):
    """Simulates a robot that is commanded over its own protocol:
    states at 500 Hz over DDS, until Ctrl-C.

    For example:
      saltus robot simulate --robot go2 --domain 1
      saltus robot simulate --held --fault hot:FR_calf@5 lost@10
      saltus robot simulate --speed 0.5 --profile ideal --terrain stairs
    """

    course: CourseOptions = field(default_factory=lambda: SizedCourse(terrain="flat"))
    profile: str = "shipped"
    """Effects of the hardware: shipped (those of the robot), ideal, one of your own, or a TOML
    file."""
    held: Flag = False
    """Hold the trunk in the air, as a crane or two people would."""
    fault: Annotated[tuple[str, ...], flag_help("KIND[:JOINT][@SECONDS]", "none")] = ()
    """Faults, from some second on: battery, button, crc, dead, foreign, frozen, hot, imu, kept,
    late, lost, mode, offset, sign, silent, slow, stuck, tick; of dead, hot, offset and sign at a
    joint."""
    seconds: Annotated[float, flag_help("FLOAT", "until Ctrl-C")] = math.inf
    """Time of the robot after which the simulation ends [s]."""
    seed: int = 0
    """Seed of noise and lost packets."""
    drawn: Flag = False
    """Place, friction, payload and strength of the drives are those that the seed draws for a run
    of `saltus up`, not the nominal ones."""

    def run(self) -> int:
        """Runs until the end."""
        from saltus.clock import RunClock

        check_speed(self.speed)
        robot = self.loaded()
        simulated = self._simulated(robot)
        from saltus.controller.robot.unitree.link import (
            ANSWERS,
            COMMANDS,
            REQUESTS,
            STATES,
            TRUTHS,
            UnitreeLink,
        )
        from saltus.controller.robot.unitree.serving import OtherCommander, RobotServer

        lockstep = self.pace == "lockstep"
        link = UnitreeLink(
            self.domain, self.interface, sends=[STATES, TRUTHS, ANSWERS],
            takes=[COMMANDS, REQUESTS], reliable=lockstep,
        )  # fmt: skip
        stranger = OtherCommander(robot, self.domain, self.interface)
        server = RobotServer(link, simulated, stranger)
        print(
            f"simulated {robot.name} in domain {self.domain} over {self.interface}; Ctrl-C ends it",
            flush=True,
        )
        try:
            if lockstep:
                server.lockstep(self.seconds)
            else:
                server.realtime(RunClock(speed=self.speed), self.seconds)
        finally:  # told before the domain is left, in which the library could end the process
            place = ", ".join(f"{value:.2f}" for value in simulated.position)
            print(
                f"{simulated.time_s:.1f} s, {simulated.commands} commands, {simulated.refused} "
                f"refused; its base is at ({place}) m",
                flush=True,
            )
            stranger.close()
            link.close()
        return 0

    def _simulated(self, robot: "Robot") -> "SimulatedUnitree":
        from saltus.controller.robot.unitree.faults import PlantedFault, PlantedFaults
        from saltus.controller.robot.unitree.simulated import SimulatedUnitree
        from saltus.effects.motors import VoltageSag
        from saltus.effects.profile import load_profile
        from saltus.sim.plant import Plant
        from saltus.terrain.curriculum import make_terrain
        from saltus.trial import Trial

        profile, trial = load_profile(self.profile, robot), Trial()
        if self.drawn:
            trial = Trial.draw(self.seed)
            profile = trial.applied_to(profile)
        plant = Plant(
            robot, make_terrain(self.course), friction=trial.friction, payload_kg=trial.payload_kg,
            chain=profile.actuator_chain, body=profile.body_chain, imu=profile.imu_chain,
            held=self.held,
        )  # fmt: skip
        plant.reset(position_x=trial.position_x, yaw=trial.yaw)
        faults = PlantedFaults([PlantedFault.parse(text) for text in self.fault], self.seed)
        sag = next((each for each in profile.actuator if isinstance(each, VoltageSag)), None)
        return SimulatedUnitree(plant, faults, self.seed, sag)
