"""Draws a robot that no training has met, for `saltus real2sim cycle`:
three effects, one each of drives, body, camera.

Each lies 1.3 to 1.8 times as far from what is known as the draws of policy or predictor reach. Who
names a seed that nobody has looked at hides a robot that nobody chose.

    saltus bench hidden_robot -- --seed 20261122 --out hidden.toml
    saltus real2sim cycle --hidden hidden.toml --out runs/hidden
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._command import Command
from saltus.effects.body import ComOffset, ContactCompliance, PayloadMass
from saltus.effects.camera import CameraHeight, CameraPitch
from saltus.effects.delay_line import CommandDelay
from saltus.effects.effect import Effect
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.joint_loads import CoulombFriction, ViscousFriction
from saltus.effects.motors import ActuatorLag, TorqueGain
from saltus.effects.profile import SHIPPED, Profile, load_profile
from saltus.errors import SaltusError
from saltus.heightmap.data.delivery import TRAINING
from saltus.heightmap.data.randomisation import PITCH_ERROR, POSITION_ERROR_M
from saltus.policy.env.randomisation import SOFT_RUBBER, RandomisationSettings, WideSettings
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.wire.topics import CAMERA_LATENCY_S

BEYOND = (1.3, 1.8)
"""How far from what is known, in units of how far a training's draws reach."""
LAG_S = 0.005  # no training draws lag; what is published of such drives is 2 to 8 ms
_DRAWS, _WIDE = RandomisationSettings(), WideSettings()


@dataclass(frozen=True)
class Draw:
    """A parameter that is hidden: how far trainings draw it from what is known."""

    effect: Callable[[float], Effect]
    known: float
    furthest: float
    mirrored: bool = False
    """They draw it as far on the other side, too."""

    def beyond(self, rng: np.random.Generator) -> Effect:
        """The effect with a value that no training draws."""
        side = float(rng.choice([-1.0, 1.0])) if self.mirrored else 1.0
        return self.effect(
            round(self.known + side * rng.uniform(*BEYOND) * (self.furthest - self.known), 4)
        )


MENU = (
    (  # drives
        Draw(lambda value: ViscousFriction(coefficient=value), 0.0, _WIDE.joint_damping),
        Draw(lambda value: CoulombFriction(torque=value), 0.0, _WIDE.joint_friction),
        Draw(lambda value: CommandDelay(delay=value), 0.0, _WIDE.command_delay_s),
        Draw(lambda value: TorqueGain(gain=value), 1.0, _DRAWS.motor_strength[0]),
        Draw(lambda value: ActuatorLag(time_constant=value), 0.0, LAG_S),
    ),
    (  # body
        Draw(lambda value: PayloadMass(mass=value), 0.0, _DRAWS.payload_kg[1]),
        Draw(
            lambda value: ComOffset(x=value, y=0.0, z=0.0),
            0.0,
            _DRAWS.com_shift_m[0],
            mirrored=True,
        ),
        Draw(
            lambda value: ContactCompliance(time_constant=value),
            *SOFT_RUBBER["contact_time_constant"],
        ),
    ),
    (  # camera
        Draw(
            lambda value: CameraLatency(latency=value, jitter=0.0),
            CAMERA_LATENCY_S,
            TRAINING.latency_s[1],
        ),
        Draw(lambda value: CameraPitch(offset=value), 0.0, PITCH_ERROR, mirrored=True),
        Draw(lambda value: CameraHeight(offset=value), 0.0, POSITION_ERROR_M, mirrored=True),
    ),
)


def hidden_robot(seed: int) -> Profile:
    """The shipped profile with an effect of each kind."""
    rng = np.random.default_rng(seed)
    effects = [draws[rng.integers(len(draws))].beyond(rng) for draws in MENU]
    return load_profile(SHIPPED, load_robot(DEFAULT_ROBOT)).having(*effects)


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    seed: int
    """Seed of the draw."""
    out: Path
    """TOML file to write."""

    def measure(self) -> dict[str, Any]:
        """Writes the profile, and tells only where it is."""
        if self.out.exists():
            raise SaltusError(f"{self.out}: there is a file of this name already")
        self.out.write_text(
            f"# Drawn by saltus bench hidden_robot -- --seed {self.seed}\n\n"
            + hidden_robot(self.seed).to_toml(),
            encoding="utf-8",
        )
        return {"hidden_robot": {"seed": self.seed, "out": str(self.out)}}
