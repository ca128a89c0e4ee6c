"""Back end on pyrender and OSMesa (or EGL): a rasteriser,
which shares nothing with the rays: each checks the other.
"""

from functools import cache
from typing import Any, ClassVar

import numpy as np
import trimesh
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.render._gl import gl_platform, load_pyrender
from saltus.render.camera import RobotCamera, camera_pose
from saltus.render.capsules import capsule_windows, capsules_in_camera
from saltus.render.renderer import Renderer
from saltus.render.terrain_mesh import terrain_triangles
from saltus.robots.leg_shapes import Capsules
from saltus.rotations import rotation_matrix
from saltus.terrain.terrain import Terrain

# With 24 bits of depth the error at depth z is z^2 / (near 2^24): 0.03 mm at 3 m. No leg comes
# nearer to the camera.
NEAR = 0.02
FAR = 100.0
SIDES = 32  # of a round leg: its flats lie at most 0.1 mm under the true surface
# pyrender's cameras look along -z with y up
_GL_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])


class PyrenderRenderer(Renderer):
    """Renders depth with pyrender and OSMesa, without a screen. See `Renderer`.

    One image a call of OpenGL; those of a size share a context, which loads a scene at its turn.

    Raises:
        SaltusError: see `Renderer`, or neither OSMesa nor EGL is installed.
    """

    name: ClassVar[str] = "pyrender"

    def __init__(self, terrain: Terrain, camera: RobotCamera) -> None:
        super().__init__(terrain, camera)
        self._pyrender = load_pyrender()
        self._scene = self._pyrender.Scene()
        vertices, triangles = terrain_triangles(terrain)
        # both sides: a camera that has sunk into a box sees its inside, as rays do
        both_sides = np.concatenate([triangles, triangles[:, ::-1]])
        self._add(trimesh.Trimesh(vertices, both_sides, process=False))
        self._links = (
            [self._add(_capsule(*size)) for size in self.legs.sizes] if camera.legs else []
        )
        intrinsics = camera.intrinsics
        eye = self._pyrender.IntrinsicsCamera(
            intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy, znear=NEAR, zfar=FAR
        )
        self._eye = self._scene.add(eye)
        self._gl = _context(intrinsics.width, intrinsics.height)
        self._flags = self._pyrender.RenderFlags.DEPTH_ONLY
        self._drawn: dict[object, int] | None = None
        if (
            gl_platform() == "egl"
        ):  # where pyrender takes four samples a pixel; SEG has them all at the pixel's centre
            self._flags |= self._pyrender.RenderFlags.SEG
            self._drawn = dict.fromkeys(self._scene.mesh_nodes, 255)  # SEG draws what has a colour

    def _render(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> NDArray[np.float32]:
        origin, rotation = camera_pose(self.mount, base_position, base_quaternion)
        images = np.empty(
            (len(origin), self.intrinsics.height, self.intrinsics.width), dtype=np.float32
        )
        eye = _pose(origin, rotation @ _GL_FROM_CAMERA)
        legs = self.legs.capsules(joint_position)
        seen = capsule_windows(
            capsules_in_camera(legs, self.mount.position, self.mount.rotation), self.intrinsics
        )[2]
        links = _link_poses(legs, base_position, base_quaternion)
        for i in range(len(origin)):
            self._scene.set_pose(self._eye, eye[i])
            for node, pose, visible in zip(self._links, links[i], seen[i], strict=False):
                node.mesh.is_visible = bool(visible)
                if visible:
                    self._scene.set_pose(node, pose)
            images[i] = self._gl.render(self._scene, self._flags, self._drawn)
        return np.where(images > 0.0, images, np.float32(np.inf))  # pyrender's 0 is "nothing hit"

    def _add(self, mesh: trimesh.Trimesh) -> Any:
        return self._scene.add(self._pyrender.Mesh.from_trimesh(mesh, smooth=False))


@cache
def _context(width: int, height: int) -> Any:
    """A context of OpenGL for images of a size:
    it takes a tenth of a second to make one and to free it.
    """
    return load_pyrender().OffscreenRenderer(width, height)


def _link_poses(
    legs: Capsules, base_position: Floats, base_quaternion: Floats
) -> NDArray[np.float64]:
    """Poses of the leg meshes, whose z axes run from start to end, shape (n, 12, 4, 4)."""
    base = rotation_matrix(base_quaternion)
    start = base_position[:, None, :] + legs.start @ base.mT
    axis = (legs.end - legs.start) @ base.mT
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    z = np.where(length > 0.0, axis / np.where(length > 0.0, length, 1.0), [0.0, 0.0, 1.0])
    # any direction across will do; the lateral axis of the base is across a leg unless it is
    # abducted by 90 degrees
    x = np.cross(np.broadcast_to(base[:, None, :, 1], z.shape), z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return _pose(start, np.stack([x, np.cross(z, x), z], axis=-1))


def _pose(position: Floats, rotation: Floats) -> NDArray[np.float64]:
    """Homogeneous matrices from (..., 3) and (..., 3, 3)."""
    pose = np.zeros((*position.shape[:-1], 4, 4))
    pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = rotation, position, 1.0
    return pose


def _capsule(length: float, radius: float) -> trimesh.Trimesh:
    """A capsule along z, from the origin.

    Trimesh has moved the place of its origin between versions.
    """
    mesh = trimesh.creation.capsule(height=length, radius=radius, count=[SIDES // 2, SIDES])
    mesh.apply_translation([0.0, 0.0, -radius - mesh.bounds[0, 2]])
    return mesh
