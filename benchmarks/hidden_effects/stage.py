"""Parts that a run needs of its kind: a scene, places for its effects, and files."""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from benchmarks.hidden_effects.plan import Run
from benchmarks.hidden_effects.scene import Scene, Setting
from benchmarks.hidden_effects.tables import RunFiles


class Stage(ABC):
    """One run's rig.

    Attributes:
        scene: Simulates what this run shows.
        sizing: Scene in which one sigma is measured: the same, or that of the full motion where the
            run is quiet.
        place: Where effects sit, unless `where` says more.
    """

    scene: Scene
    sizing: Scene
    place: tuple[str, ...]

    def where(self, effect: str, rng: np.random.Generator) -> tuple[str, ...]:
        """A place for an effect."""
        del effect, rng
        return self.place

    def anywhere(self, rng: np.random.Generator) -> tuple[str, ...]:
        """A place at which the sizes of effects that are not there are stated."""
        del rng
        return self.place

    @abstractmethod
    def follow(self, experiment: str, rng: np.random.Generator) -> bool:
        """Has the same robot do an experiment from now on.

        False where this kind of rig cannot do it.
        """

    @abstractmethod
    def record(self, settings: tuple[Setting, ...], rng: np.random.Generator) -> RunFiles:
        """The log of a run that has these effects."""


def make_stage(run: Run, tuning: bool) -> Stage:
    """The stage of a run's kind."""
    from benchmarks.hidden_effects.body_stage import BodyStage
    from benchmarks.hidden_effects.camera_stage import CameraStage
    from benchmarks.hidden_effects.joint_stage import JointStage

    stages: dict[str, Callable[[Run, bool], Stage]] = {
        "joints": JointStage,
        "camera": CameraStage,
        "body": BodyStage,
        "imu": BodyStage,
    }
    return stages[run.kind](run, tuning)
