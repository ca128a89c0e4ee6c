"""The camera as a process: truth in, late depth frames out."""

import numpy as np

from saltus.depth import depth_frame, depth_in_millimetres
from saltus.effects.camera import CameraChain
from saltus.effects.signals import DepthImage
from saltus.render.exposure import Exposure
from saltus.wire.messages import DepthFrame, GroundTruth

EXPOSURE_STEPS = 2  # policy steps at 100 Hz: 50 Hz
RANDOM_STREAM = 0xCA3E7A  # of all that a seed draws, the camera has a stream of its own


class CameraProcess:
    """Exposes at every second policy step and hands out each frame when it is due, by the effects of the link."""

    def __init__(self, exposure: Exposure, effects: CameraChain, rng: np.random.Generator) -> None:
        self._exposure = exposure
        self._effects = effects
        self._state = effects.init((), rng)
        self._exposed: DepthImage | None = None
        self._exposed_step = -EXPOSURE_STEPS
        self._frame_ids: dict[int, int] = {}
        self.due: DepthFrame | None = None
        """The newest frame that is due."""
        self.exposures = 0
        self.overruns = 0
        """Exposures that were left out because truth came late or not at all."""

    def step(self, truth: GroundTruth | None, now_ns: int) -> DepthFrame | None:
        """Takes in truth, None or repeated where nothing is new, and returns the frame that has become due, if any.

        `now_ns` is in the run's clock.
        """
        if truth is not None and truth.step >= self._exposed_step + EXPOSURE_STEPS:
            self._expose(truth)
        if self._exposed is None:
            return None
        image, self._state = self._effects.step(self._exposed, 1e-9 * now_ns, self._state)
        if not np.isfinite(image.time_s):
            return None
        time_ns = round(1e9 * float(image.time_s))
        if self.due is not None and time_ns <= self.due.time_ns:
            return None
        self.due = self._frame(time_ns, image)
        return self.due

    def wait_s(self, now_ns: int, limit_s: float) -> float:
        """How long to wait for the next frame to become due; `limit_s` at most."""
        arrival = self._effects.next_arrival_s(1e-9 * now_ns, self._state)
        return float(np.clip(arrival - 1e-9 * now_ns, 0.0, limit_s))

    def _expose(self, truth: GroundTruth) -> None:
        depth = self._exposure.expose(truth)
        if self._exposed is not None:
            self.overruns += (truth.step - self._exposed_step) // EXPOSURE_STEPS - 1
        self._exposed = DepthImage(depth=depth, time_s=np.asarray(1e-9 * truth.time_ns))
        self._exposed_step = truth.step
        self._frame_ids[truth.time_ns] = self.exposures
        self.exposures += 1

    def _frame(self, time_ns: int, image: DepthImage) -> DepthFrame:
        """Packs an image; frames that are older will not be asked for again."""
        frame_id = self._frame_ids[time_ns]
        self._frame_ids = {time: known for time, known in self._frame_ids.items() if time >= time_ns}
        depth = depth_in_millimetres(image.depth)
        return depth_frame(self._exposure.intrinsics, depth, time_ns=time_ns, frame_id=frame_id)
