"""The cameras of robots in roll-outs on processors, as each trial draws them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices, Singles
from saltus.depth import MODEL_CAMERA, Intrinsics, is_within_model
from saltus.depth_camera import DepthCamera
from saltus.effects.camera import drawn_around
from saltus.effects.effect import stack_states
from saltus.effects.image_pixels import to_images
from saltus.effects.signals import DepthImage
from saltus.heightmap.data.arriving_images import LateImages
from saltus.heightmap.scan.scan_camera import read_lens
from saltus.render.camera import RobotCamera
from saltus.render.eyes import SAMPLED, Eyes
from saltus.render.process import random_stream
from saltus.render.stereo.camera import StereoCamera, StereoConfig, StereoState
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_embree import StereoEmbree
from saltus.setup import Setup
from saltus.sim.plant_state import PlantState
from saltus.terrain.terrain import Terrain


def rendered_intrinsics(camera: DepthCamera, *, whole: bool = False) -> Intrinsics:
    """The pixels in which images of a camera are rendered here.

    Those of stereo cameras are finer than the model's. Of a camera that sees more than the model
    does, `whole` images are the pixels of its own that the scan reads.
    """
    if whole and not is_within_model(camera.image):
        return read_lens(camera.image)
    return MODEL_CAMERA if camera.ideal else SAMPLED


def robot_cameras(
    setups: Sequence[Setup],
    errors: StereoConfig | None = None,
    rngs: Sequence[np.random.Generator] | None = None,
    *,
    whole: bool = False,
) -> tuple[Eyes, LateImages]:
    """The cameras of a batch and the links that carry their images,
    with the random numbers of each trial's process.

    Args:
        setups: Each robot's; camera and profile are those of the first.
        errors: Of stereo matching, which may have one value a robot; those of the camera, if None.
        rngs: Each robot's, for these errors: so they do not depend on who else is in the batch.
        whole: Images are those of `rendered_intrinsics`: without it means of some of their pixels.
    """
    camera, robot, profile = setups[0].camera, setups[0].robot, setups[0].profile
    trials = [setup.trial for setup in setups]
    drawn = drawn_around(
        profile.camera,
        latency_s=np.array([trial.camera_delay_s for trial in trials]),
        jitter_s=np.array([trial.camera_jitter_s for trial in trials]),
    )
    claimed = rendered_intrinsics(camera, whole=whole)
    chain = to_images(replace(profile, camera=drawn), claimed.fx).camera_chain
    memory = stack_states([chain.init((), random_stream(trial.seed)) for trial in trials])
    view, optics = (
        RobotCamera.on(robot, claimed).moved(profile.view_chain),
        StereoOptics.behind(claimed, camera),
    )
    stereo: StereoCamera | None = None
    state: StereoState = ()
    if not camera.ideal:
        stereo = StereoCamera(errors or StereoConfig.of(camera), optics)
        streams = rngs or [random_stream(trial.seed) for trial in trials]
        state = stack_states([stereo.init((), rng) for rng in streams])
    taken = chain.taken
    given, carried = memory[: len(taken.effects)], memory[len(taken.effects) :]
    views = _EmbreeBatch([setup.terrain for setup in setups], optics, view)
    eyes = Eyes(camera, views, taken, given, stereo, state, whole=whole)
    seen = claimed if whole else MODEL_CAMERA
    blank = np.zeros((len(trials), seen.height, seen.width), np.uint16)
    nothing = DepthImage(depth=blank, time_s=np.zeros(len(trials)))
    return eyes, LateImages(chain.carried, carried, nothing)


class _EmbreeBatch:
    """See `saltus.render.eyes.BatchRenderer`:
    images of robots on the same terrain are rendered together.
    """

    def __init__(
        self, terrains: Sequence[Terrain], optics: StereoOptics, view: RobotCamera
    ) -> None:
        robots: dict[int, list[int]] = {}
        for i, terrain in enumerate(terrains):
            robots.setdefault(id(terrain), []).append(i)
        self._shape = (len(terrains), view.intrinsics.height, view.intrinsics.width)
        self._groups = [
            (StereoEmbree(terrains[group[0]], optics, view), np.asarray(group))
            for group in robots.values()
        ]

    def depth(self, truth: PlantState) -> Singles:
        depth = np.empty(self._shape, np.float32)
        for view, robots in self._groups:
            depth[robots] = view.render_batch(*_poses(truth, robots))
        return depth

    def pair(self, truth: PlantState) -> tuple[Singles, NDArray[np.bool_]]:
        depth, hidden = np.empty(self._shape, np.float32), np.empty(self._shape, np.bool_)
        for view, robots in self._groups:
            depth[robots], hidden[robots] = view.render_pair_batch(*_poses(truth, robots))
        return depth, hidden


def _poses(truth: PlantState, robots: Indices) -> tuple[Floats, Floats, Floats]:
    """Positions, quaternions and joint angles of some robots."""
    pose = truth.position_base_in_world, truth.quaternion_base_in_world, truth.joint_position
    return pose[0][robots], pose[1][robots], pose[2][robots]
