"""Robots see alike wherever they are: as a service, in roll-outs on processors, and on a device."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from heightmap_inputs import frame
from samples import PROFILE, ROBOT

from saltus.arrays import Floats
from saltus.depth_camera import SHIPPED
from saltus.effects.camera import NOMINAL_LATENCY
from saltus.effects.signals import DepthImage
from saltus.heightmap.data.delivery import DeliveryModel
from saltus.heightmap.data.device_heights import DeviceHeights, late_images
from saltus.heightmap.data.predicted import PredictedHeights
from saltus.heightmap.model import Estimate, HeightmapModel
from saltus.heightmap.service.features import proprioception_of_states
from saltus.heightmap.service.network import HeightmapNetwork, Tick
from saltus.heightmap.service.service import HeightmapService
from saltus.robots.legs import LegKinematics
from saltus.states import RobotStates, standing_state, state_message
from saltus.trial import Trial
from saltus.wire.messages import ControllerMode

ROBOTS, TICKS, TICK_NS = 3, 180, 10_000_000
WRONG_M = 3.0
"""A height that no robot sees."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """What is drawn for one tick of all robots."""

    states: RobotStates
    depth: Any
    """[mm], uint16, shape (robots, 48, 16)."""
    arrived: Any
    """Whose image that is, bool, shape (robots,), as the two that follow."""
    fresh: Any
    wrong: Any
    """Whose network tells nonsense."""


class Seen(NamedTuple):
    """What robots make of a tick."""

    height: Floats
    """Shape (robots, 30)."""
    hidden: Floats


def drawn_moments(seed: int) -> list[Moment]:
    """Images come now and then, some with hardly a valid pixel; after long pauses none counts."""
    rng, stands = np.random.default_rng(seed), standing_state(ROBOT)
    moments = []
    for step in range(TICKS):
        joints = stands.joint_position + 0.1 * rng.normal(size=(ROBOTS, 12))
        together = {
            name: np.stack([getattr(stands, name)] * ROBOTS)
            for name in vars(stands)
            if name not in ("time_ns", "step", "joint_position", "joint_torque", "mode", "depth_due")
        }
        valid = rng.uniform(size=(ROBOTS, 48, 16)) < rng.choice([0.1, 0.9], (ROBOTS, 1, 1))
        moments.append(
            Moment(
                states=RobotStates(joint_position=joints, step=step, **together),
                depth=np.where(valid, rng.integers(1, 5000, valid.shape), 0).astype(np.uint16),
                arrived=(rng.uniform(size=ROBOTS) < 0.5) & (step % 2 == 0) & (step % 60 > 20),
                fresh=rng.uniform(size=ROBOTS) < (0.01 if step else 1.0),
                wrong=(rng.uniform(size=ROBOTS) < 0.2) & (step % 3 == 0),
            )
        )
    return moments


class Arriving:
    """Images that arrive when it is drawn that they do."""

    def __init__(self, depth: Any, like: Callable[[Any], Any]) -> None:
        self._like, self.moment = like, None
        self.in_hand = DepthImage(depth=depth, time_s=like(np.full(ROBOTS, -np.inf)))

    def step(self, exposed: Any, time_s: float, fresh: Any) -> Any:
        """Whose image in hand has just come."""
        del exposed, fresh
        moment: Any = self.moment
        now = np.where(moment.arrived, time_s, np.asarray(self.in_hand.time_s))
        self.in_hand = DepthImage(depth=moment.depth, time_s=self._like(now))
        return self._like(moment.arrived)


class Fallible(HeightmapNetwork):
    """A network that tells nonsense where that is drawn."""

    wrong: Any = np.zeros(ROBOTS, np.bool_)

    def _ticks(self, robots: int, inputs: Any) -> Tick:
        tick = super()._ticks(robots, inputs)
        tick.height[self.wrong[:robots]] = WRONG_M
        return tick


class FallibleModel(torch.nn.Module):
    """The same on tensors."""

    def __init__(self, model: HeightmapModel) -> None:
        super().__init__()
        self.model, self.config, self.height_mean = model, model.config, model.height_mean
        self.wrong = torch.zeros(ROBOTS, dtype=torch.bool)

    def step(self, *inputs: torch.Tensor) -> tuple[Estimate, torch.Tensor]:
        estimate, hidden = self.model.step(*inputs)
        return estimate._replace(height=torch.where(self.wrong[:, None], WRONG_M, estimate.height)), hidden


def of_services(moments: list[Moment], path: Path) -> Iterator[Seen]:
    networks = [Fallible(ROBOT, path) for _ in range(ROBOTS)]
    services = [HeightmapService(network) for network in networks]
    for moment in moments:
        step, answers = moment.states.step, []
        for i, service in enumerate(services):
            networks[i].wrong = moment.wrong[i : i + 1]
            if moment.fresh[i]:
                service.reset()
            state = state_message(moment.states, i, time_ns=step * TICK_NS, step=step, mode=ControllerMode.RUN)
            image = frame(step, 10.0 * step, moment.depth[i]) if moment.arrived[i] else None
            answers.append(service.step(state, image, state.time_ns).height)
        yield Seen(np.array(answers), np.array([service.hidden for service in services]))


def of_roll_outs(moments: list[Moment], path: Path) -> Iterator[Seen]:
    class Cameras:
        camera = SHIPPED["ideal"]

        def expose(self, truth: Any, time_s: float) -> Any:
            del truth, time_s
            return np.zeros((ROBOTS, 48, 16), np.float32)

    network = Fallible(ROBOT, path)
    source = PredictedHeights(network, Cameras(), [Trial.draw(i) for i in range(ROBOTS)], PROFILE)
    moments = [replace(moment, depth=moment.depth * np.float32(0.001)) for moment in moments]
    images: Any = Arriving(moments[0].depth, np.asarray)
    source._images = images
    for moment in moments:
        images.moment, network.wrong = moment, moment.wrong
        nobody: Any = None
        yield Seen(source.heights(moment.states, nobody, moment.fresh), source._hidden.copy())


def of_device(moments: list[Moment], model: HeightmapModel) -> Iterator[Seen]:
    fallible: Any = FallibleModel(model)
    blank = late_images(ROBOTS, DeliveryModel(), NOMINAL_LATENCY, np.random.default_rng(0), "cpu")
    heights, legs = DeviceHeights(fallible, blank), LegKinematics(ROBOT)
    moments = [replace(m, depth=torch.from_numpy(m.depth.astype(np.int32))) for m in moments]
    images: Any = Arriving(moments[0].depth, torch.as_tensor)
    heights._images = images
    for moment in moments:
        images.moment, fallible.wrong = moment, torch.from_numpy(moment.wrong)
        sensed = torch.from_numpy(proprioception_of_states(moment.states, legs))
        found = heights.step(None, moment.states.step, sensed, torch.from_numpy(moment.fresh))
        yield Seen(found.numpy(), heights._hidden.numpy())


@pytest.mark.parametrize("seed", range(3))
def test_images_states_and_nonsense_lead_to_the_same_heights(
    seed: int, model_path: Path, model: HeightmapModel
) -> None:
    moments = drawn_moments(seed)
    services = list(of_services(moments, model_path))
    for other in (of_roll_outs(moments, model_path), of_device(moments, model)):
        for step, (expected, found) in enumerate(zip(services, other, strict=True)):
            np.testing.assert_allclose(found.height, expected.height, atol=1e-5, err_msg=f"{step}")
            np.testing.assert_allclose(found.hidden, expected.hidden, atol=1e-5, err_msg=f"{step}")
    assert len({seen.height.tobytes() for seen in services}) > TICKS // 2
