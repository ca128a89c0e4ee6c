"""Parameters of the stereo camera from a recording of a scene at rest,
each with its error or the reason for none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from saltus.config import read_toml, to_toml
from saltus.depth import Intrinsics
from saltus.depth_camera import DepthCamera
from saltus.effects.effect import Effect
from saltus.errors import RecordingError
from saltus.recordings.realsense import ENDINGS, read_realsense
from saltus.recordings.recording import read_recording
from saltus.render.postfilter import DepthUnit
from saltus.render.stereo.camera import UNFILTERED, StereoConfig
from saltus.render.stereo.fit_baseline import fit_baseline
from saltus.render.stereo.fit_edges import EdgeCurves, edge_curves, flying_fraction, hole_fraction
from saltus.render.stereo.fit_noise import (
    NoiseCurves,
    correlation_px,
    noise_curves,
    noise_persistence,
    range_exponent,
    sigma_inverse,
)
from saltus.render.stereo.fit_step import fit_step
from saltus.render.stereo.optics import BASELINE_M, StereoOptics
from saltus.render.stereo.static_scene import (
    StaticScene,
    StereoEstimate,
    static_scene,
    stereo_estimate,
    untestable_estimate,
)
from saltus.wire.messages import DepthFrame

FEW_FRAMES = 10  # below, a hole at an edge may be there in all of them
WIDENED = "from few frames: holes at edges that never closed count as shadow and widen it"
ASSUMED = (
    f"with the data sheet's baseline of {1e3 * BASELINE_M:g} mm, as the recording does not show it"
)

Fitted = TypeVar("Fitted", bound=Effect)


@dataclass(frozen=True, kw_only=True)
class StereoParameters:
    """Parameters of a stereo camera's noise that can be fitted; units in the names."""

    baseline_m: StereoEstimate
    sigma_px: StereoEstimate
    """Sub-pixel noise."""
    range_exponent: StereoEstimate
    """Exponent of the growth of the noise with range: 2 if it is that of stereo. Not a parameter of
    the model: a check."""
    correlation_px: StereoEstimate
    persistence_s: StereoEstimate
    step_px: StereoEstimate
    """Step of the disparity."""
    maximum_px: StereoEstimate
    """Largest disparity of the search."""
    margin_px: StereoEstimate
    """Margin of the search at the left of the image; below 0 the invalid band is wider than f B /
    z."""
    hole_fraction: StereoEstimate
    """At edges."""
    flying_fraction: StereoEstimate
    """At edges."""
    reach_m: StereoEstimate
    """Where the signal gets too weak."""
    depth_unit_m: StereoEstimate


@dataclass(frozen=True, kw_only=True, eq=False)
class FitResult:
    """A stereo camera whose noise was fitted to a recording, and what was measured."""

    parameters: StereoParameters
    image: Intrinsics
    scene: StaticScene
    noise: NoiseCurves | None
    """None where there are too few frames."""
    edges: EdgeCurves

    @property
    def baseline_m(self) -> float:
        """Fitted, or the data sheet's."""
        return self.parameters.baseline_m.value or BASELINE_M

    @property
    def optics(self) -> StereoOptics:
        """Optics of the recorded images, whose first column is taken to be the sensor's."""
        return StereoOptics(focal_px=self.scene.fx, baseline_m=self.baseline_m)

    @property
    def config(self) -> StereoConfig:
        """The camera as fitted; defaults where the recording shows nothing, and no post-filters."""
        found, base = self.parameters, UNFILTERED

        def changed(effect: Fitted, **values: StereoEstimate) -> Fitted:
            return replace(
                effect, **{name: e.value for name, e in values.items() if e.value is not None}
            )

        return replace(
            base,
            disparity_noise=changed(
                base.disparity_noise,
                sigma=found.sigma_px,
                correlation=found.correlation_px,
                persistence_s=found.persistence_s,
            ),
            disparity_step=changed(base.disparity_step, step=found.step_px),
            search_range=changed(base.search_range, margin=found.margin_px),
            edge_holes=changed(base.edge_holes, fraction=found.hole_fraction),
            flying_pixels=changed(base.flying_pixels, fraction=found.flying_fraction),
            depth_unit=DepthUnit(unit=self.scene.unit_m),
        )

    @property
    def camera(self) -> DepthCamera:
        """The fitted camera, where the robot has its own, with the rate and latency of a D435i."""
        errors = read_toml(to_toml(self.config))
        return DepthCamera(
            name="fitted", image=self.image, baseline_m=self.baseline_m, stereo=errors
        )

    def to_toml(self) -> str:
        """The camera as `saltus.depth_camera.load_camera` reads it.

        Comments say what each parameter rests on.
        """
        found = vars(self.parameters).items()
        return (
            "".join(f"# {name:16} {estimate}\n" for name, estimate in found)
            + f"\n{self.camera.to_toml()}"
        )


def load_frames(path: Path) -> list[DepthFrame]:
    """Depth frames of a recording: of a RealSense camera (.bag, .db3),
    or of a run of Saltus (.mcap).

    Raises:
        RecordingError: neither, or not readable.
    """
    if path.suffix in ENDINGS:
        return list(read_realsense(path))
    if path.suffix == ".mcap":
        messages = [message for _, _, message in read_recording(path).messages("camera/depth")]
        return [message for message in messages if isinstance(message, DepthFrame)]
    raise RecordingError(
        f"{path} is neither a RealSense recording (.bag, .db3) nor a recorded run (.mcap)"
    )


def fit_stereo(frames: Sequence[DepthFrame]) -> FitResult:
    """Fits the stereo camera to a recording.

    The focal length is taken from the frames. Noise gives sigma over f B, the comb of quantised
    disparities step over f B; the left band and shadows give B, so that all three are known where a
    wall and something near are in view.

    Args:
        frames: of one camera, raw (no post-filters); the longest part in which nothing moves is
            used.

    Raises:
        RecordingError: no frames, frames of different cameras or modes, or nothing valid.
    """
    scene = static_scene(frames)
    curves, edges = noise_curves(scene), edge_curves(scene)
    height, width = frames[0].depth.shape
    intrinsics = {name: float(getattr(frames[0], name)) for name in ("fx", "fy", "cx", "cy")}
    return FitResult(
        parameters=_parameters(scene, curves, edges),
        image=Intrinsics(width=width, height=height, **intrinsics),
        scene=scene,
        noise=curves if isinstance(curves, NoiseCurves) else None,
        edges=edges,
    )


def _parameters(
    scene: StaticScene, curves: NoiseCurves | str, edges: EdgeCurves
) -> StereoParameters:
    baseline, margin = fit_baseline(scene)
    if scene.frames < FEW_FRAMES:
        baseline = _noted(baseline, WIDENED)
    used = baseline.value or BASELINE_M
    note = "" if baseline.testable else ASSUMED
    noise = _of_noise(scene, curves)
    # inverse depths [1/m] as disparities [px]
    pixels = {
        f"{name}_px": _noted(_scaled(noise.pop(f"{name}_inverse"), scene.fx * used, baseline), note)
        for name in ("sigma", "step")
    }
    return StereoParameters(
        baseline_m=baseline,
        **pixels,
        **noise,
        maximum_px=_maximum(scene, used),
        margin_px=margin,
        hole_fraction=hole_fraction(edges)
        if scene.frames > 1
        else untestable_estimate("one frame"),
        reach_m=_reach(scene),
        depth_unit_m=stereo_estimate(scene.unit_m, 0.0, "stated by the recording"),
    )


NEED_MANY_FRAMES = (
    "sigma_inverse", "step_inverse", "range_exponent", "correlation_px", "persistence_s",
    "flying_fraction",
)  # fmt: skip


def _of_noise(scene: StaticScene, curves: NoiseCurves | str) -> dict[str, StereoEstimate]:
    """Estimates of `NEED_MANY_FRAMES`."""
    if isinstance(curves, str):
        return dict.fromkeys(NEED_MANY_FRAMES, untestable_estimate(curves))
    spread = curves.variance_inverse**0.5
    step = fit_step(scene, spread)
    found = (
        sigma_inverse(curves, scene, step), step, range_exponent(curves),
        correlation_px(curves, step),
        noise_persistence(curves, scene, step), flying_fraction(scene, spread),
    )  # fmt: skip
    return dict(zip(NEED_MANY_FRAMES, found, strict=True))


def _scaled(estimate: StereoEstimate, factor: float, baseline: StereoEstimate) -> StereoEstimate:
    """Inverse depth [1/m] as disparity [px]; the error of the baseline comes in."""
    if estimate.value is None or estimate.error is None:
        return estimate
    relative = estimate.error / estimate.value
    if baseline.value is not None and baseline.error is not None:
        relative = (relative**2 + (baseline.error / baseline.value) ** 2) ** 0.5
    return stereo_estimate(estimate.value * factor, estimate.value * factor * relative)


def _noted(estimate: StereoEstimate, note: str) -> StereoEstimate:
    return replace(estimate, note=note) if estimate.testable and note else estimate


def _maximum(scene: StaticScene, baseline_m: float) -> StereoEstimate:
    largest = float(scene.median.max())
    return untestable_estimate(
        f"the nearest surface, at {1.0 / largest:.2f} m, has a disparity of "
        f"{largest * scene.fx * baseline_m:.0f} px: "
        "nothing is so near that the search must fail"
    )


def _reach(scene: StaticScene) -> StereoEstimate:
    known = scene.median[scene.median > 0.0]
    return untestable_estimate(
        f"the farthest surface is at {1.0 / float(known.min()):.1f} m: needs a matt wall, square "
        "on, from 5 m away on"
    )
