"""Robots see alike wherever they are: one by a service, many on numpy or on torch."""

from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from heightmap_inputs import WARMUP, frame
from samples import ROBOT

from saltus.effects.signals import DepthImage
from saltus.heightmap.model import HeightmapModel
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION, proprioception_of_states
from saltus.heightmap.service.service import HeightmapService
from saltus.heightmap.service.sight import NetworkOutputs, Sight
from saltus.robots.legs import LegKinematics
from saltus.states import ProprioceptionArrays, robot_state_message, standing_state
from saltus.wire.messages import ControllerMode

ROBOTS, TICKS, TICK_NS = 3, 180, 10_000_000
NONSENSE = (("height", 3.0), ("half_width_90", np.nan), ("hidden", 1.1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """What is drawn for one tick of all robots."""

    states: ProprioceptionArrays
    depth: Any
    """[mm], uint16, shape (robots, 48, 16)."""
    arrived: Any
    """Whose image that is, bool, shape (robots,), as the two that follow."""
    fresh: Any
    wrong: Any
    """Whose network tells nonsense."""


class Seen(NamedTuple):
    """What robots make of a tick, each of shape (robots, ...)."""

    height: Any
    half_width_90: Any
    image: Any
    """Step at which that in use was taken, or -1."""
    bad_outputs: Any
    warm: Any


def drawn_moments(seed: int) -> list[Moment]:
    """Images come now and then, some with hardly a valid pixel; after long pauses none counts."""
    rng, stands = np.random.default_rng(seed), standing_state(ROBOT)
    moments = []
    for step in range(TICKS):
        joints = stands.joint_position + 0.1 * rng.normal(size=(ROBOTS, 12))
        together = {
            name: np.stack([getattr(stands, name)] * ROBOTS)
            for name in {each.name for each in fields(ProprioceptionArrays)}
            - {"step", "joint_position"}
        }
        valid = rng.uniform(size=(ROBOTS, 48, 16)) < rng.choice([0.1, 0.9], (ROBOTS, 1, 1))
        moments.append(
            Moment(
                states=ProprioceptionArrays(joint_position=joints, step=step, **together),
                depth=np.where(valid, rng.integers(1, 5000, valid.shape), 0).astype(np.uint16),
                arrived=(rng.uniform(size=ROBOTS) < 0.3) & (step % 60 > 20),
                fresh=rng.uniform(size=ROBOTS) < (0.01 if step else 1.0),
                wrong=rng.uniform(size=ROBOTS) < (0.7 if step % 50 > 40 else 0.05),
            )
        )
    return moments


class Fallible(HeightmapNetwork):
    """A network that tells nonsense where that is drawn."""

    wrong: Any = np.zeros(ROBOTS, np.bool_)

    def tick(self, *inputs: Any) -> NetworkOutputs:
        return nonsense(super().tick(*inputs), self.wrong)


class FallibleModel:
    """The same on tensors."""

    def __init__(self, model: HeightmapModel) -> None:
        self.hidden_size, self.points = model.hidden_size, model.points
        self._model, self.wrong = model, torch.zeros(ROBOTS, dtype=torch.bool)

    def tick(self, *inputs: Any) -> NetworkOutputs:
        return nonsense(self._model.tick(*inputs), self.wrong)


def nonsense(tick: NetworkOutputs, wrong: Any) -> NetworkOutputs:
    for robot in np.flatnonzero(wrong):
        kind, value = NONSENSE[robot]
        getattr(tick, kind)[robot if len(tick.height) > 1 else 0] = value
    return tick


def of_services(moments: list[Moment], path: Path) -> Iterator[Seen]:
    networks = [Fallible(ROBOT, path) for _ in range(ROBOTS)]
    services = [HeightmapService(network) for network in networks]
    for moment in moments:
        step, answers = moment.states.step, []
        for i, service in enumerate(services):
            networks[i].wrong = moment.wrong & (np.arange(ROBOTS) == i)
            if moment.fresh[i]:
                service.reset()
            time_ns, mode = step * TICK_NS, ControllerMode.RUN
            state = robot_state_message(moment.states, i, time_ns=time_ns, step=step, mode=mode)
            image = frame(step, 10.0 * step, moment.depth[i]) if moment.arrived[i] else None
            answers.append(service.step(state, image, state.time_ns))
        yield Seen(
            np.array([answer.height for answer in answers]),
            np.array([answer.half_width_90 for answer in answers]),
            np.array([answer.frame_id for answer in answers]),
            np.array([service.bad_outputs for service in services]),
            np.array([service.warm for service in services]),
        )


def of_batch(moments: list[Moment], network: Any, array: Callable[[Any], Any]) -> Iterator[Seen]:
    legs, in_hand_s = LegKinematics(ROBOT), np.full(ROBOTS, -np.inf)
    whole = [m.depth.astype(np.int32 if array is torch.as_tensor else np.uint16) for m in moments]
    sight = Sight(network, array(whole[0]))
    for moment, depth in zip(moments, whole, strict=True):
        time_s, network.wrong = moment.states.time_s, moment.wrong
        in_hand_s = np.where(moment.arrived, time_s, in_hand_s)
        image = DepthImage(depth=array(depth), time_s=array(in_hand_s))
        features = array(proprioception_of_states(moment.states, legs))
        sight.step(array(moment.arrived), image, time_s, features, array(moment.fresh))
        captured_s = np.asarray(sight.captured_s)
        yield Seen(
            np.asarray(sight.height),
            np.asarray(sight.half_width_90),
            np.where(np.isfinite(captured_s), np.rint(100.0 * captured_s), -1),
            np.asarray(sight.bad_outputs),
            np.asarray(sight.images_seen >= WARMUP),
        )


@pytest.mark.sample(1)
@pytest.mark.parametrize("seed", range(3))
def test_images_states_and_nonsense_lead_to_the_same_heights(
    seed: int, model_path: Path, model: HeightmapModel
) -> None:
    moments = drawn_moments(seed)
    services = list(of_services(moments, model_path))
    on_numpy = of_batch(moments, Fallible(ROBOT, model_path), np.asarray)
    on_torch = of_batch(moments, FallibleModel(model), torch.as_tensor)
    for expected, *others in zip(services, on_numpy, on_torch, strict=True):
        for found in others:
            for name, value in expected._asdict().items():
                np.testing.assert_allclose(getattr(found, name), value, atol=1e-5, err_msg=name)
    for kind in ("height", "bad_outputs", "warm", "image"):
        assert len({getattr(seen, kind).tobytes() for seen in services}) > 2, kind


def test_on_a_device_no_step_waits_for_a_value(model: HeightmapModel) -> None:
    """Tensors that have a shape but no values go through: to ask for a value raises."""
    tensors = torch.device("meta")
    network = deepcopy(model).to(tensors)
    depth = torch.zeros(ROBOTS, 48, 16, dtype=torch.int32, device=tensors)
    time_s = torch.zeros(ROBOTS, dtype=torch.float64, device=tensors)
    mask = torch.zeros(ROBOTS, dtype=torch.bool, device=tensors)
    sight, image = Sight(network, depth), DepthImage(depth=depth, time_s=time_s)
    for k in range(3):
        features = torch.zeros(ROBOTS, len(PROPRIOCEPTION), device=tensors)
        height = sight.step(mask, image, 0.01 * k, features, mask)
        assert (tuple(height.shape), height.device) == ((ROBOTS, 30), tensors)
