"""Which back end renders."""

from render.renderer import Renderer as Renderer
from saltus.config import Renderer as RendererName
from saltus.depth import MODEL_CAMERA, Intrinsics
from saltus.errors import ConfigError, nearest_hint
from saltus.terrain.terrain import Terrain

NAMES: tuple[RendererName, ...] = ("auto", "embree", "pyrender")


def make_renderer(name: str, terrain: Terrain, intrinsics: Intrinsics = MODEL_CAMERA, *, legs: bool = True) -> Renderer:
    """A renderer by name; "auto" is Embree, the fastest at the model's resolution, or pyrender where open3d is missing.

    Back ends are imported here, each only when it is asked for: both libraries are large.

    Args:
        name: "auto", "embree" or "pyrender".
        terrain: what there is to see.
        intrinsics: of the camera.
        legs: whether the robot's legs can be seen.

    Raises:
        ConfigError: no such back end.
        SaltusError: the back end cannot be loaded.
    """
    if name not in NAMES:
        raise ConfigError(f"no renderer '{name}': {nearest_hint(name, NAMES)}")
    if name != "pyrender":
        try:
            from render.embree import EmbreeRenderer
        except (ImportError, OSError) as error:
            if name == "embree":
                raise ConfigError(f"the embree renderer needs open3d, which cannot be loaded: {error}") from error
        else:
            return EmbreeRenderer(terrain, intrinsics, legs=legs)
    from render.pyrender_osmesa import PyrenderRenderer

    return PyrenderRenderer(terrain, intrinsics, legs=legs)
