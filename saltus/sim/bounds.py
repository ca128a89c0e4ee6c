"""The engine's tree of bounding boxes over the terrain, for terrains that are not the one it was compiled with.

The engine looks up what a foot may touch in a binary tree of boxes that it makes once. A robot of a batch that stands
on another terrain needs the same tree with other boxes: any boxes will do that contain those below them.
"""

import mujoco
import numpy as np

from saltus.arrays import Floats
from saltus.terrain.boxes import Boxes

WORLD = 0  # the body that terrain belongs to


def terrain_nodes(model: mujoco.MjModel) -> slice:
    """Where the world's tree stands among the bounding volumes of the model."""
    start = int(model.body_bvhadr[WORLD])
    return slice(start, start + int(model.body_bvhnum[WORLD]))


def tree_bounds(model: mujoco.MjModel, boxes: Boxes) -> Floats:
    """Centre and half size of each node of the world's tree [m], shape (robots, nodes, 6).

    The tree of `model` decides which node is above which; `boxes` are all geoms that the world has, in their order,
    arrays of shape (robots, boxes, ...).
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
            low[:, node], high[:, node] = low[:, children[node]].min(axis=1), high[:, children[node]].max(axis=1)
    return np.concatenate([0.5 * (low + high), 0.5 * (high - low)], axis=-1)
