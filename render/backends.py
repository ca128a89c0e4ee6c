"""Which back end renders."""

import ctypes.util
from collections.abc import Callable, Sequence
from typing import NamedTuple

from saltus.config import RendererName as RendererName
from saltus.depth import Intrinsics
from saltus.errors import SaltusError, check_known
from saltus.render.camera import RobotCamera
from saltus.render.renderer import Renderer as Renderer
from saltus.render.renderer import StereoRenderer
from saltus.render.stereo.optics import StereoOptics
from saltus.terrain.terrain import Terrain

NAMES: tuple[RendererName, ...] = ("auto", "embree", "pyrender", "warp")
RASTER_PIXELS = 6_000
"""From this many pixels on, one image is made faster by pyrender than by Embree: 0.4 ms and 0.01 us
a pixel against 0.08 us a ray, with some legs in view (`saltus bench render`)."""
STEREO_PREFERENCE = ("embree", "pyrender")


class RenderBackEnd(NamedTuple):
    """The renderers of one back end (Embree, pyrender or Warp): for single views and for stereo
    pairs.
    """

    single: Callable[[Terrain, RobotCamera], Renderer]
    pair: Callable[[Terrain, StereoOptics, RobotCamera], StereoRenderer]


def make_renderer(name: str, terrain: Terrain, camera: RobotCamera) -> Renderer:
    """A renderer by name; "auto" is the fastest that this machine has for one image of that size.

    Raises:
        ConfigError: no such back end.
        SaltusError: the back end cannot be loaded.
    """
    return _loaded(name, preference(camera.intrinsics)).single(terrain, camera)


def make_stereo(
    name: str, terrain: Terrain, optics: StereoOptics, camera: RobotCamera
) -> StereoRenderer:
    """A renderer of both views by name; "auto" is Embree, whose second view is exact.

    Errors as `make_renderer`.

    Args:
        name: of the back end.
        terrain: to look at.
        optics: of the pair, for images of `camera`.
        camera: the left imager.
    """
    return _loaded(name, STEREO_PREFERENCE).pair(terrain, optics, camera)


def _loaded(name: str, preferred: Sequence[str]) -> RenderBackEnd:
    """Back ends are imported here, each only when it is asked for: their libraries are large."""
    check_known("no renderer", name, NAMES)
    failures = []
    for choice in preferred if name == "auto" else [name]:
        try:
            return _LOADERS[choice]()
        except (ImportError, OSError, SaltusError) as error:
            failures.append(f"the {choice} renderer cannot be loaded: {error}")
    raise SaltusError("; ".join(failures))


def preference(intrinsics: Intrinsics) -> list[str]:
    """Names of the back ends, the fastest for one image first.

    A GPU is worth its calls where images are large.
    """
    if intrinsics.width * intrinsics.height < RASTER_PIXELS:
        return ["embree", "pyrender"]
    return [*(["warp"] if has_driver() else []), "pyrender", "embree"]


def has_driver() -> bool:
    """True where the driver of an NVIDIA GPU is installed.

    Asked of the linker, since loading Warp takes a second.
    """
    return ctypes.util.find_library("cuda") is not None


def _embree() -> RenderBackEnd:
    from saltus.render.embree import EmbreeRenderer
    from saltus.render.stereo_embree import StereoEmbree

    return RenderBackEnd(EmbreeRenderer, StereoEmbree)


def _pyrender() -> RenderBackEnd:
    from saltus.render._gl import load_pyrender
    from saltus.render.pyrender_osmesa import PyrenderRenderer
    from saltus.render.stereo_pyrender import StereoPyrender

    load_pyrender()
    return RenderBackEnd(PyrenderRenderer, StereoPyrender)


def _warp() -> RenderBackEnd:
    from saltus.render.warp import StereoWarp, WarpRenderer

    return RenderBackEnd(WarpRenderer, StereoWarp)


_LOADERS: dict[str, Callable[[], RenderBackEnd]] = {
    "embree": _embree,
    "pyrender": _pyrender,
    "warp": _warp,
}
