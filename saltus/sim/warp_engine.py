"""The physics of training on a GPU: mujoco_warp,
its memory seen through torch, its step in a CUDA graph.
"""

import mujoco
import mujoco_warp
import warp

from saltus.arrays import Array, namespace
from saltus.effects.body import BodyModel
from saltus.robots.robot import Robot
from saltus.sim.engine import TOUCHING, Engine, build_engine_spec
from saltus.sim.model_layout import ModelLayout
from saltus.terrain.boxes import Boxes

CONTACTS = 16
"""Room for contacts per robot, shared by all: four feet, and what knees and hips touch when robots
fall."""
CONSTRAINTS = 36
"""Room for rows of constraints of one robot beside its contacts: one for a joint at its limit, one
for its friction."""
SOLVER_ITERATIONS = 10
"""Iterations of the contact solver. A step lasts until the slowest robot of all has converged: of
256 bounding robots 253 are within 1e-5 m/s after 10, and the slowest within 0.1 m/s, where the
engine's 100 are a multiple of the time."""
_NO_ROOM = (
    mujoco_warp.OverflowType.NEFC
    | mujoco_warp.OverflowType.BROADPHASE
    | mujoco_warp.OverflowType.NARROWPHASE
)
"""Warnings of the engine that contacts or constraint rows of a robot were left out."""
_DIFFERING = (
    "geom_pos",
    "geom_size",
    "geom_aabb",
    "geom_rbound",
    "geom_friction",
    "geom_solref",
    "geom_solimp",
    "body_mass",
    "body_inertia",
    "body_ipos",
    "dof_frictionloss",
    "dof_damping",
    "dof_armature",
)


class WarpEngine(Engine):
    """Many robots in mujoco_warp; torch tensors of float32 that share its memory.

    The device is "cuda:0", or "cpu" (correct, not fast).
    """

    def __init__(
        self, robot: Robot, count: int, boxes: int, *, dimensions: int = 3, device: str = "cuda:0"
    ) -> None:
        self.robot, self.count, self.boxes, self.device = robot, count, boxes, device
        self.dimensions = dimensions
        warp.config.log_level = warp.LOG_WARNING
        spec = build_engine_spec(robot, boxes, dimensions)
        spec.option.disableflags = (
            0  # mujoco_warp has neither of the two that the scene switches off
        )
        spec.option.iterations = SOLVER_ITERATIONS
        self.model = spec.compile()
        self._layout = ModelLayout(robot, self.model)
        start = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, start)
        with warp.ScopedDevice(device):
            self._model = mujoco_warp.put_model(
                self.model, batch_sizes=dict.fromkeys(_DIFFERING, count)
            )
            # Robots would print a line each, at every step, and of thousands some always have
            # something to say.
            self._model.opt.warn_overflow = 0
            rows = CONSTRAINTS + CONTACTS * dimensions
            self._data = mujoco_warp.put_data(
                self.model, start, nworld=count, nconmax=CONTACTS, njmax=rows
            )
            self._bind()
            self._graph = self._capture() if warp.get_device(device).is_cuda else None

    def step(self) -> None:
        """Advances all robots by `PHYSICS_DT`, in the order of torch's present stream."""
        if self._graph is None:
            with warp.ScopedDevice(self.device):
                mujoco_warp.step(self._model, self._data)
        else:
            warp.capture_launch(self._graph, stream=warp.stream_from_torch(self.device))

    def touching(self) -> Array:
        """Which shapes touched the terrain, shape (count, 16)."""
        xp = namespace(self.qpos)
        used = self._slots < self._contact_count[0]
        shape = self._shape_of_geom[self._contact_geom.long()].amax(-1)
        touches = used & (self._contact_distance < 0.0) & (shape >= 0)
        nowhere = self.count * 16  # contacts that do not count go to an entry of their own
        entry = xp.where(
            touches, self._contact_world.long() * 16 + shape, xp.zeros_like(shape) + nowhere
        )
        flags = xp.zeros(nowhere + 1, dtype=xp.bool, device=self.qpos.device)
        flags[entry] = True
        return flags[:nowhere].reshape(self.count, 16)

    def crowded(self) -> Array:
        """Which robots had contacts that found no room since the last call, shape (count,)."""
        found = (self._overflow & int(_NO_ROOM)) != 0
        self._overflow.zero_()
        return found

    def set_terrain(self, boxes: Boxes) -> None:
        """Puts boxes under all robots."""
        self._layout.write_boxes(self._fields.__getitem__, boxes)
        # poses of what does not move are computed once, when data is made
        self._geom_xpos[:, self._layout.terrain] = boxes.center
        self._is_turned |= boxes.turn is not None
        if self._is_turned:
            self._geom_xmat[:, self._layout.terrain] = boxes.rotation

    def set_bodies(self, body: BodyModel) -> None:
        """Gives all robots their bodies and their ground."""
        self._layout.write_bodies(self._fields.__getitem__, body)

    def set_joints(self, friction: Array, damping: Array, armature: Array) -> None:
        """Gives all joints their friction and inertia."""
        self._layout.write_joints(self._fields.__getitem__, friction, damping, armature)

    def _bind(self) -> None:
        view, data = warp.to_torch, self._data
        self._fields = {name: view(getattr(self._model, name)) for name in _DIFFERING}
        self.qpos, self.qvel, self.qacc = view(data.qpos), view(data.qvel), view(data.qacc)
        self.warmstart, self.ctrl = view(data.qacc_warmstart), view(data.ctrl)
        self.trunk_wrench = view(data.xfrc_applied)[:, self._layout.trunk]
        self._geom_xpos, self._geom_xmat = view(data.geom_xpos), view(data.geom_xmat)
        self._is_turned = False
        self._contact_geom, self._contact_world = (
            view(data.contact.geom),
            view(data.contact.worldid),
        )
        self._overflow = view(data.overflow)
        self._contact_distance, self._contact_count = view(data.contact.dist), view(data.nacon)
        shape_of_geom = [-1] * self.model.ngeom  # terrain and trunk
        for shape, name in enumerate(TOUCHING):
            shape_of_geom[self.model.geom(name).id] = shape
        xp = namespace(self.qpos)
        self._shape_of_geom = xp.asarray(shape_of_geom, dtype=xp.int64, device=self.qpos.device)
        self._slots = xp.arange(self._contact_geom.shape[0], device=self.qpos.device)

    def _capture(self) -> object:
        mujoco_warp.step(self._model, self._data)  # compiles the kernels
        with warp.ScopedCapture() as capture:
            mujoco_warp.step(self._model, self._data)
        return capture.graph
