"""MuJoCo's own batch of many robots on the cores of a CPU; plants and training build on it."""

from dataclasses import fields

import mujoco
import numpy as np
from mujoco.batch import Batch

from saltus.arrays import Array, Floats
from saltus.effects.body import BodyModel
from saltus.robots.robot import Robot
from saltus.sim.model_layout import ALL, ModelLayout, Rows
from saltus.terrain.boxes import Boxes


class MujocoBatch:
    """`count` copies of one robot, which may differ in body, joints and terrain.

    Live numpy arrays of float64.

    `robots` picks those that a call is about, by their numbers or as a slice; by default all of
    them.

    Attributes:
        qpos: Base position, base quaternion (w, x, y, z), joints; world frame. Shape (count, 19).
        qvel: Base velocity (world frame), angular velocity (base frame), joint velocities. Shape
            (count, 18).
        ctrl: Joint torques [Nm], shape (count, 12).
        warmstart: Where the contact solver starts from, shape (count, 18).
        trunk_wrench: Force [N] and torque [Nm] on the trunk from outside, world frame, shape
            (count, 6).
    """

    def __init__(
        self, robot: Robot, model: mujoco.MjModel, count: int, *, threads: int = 0
    ) -> None:
        self.robot, self.model, self.count = robot, model, count
        self.layout = ModelLayout(robot, model)
        self.batch = Batch(model, nsim=count, nthread=threads)
        self.qpos, self.qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self.ctrl, self.warmstart = self.batch.bind("ctrl"), self.batch.bind("qacc_warmstart")
        wrenches = self.batch.bind("xfrc_applied").reshape(count, model.nbody, 6)
        self.trunk_wrench = wrenches[:, self.layout.trunk]
        # The tree of boxes that the engine looks up is made once; a model without middle phase does
        # not use it.
        self._has_tree = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_MIDPHASE

    def field(self, name: str) -> Array:
        """The model's field of that name with a value for each robot; see `ModelLayout`."""
        array = self.batch.expand(name)
        return array.reshape(self.count, -1, 2, 3) if name == "geom_aabb" else array

    def set_terrain(self, boxes: Boxes, robots: Rows = ALL) -> None:
        """Puts boxes under robots; arrays of shape (n, boxes, ...)."""
        boxes = boxes.like(self.qpos)
        where = (robots, self.layout.terrain)
        self.layout.write_boxes(self.field, boxes, (robots,))
        if boxes.turn is not None or self.batch.expanded("geom_quat") is not None:
            self.field("geom_quat")[where] = boxes.quaternion
            # a box that was compiled level would keep the axes of the world
            self.field("geom_sameframe")[where] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        if self._has_tree:
            self.field("bvh_aabb")[robots, terrain_nodes(self.model)] = tree_bounds(
                self.model, boxes
            )

    def set_bodies(self, body: BodyModel, robots: Rows = ALL) -> None:
        """Gives robots their bodies and their ground; arrays of shape (n, ...).

        See also `derive`.
        """
        values = {f.name: np.asarray(getattr(body, f.name), dtype=np.float64) for f in fields(body)}
        self.layout.write_bodies(self.field, BodyModel(**values), (robots,))

    def derive(self, robots: Array) -> None:
        """Has what the engine derives from masses,
        softness of contacts above all, follow those of `set_bodies`.
        """
        self.batch.set_const(robots)

    def set_joints(
        self, friction: Array, damping: Array, armature: Array | float, robots: Rows = ALL
    ) -> None:
        """Dry friction [Nm], viscous friction [Nm s/rad], inertia beyond the model's [kg m^2].

        Shapes (n or 1, 12).
        """
        dry, viscous, inertia = (
            np.asarray(value, dtype=np.float64) for value in (friction, damping, armature)
        )
        self.layout.write_joints(self.field, dry, viscous, inertia, (robots,))


WORLD = 0  # the body that terrain belongs to


def terrain_nodes(model: mujoco.MjModel) -> slice:
    """Where the world's tree stands among the bounding volumes of the model."""
    start = int(model.body_bvhadr[WORLD])
    return slice(start, start + int(model.body_bvhnum[WORLD]))


def tree_bounds(model: mujoco.MjModel, boxes: Boxes) -> Floats:
    """Centre and half size of each node of the world's tree [m], shape (robots, nodes, 6).

    The engine looks up what a foot may touch in a binary tree of boxes that it makes once. A robot
    of a batch that stands on another terrain needs the same tree with other boxes: any boxes will
    do that contain those below them. The tree of `model` decides which node is above which; `boxes`
    are all geoms that the world has, in their order, arrays of shape (robots, boxes, ...).
    """
    nodes = terrain_nodes(model)
    children, geom_of_node = model.bvh_child[nodes], model.bvh_nodeid[nodes]
    box_low, box_high = boxes.center - boxes.extent, boxes.center + boxes.extent
    first = int(model.body_geomadr[WORLD])
    low = np.empty((len(box_low), len(children), 3))
    high = np.empty_like(low)
    for node in reversed(range(len(children))):  # a node comes before those below it
        if geom_of_node[node] >= 0:
            box = int(geom_of_node[node]) - first
            low[:, node], high[:, node] = box_low[:, box], box_high[:, box]
        else:
            low[:, node], high[:, node] = (
                low[:, children[node]].min(axis=1),
                high[:, children[node]].max(axis=1),
            )
    return np.concatenate([0.5 * (low + high), 0.5 * (high - low)], axis=-1)
