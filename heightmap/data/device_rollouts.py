"""Closed loops as in `saltus.heightmap.data.closed_loop`, for thousands of robots on one device.

Each robot has a camera, a speed and a rhythm of its own; who falls or arrives starts again.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from saltus.config import from_toml
from saltus.depth_camera import load_camera
from saltus.effects.effect import map_arrays
from saltus.effects.heightmap_shift import refuse_shift
from saltus.effects.profile import load_profile
from saltus.errors import SaltusError
from saltus.extras import packages_of
from saltus.gpu import has_gpu
from saltus.grid import load_grid
from saltus.heightmap.data.arriving_images import LateImages
from saltus.heightmap.data.delivery import TICK_S, TRAINING
from saltus.heightmap.data.device_cameras import DeviceCameras, late_images
from saltus.heightmap.data.device_recording import DeviceRecording, RecordedBatch
from saltus.heightmap.data.randomisation import RHYTHM, SPEED, vary_planner
from saltus.heightmap.model import HeightmapModel
from saltus.heightmap.service.proprioception_vector import proprioception_of_states
from saltus.heightmap.service.sight import Sight
from saltus.heightmap.settings import DeviceLoop
from saltus.loop.heights import true_heights
from saltus.loop.loop import STAND_STEPS
from saltus.policy.bounds import values_of
from saltus.policy.env.curriculum import CurriculumSettings
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.randomisation import RandomisationSettings
from saltus.policy.env.settings import JumpTrainSettings
from saltus.policy.policy_features import PROPRIOCEPTION_SIZE, read_features
from saltus.policy.scripted import ScriptedPlanner
from saltus.policy.training.export import DeployedPolicy
from saltus.policy.training.train import make_engine
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.terrain.course_law import KINDS


class DeviceRollouts:
    """Simulated robots on a GPU, made ready once; every batch starts all of them anew.

    `policy` is what `read_policy` returns; its task, but for the courses, is theirs, and so is the
    profile that it was trained with where none is given. Without a predictor in the loop the policy
    sees what its training showed it.
    """

    def __init__(
        self,
        loop: DeviceLoop,
        policy: dict[str, Any],
        predictor: HeightmapModel | None,
        *,
        device: str,
        seed: int,
        profile: str | None = None,
    ) -> None:
        self.loop = loop
        self._device = torch.device(device)
        self._rng = np.random.default_rng(seed)
        self._generator = torch.Generator(self._device).manual_seed(int(self._rng.integers(2**62)))
        config = from_toml(JumpTrainSettings, policy["config"]).env
        self.profile = profile or config.profile
        """Profile of all robots."""
        config = replace(
            config,
            curriculum=_curriculum(loop),
            profile=self.profile,
            randomisation=_grown(config.randomisation),
        )
        robot = load_robot(loop.robot)
        self._grid = load_grid(loop.grid)
        self._heights_at = slice(PROPRIOCEPTION_SIZE, PROPRIOCEPTION_SIZE + self._grid.size)
        engine = make_engine(robot, loop.robots, config, device)
        self._env = JumpEnv(
            engine, config, self._grid, seed=int(self._rng.integers(2**62)), device=device
        )
        self._qpos, self._legs = torch.as_tensor(engine.qpos), LegKinematics(robot)
        self._policy = DeployedPolicy(policy).to(self._device)
        self._model = None if predictor is None else predictor.to(self._device).eval()
        cameras = {name: load_camera(name) for name in loop.cameras}
        known = load_profile(self.profile, robot)
        if predictor is not None:
            refuse_shift(known.heightmap, "a predictor")
        first = cameras[loop.cameras[0]]
        # no more images are under way than are taken meanwhile
        self._latency = replace(
            first.delivered(known).camera_chain.latency, dt_s=1.0 / first.rate_hz
        )
        self._cameras = DeviceCameras(robot, self._env.courses(), cameras, known, device, self._rng)
        self._recording = DeviceRecording(
            loop.robots, loop.ticks, self._grid.size, cameras, self._device, plans=loop.plans
        )

    @torch.no_grad()
    def batch(self, told: Callable[[], object] = lambda: None) -> RecordedBatch:
        """Lets all robots run for `loop.ticks`; `told` is called after each."""
        env = self._env
        self._cameras.replace(self._rng)
        env.set_levels(env.memory.level)
        seen = self._seen()
        speed, rhythm = (low + (high - low) * self._uniform() for low, high in (SPEED, RHYTHM))
        by_rules, rules = (self._uniform() >= self.loop.learned)[:, None], self._rules()
        # The deployed controller stands before it obeys
        stands_until = STAND_STEPS * self._uniform()
        transition, fresh = (
            env.transition(),
            torch.ones(self.loop.robots, dtype=torch.bool, device=self._device),
        )
        for tick in range(self.loop.ticks):
            sensed, qpos = proprioception_of_states(env.states(), self._legs), self._qpos.float()
            images = self._cameras.expose(env.courses(), qpos, tick, fresh)
            self._recording.add(tick, sensed, self._true_heights(), fresh, images)
            shown = transition.actor
            if self.loop.plans:
                self._add_plans(tick, shown)
            if seen is not None:
                (late, sight), time_s = seen, tick * TICK_S
                arrived = late.step(images.get(self.loop.cameras[0]), time_s, fresh)
                heights = sight.step(arrived, late.in_hand, time_s, sensed, fresh)
                shown[:, self._heights_at] = heights
            plan = self._policy(shown)
            plan[:, 0] *= rhythm
            plan[:, 1] *= speed
            if self.loop.learned < 1.0:
                plan = torch.where(
                    by_rules, values_of(rules.step(*read_features(shown, self._grid))), plan
                )
            env.standing.copy_(tick < stands_until)
            transition = env.step(env.config.bounds.normalised(plan))
            fresh = transition.done
            told()
        kinds = tuple(env.config.curriculum.shares)
        return self._recording.to_host([kinds[kind] for kind in env.memory.kind.tolist()])

    def _true_heights(self) -> Tensor:
        """The terrain relative to the base along its yaw [m], shape (n, points)."""
        qpos = self._qpos.float()
        heights: Tensor = true_heights(self._env.courses(), qpos[:, :3], qpos[:, 3:7], self._grid)
        return heights

    def _add_plans(self, tick: int, shown: Tensor) -> None:
        """Adds the policy's plans where it sees the ground as it is,
        whatever the robots are shown.
        """
        exact = shown.clone()
        exact[:, self._heights_at] = self._true_heights()
        plan = self._env.config.bounds.normalised(self._policy(exact))
        self._recording.add_plans(tick, shown[:, :PROPRIOCEPTION_SIZE], plan)

    def crowded_share(self) -> float:
        """Share of the robots whose physics left out contacts since the last call,
        for want of room.
        """
        return self._env.crowded_share()

    def _rules(self) -> ScriptedPlanner:
        """The scripted planner, for each robot with numbers of its own."""
        numbers = vary_planner(self._rng, self.loop.variation, self.loop.robots)
        tensors = map_arrays(
            lambda each: torch.as_tensor(each, dtype=torch.float32, device=self._device), numbers
        )
        return ScriptedPlanner(self._env.robot, self._grid, tensors)

    def _seen(self) -> tuple[LateImages, Sight] | None:
        """Returns what the images of a batch come through, to a predictor in the loop."""
        if self._model is None:
            return None
        late = late_images(self.loop.robots, TRAINING, self._latency, self._rng, self._device)
        return late, Sight(self._model, late.in_hand.depth)

    def _uniform(self) -> Tensor:
        return torch.rand(self.loop.robots, generator=self._generator, device=self._device)


def _curriculum(loop: DeviceLoop) -> CurriculumSettings:
    """The terrains of a loop on one level: who falls gets no easier course."""
    times = {name: float(loop.terrains.count(name)) for name in (*KINDS, *loop.terrains)}
    own = {name: share for name, share in times.items() if name not in KINDS}
    shares = {name: times[name] for name in KINDS}
    return CurriculumSettings(**shares, own=own, levels=1, hardest=loop.hardest)


def _grown(randomisation: RandomisationSettings) -> RandomisationSettings:
    """As at the end of a training, whose ranges may have grown on the way."""
    return replace(randomisation, wide=replace(randomisation.wide, growth_msteps=(0.0, 0.0)))


def checked_device(device: str) -> str:
    """The device by its full name; `SaltusError` where there is no GPU, or no physics for it."""
    if device == "cpu":
        return device
    if not has_gpu():
        raise SaltusError("no GPU found: use --device cpu, or a machine with one")
    with packages_of("gpu", "physics on a GPU"):
        import saltus.sim.warp_engine  # noqa: F401
    return "cuda:0"
