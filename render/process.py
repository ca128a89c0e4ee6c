"""The camera as a process: truth in, late depth frames out."""

import math

import numpy as np

from saltus.depth import depth_frame, depth_in_millimetres
from saltus.depth_camera import DepthCamera
from saltus.effects.camera import CameraChain
from saltus.effects.image_delivery import ROUNDING_S
from saltus.effects.signals import DepthImage
from saltus.render.exposure import Exposure
from saltus.wire.messages import DepthFrame, GroundTruth

RANDOM_STREAM = 0xCA3E7A  # of all that a seed draws, the camera has a stream of its own


def random_stream(seed: int) -> np.random.Generator:
    """Returns what the camera of a run or of a trial draws from."""
    return np.random.default_rng(np.random.SeedSequence([seed, RANDOM_STREAM]))


class CameraProcess:
    """Exposes at the rate of its camera and hands out each frame when it is due,
    by the effects of the link.
    """

    def __init__(
        self,
        camera: DepthCamera,
        exposure: Exposure,
        effects: CameraChain,
        rng: np.random.Generator,
    ) -> None:
        self._camera = camera
        self._exposure = exposure
        self._effects = effects
        self._state = effects.init((), rng)
        self._exposed: DepthImage | None = None
        self._taken = 0  # images that should have been by then, if none had been left out
        self._frame_ids: dict[int, int] = {}
        self._next_s = math.inf  # when the next image arrives
        self.due: DepthFrame | None = None
        """The newest frame that is due."""
        self.exposures = 0
        self.overruns = 0
        """Exposures that were left out because truth came late or not at all."""

    def step(self, truth: GroundTruth | None, now_ns: int) -> DepthFrame | None:
        """Takes in truth, None or repeated where nothing is new,
        and returns the frame that has become due, if any.

        `now_ns` is in the run's clock.
        """
        now_s = 1e-9 * now_ns
        if truth is not None and self._camera.taken_by(truth.step) > self._taken:
            self._expose(truth)
        elif now_s + ROUNDING_S < self._next_s:  # nothing new, and nothing has arrived
            return None
        assert self._exposed is not None  # noqa: S101 - else nothing would be under way
        image, self._state = self._effects.step(self._exposed, now_s, self._state)
        self._next_s = self._effects.next_arrival_s(now_s, self._state)
        if not np.isfinite(image.time_s):
            return None
        time_ns = round(1e9 * float(image.time_s))
        if self.due is not None and time_ns <= self.due.time_ns:
            return None
        self.due = self._frame(time_ns, image)
        return self.due

    def wait_s(self, now_ns: int, limit_s: float) -> float:
        """How long to wait for the next frame to become due; `limit_s` at most.

        Not at all for one that has become due since the last step, while its exposure took its
        time.
        """
        return min(max(self._next_s - 1e-9 * now_ns, 0.0), limit_s)

    def _expose(self, truth: GroundTruth) -> None:
        depth = self._camera.in_range(self._exposure.expose(truth))
        taken = int(self._camera.taken_by(truth.step))
        if self._exposed is not None:
            self.overruns += taken - self._taken - 1
        self._exposed = DepthImage(depth=depth, time_s=np.asarray(1e-9 * truth.time_ns))
        self._taken = taken
        self._frame_ids[truth.time_ns] = self.exposures
        self.exposures += 1

    def _frame(self, time_ns: int, image: DepthImage) -> DepthFrame:
        """Packs an image; frames that are older will not be asked for again."""
        frame_id = self._frame_ids[time_ns]
        self._frame_ids = {
            time: known for time, known in self._frame_ids.items() if time >= time_ns
        }
        depth = depth_in_millimetres(image.depth)
        return depth_frame(self._exposure.intrinsics, depth, time_ns=time_ns, frame_id=frame_id)
