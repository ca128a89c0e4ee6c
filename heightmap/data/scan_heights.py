"""Heights that the scan's service of each robot of a loop would give on the grid of its planner."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.constants import POLICY_DT
from saltus.depth import (
    MILLIMETRE,
    MODEL_CAMERA,
    RANGE_M,
    depth_frame,
    depth_in_millimetres,
    model_image,
)
from saltus.effects.heightmap_shift import refuse_shift
from saltus.effects.signals import DepthImage
from saltus.heightmap.data.arriving_images import ImageDamage
from saltus.heightmap.data.robot_cameras import rendered_intrinsics, robot_cameras
from saltus.heightmap.scan.predictor import ScanNetwork
from saltus.heightmap.service.scan import ScanService
from saltus.heightmap.service.scan_fleet import ScanChoice
from saltus.render.eyes import SAMPLED
from saltus.render.stereo.camera import StereoConfig
from saltus.render.stereo.model_view import COLUMNS, ROWS, pool_valid
from saltus.setup import Setup
from saltus.sim.plant_state import PlantState
from saltus.states import ProprioceptionArrays, robot_state_message
from saltus.wire.messages import ControllerMode, DepthFrame, Heightmap, RobotState

_NS = 1_000_000_000


class ScanHeights:
    """Eyes, the links that carry their images, and a scan's service for each robot of a batch.

    The same images as those of `saltus.heightmap.data.predicted.PredictedHeights`, at the same
    steps, before they are pooled; see there. Odometry is the leg controller's estimate of the
    velocity, added up.

    Args:
        network: Of all robots.
        setups: One for each.
        errors: See `robot_cameras`, as `rngs`.
        rngs: See `errors`.
        shadows: See `saltus.heightmap.service.scan.ScanRig`: as a run tells a planner that jumps.
    """

    def __init__(
        self,
        network: ScanNetwork,
        setups: Sequence[Setup],
        errors: StereoConfig | None = None,
        rngs: Sequence[np.random.Generator] | None = None,
        *,
        shadows: bool = True,
        damage: ImageDamage | None = None,
    ) -> None:
        refuse_shift(setups[0].profile.heightmap, "a predictor")
        self._eyes, self._images = robot_cameras(setups, errors, rngs, whole=True)
        self._damage, self._seeds = damage, [setup.trial.seed for setup in setups]
        self._camera = setups[0].camera
        self._lens = rendered_intrinsics(self._camera, whole=True)
        rig = ScanChoice(grid=setups[0].grid, shadows=shadows).rig(setups[0].robot, self._camera)
        depths = [setup.profile.depth_topic for setup in setups]
        self._services = [ScanService(network, rig, depth) for depth in depths]
        self._answers: list[Heightmap] = []
        self._half_width = np.zeros((len(setups), setups[0].grid.size))
        self._now_s = 0.0
        self.given: DepthImage | None = None
        """The images given out at this step [mm], shape (n, 48, 16); None where it was not the
        time."""

    def heights(
        self, states: ProprioceptionArrays, truth: PlantState, fresh: NDArray[np.bool_]
    ) -> Floats:
        """One step of all services; shape (n, points)."""
        answers = self.answers(states, truth, fresh)
        self._half_width = np.array([each.half_width_90 for each in answers], np.float64)
        return np.array([each.height for each in answers], np.float64)

    def answers(
        self, states: ProprioceptionArrays, truth: PlantState, fresh: NDArray[np.bool_]
    ) -> list[Heightmap]:
        """One step of all services: each robot's message.

        Arguments are those of `heights`.
        """
        exposed, self._now_s = self._eyes.expose(truth, states.step, fresh), states.time_s
        if exposed is not None and self._damage is not None:
            exposed = self._damage(exposed, self._seeds)
        self.given = None if exposed is None else self._for_model(exposed)
        arrived, now_ns = self._images.step(exposed, states.time_s, fresh), _ns(states.time_s)
        self._answers = []
        for i, service in enumerate(self._services):
            if fresh[i]:
                service.reset()
            state = robot_state_message(
                states, i, time_ns=now_ns, step=states.step, mode=ControllerMode.RUN
            )
            self._answers.append(
                service.step(state, self._frame(i) if arrived[i] else None, now_ns)
            )
        return self._answers

    def _for_model(self, images: DepthImage) -> DepthImage:
        """The same images as the model of the line sees them."""
        if self._lens == MODEL_CAMERA:
            return images
        if self._lens != SAMPLED:
            near, seen = np.moveaxis(model_image(images.depth, self._lens), -3, 0)
            return replace(images, depth=depth_in_millimetres(RANGE_M * near * seen))
        return replace(
            images, depth=depth_in_millimetres(pool_valid(images.depth * MILLIMETRE, ROWS, COLUMNS))
        )

    def _frame(self, robot: int) -> DepthFrame:
        """The image that a robot has in hand; numbered as its camera counts them."""
        taken = self._images.in_hand
        time_ns = _ns(float(taken.time_s[robot]))
        number = int(self._camera.taken_by(round(time_ns / _NS / POLICY_DT))) - 1
        return depth_frame(self._lens, taken.depth[robot], time_ns=time_ns, frame_id=number)

    @property
    def half_width_90(self) -> Floats:
        """Half of the 90 % interval of the newest heights [m], shape (n, points)."""
        return self._half_width

    @property
    def captured_s(self) -> Floats:
        """Capture time of the image in use of each robot [s], shape (n,);
        minus infinity before the first.
        """
        return self._now_s - np.array([answer.depth_age_s for answer in self._answers])


class ScanHeightSource:
    """The heights of one robot by its camera and the scan's service,
    as the process sends them to a planner that walks.
    """

    def __init__(
        self, network: ScanNetwork, setup: Setup, damage: ImageDamage | None = None
    ) -> None:
        self._service = ScanHeights(network, [setup], shadows=False, damage=damage)
        self._fresh = np.ones(1, np.bool_)

    def __call__(self, state: RobotState, truth: PlantState) -> Heightmap:
        """The message that answers a state; to be asked for at every policy step."""
        known: dict[str, Any] = {
            f.name: np.asarray(getattr(state, f.name))[None] for f in fields(ProprioceptionArrays)
        }
        states = ProprioceptionArrays(**known | {"step": state.step})
        place = PlantState(**{name: np.asarray(value)[None] for name, value in vars(truth).items()})
        fresh, self._fresh = self._fresh, np.zeros(1, np.bool_)
        (answer,) = self._service.answers(states, place, fresh)
        return answer


@dataclass(frozen=True, kw_only=True)
class ScanHeightSourceFactory:
    """Makes `ScanHeightSource` for a setup; can be sent to another process."""

    model: Path
    """ONNX file of the scan's network."""
    damage: ImageDamage | None = None
    """Damage to the images."""

    def __call__(self, setup: Setup) -> ScanHeightSource:
        """Loads the network; `ModelError` where it cannot."""
        return ScanHeightSource(ScanNetwork(self.model), setup, self.damage)


def _ns(seconds: float) -> int:
    return round(seconds * _NS)
