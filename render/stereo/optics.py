"""The geometry that a depth image and the stereo sensor behind it share."""

from dataclasses import dataclass

from saltus.depth import BASELINE_M as BASELINE_M
from saltus.depth import D435I, Intrinsics
from saltus.depth_camera import DepthCamera
from saltus.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class StereoOptics:
    """A rectified pair of imagers, and where the samples of an image lie on the left one.

    Depth is seen from the left imager; the right one is `baseline_m` to its right. Disparities and
    all other lengths in pixels are in pixels of the sensor, also where an image has fewer samples:
    `pitch_x` and `pitch_y` say how many pixels lie between samples.
    """

    focal_px: float
    """Focal length of the sensor [px]."""
    baseline_m: float = BASELINE_M
    first_column: float = 0.0
    """Column of the sensor at which the image begins (its left edge, not the centre of its first
    sample) [px]."""
    pitch_x: float = 1.0
    """Columns of the sensor between neighbouring samples."""
    pitch_y: float = 1.0
    """Rows of the sensor between neighbouring samples."""

    def __post_init__(self) -> None:
        for name in ("focal_px", "baseline_m", "pitch_x", "pitch_y"):
            value = getattr(self, name)
            if not 0.0 < value < float("inf"):
                raise ConfigError(f"stereo optics: {name} = {value!r} must be a number above 0")

    @classmethod
    def of(
        cls, camera: Intrinsics, sensor: Intrinsics = D435I, baseline_m: float = BASELINE_M
    ) -> "StereoOptics":
        """The optics behind an image of any resolution with the optical axis of its sensor,
        in its matching mode.

        Raises:
            ConfigError: a focal length or the baseline is not above 0.
        """
        for name, focal in (
            ("camera.fx", camera.fx),
            ("camera.fy", camera.fy),
            ("sensor.fx", sensor.fx),
        ):
            if not 0.0 < focal < float("inf"):
                raise ConfigError(
                    f"stereo optics: focal length {name} = {focal!r} px must be above 0"
                )
        pitch = sensor.fx / camera.fx
        return cls(
            focal_px=sensor.fx,
            baseline_m=baseline_m,
            first_column=sensor.cx - camera.cx * pitch,
            pitch_x=pitch,
            pitch_y=sensor.fx / camera.fy,
        )

    @classmethod
    def behind(cls, image: Intrinsics, camera: DepthCamera) -> "StereoOptics":
        """The optics behind an image that a camera takes, or that stands for one of its own."""
        return cls.of(image, camera.matching, camera.baseline_m)

    @property
    def disparity_at_1m(self) -> float:
        """Focal length times baseline: disparity [px] times depth [m]."""
        return self.focal_px * self.baseline_m
