"""Draws the scenes of one run: robot, terrain, heights, planned feet and forces."""

import numpy as np
import viser
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.constants import FORCE_M_PER_N, LOADED_N
from saltus.sim.visual_shapes import RobotShapes, terrain_edges, terrain_tops, terrain_walls
from saltus.watch.pictures import PREDICTED, TRUE, UNTRUSTED
from saltus.watch.scene import HeightsInWorld, Scene, SceneWorld
from saltus.watch.server import PageServer
from saltus.wire.messages import HeightmapStatus

Rgb = tuple[int, int, int]

# Okabe and Ito's palette: told apart by colour-blind readers; the page's legend has the same
PLANNED, FORCE = (0, 114, 178), (230, 159, 0)
TOP, WALL, EDGE = (203, 210, 218), (120, 133, 148), (84, 95, 109)
SKY = ((150, 186, 222), (244, 247, 250))
LIFT = np.array([0.0, 0.0, 0.004])  # lines float this far above the ground, else they flicker [m]
# A disc faces the browser: half of it would be in the ground [m]
DISC_LIFT = np.array([0.0, 0.0, 0.013])
GUESSED = (204, 121, 167)
GUESS_M = 0.12
"""Half-width from which on a point of a scan is drawn as guessed: that of ground that was never
seen (models/scan.md) [m]."""
GAP_M = 0.5  # between the grounds of two runs


class Drawing:
    """The picture of one run that a server shows; `draw` is all that changes.

    Args:
        server: The page.
        number: Of the run on this page: others stand beside it.
        world: Its robot and terrain.
        aside: Where its y = 0 lies [m].
    """

    def __init__(self, server: PageServer, number: int, world: SceneWorld, aside: float) -> None:
        scene = server.scene
        self._aside = aside
        self._root = scene.add_frame(f"/run{number}", show_axes=False)
        name = f"/run{number}"
        boxes = world.terrain.arrays
        for ground, (vertices, faces), colour in (
            ("tops", terrain_tops(boxes), TOP), ("walls", terrain_walls(boxes), WALL),
        ):  # fmt: skip
            scene.add_mesh_simple(
                f"{name}/{ground}", vertices, faces, color=colour, flat_shading=True
            )
        edges = terrain_edges(boxes) + LIFT
        scene.add_line_segments(
            f"{name}/edges", edges, EDGE, thickness=1.5, thickness_units="screen"
        )
        self._shapes = RobotShapes(world.robot, world.terrain)
        self._bodies = []
        nodes = {"world": f"{name}/robot"}
        for (body, shapes), offset in zip(
            self._shapes.shapes.items(), self._shapes.offsets, strict=True
        ):
            where = nodes[body] = f"{nodes[self._shapes.parents[body]]}/{body}"
            self._bodies.append(scene.add_frame(where, show_axes=False, position=offset))
            for part, shape in enumerate(shapes):
                scene.add_mesh_simple(
                    f"{where}/{part}", shape.vertices, shape.faces, color=shape.rgba[:3]
                )
        self._trunk = self._bodies[0]
        self._trunk.visible = False
        nothing = np.zeros((1, 2, 3))

        def line(part: str, colour: Rgb, pixels: float) -> viser.LineSegmentsHandle:
            where = f"{name}/{part}"
            return scene.add_line_segments(
                where, nothing, colour, thickness=pixels, thickness_units="screen", visible=False
            )

        self._predicted = line("predicted", PREDICTED, 4.0)
        self._widths = line("half_widths", PREDICTED, 1.5)
        self._scan = line("scan", PREDICTED, 2.0)
        self._true = line("true", TRUE, 4.0)
        self._paths = line("paths", PLANNED, 2.0)
        self._targets = scene.add_point_cloud(
            f"{name}/planned_feet",
            nothing[0],
            PLANNED,
            point_size=0.025,
            point_shape="circle",
            visible=False,
        )
        self._forces = scene.add_arrows(
            f"{name}/forces",
            nothing,
            FORCE,
            shaft_radius=0.008,
            head_radius=0.02,
            head_length=0.04,
            visible=False,
        )

    def remove(self) -> None:
        """Takes it all away."""
        self._root.remove()

    def draw(self, scene: Scene, looked_at: Floats) -> None:
        """Shows a scene, so that this point of its world [m],
        shape (3,), is where the browser looks.
        """
        self._root.position = np.array([0.0, self._aside, 0.0]) - looked_at
        if scene.base_pose is not None:
            pose, turns = scene.base_pose, self._shapes.turns(scene.joint_position)
            self._trunk.position, self._trunk.wxyz, self._trunk.visible = pose[:3], pose[3:], True
            for body, quaternion in zip(self._bodies[1:], turns[1:], strict=True):
                body.wxyz = quaternion
        self._draw_heights(scene.heights)
        self._scan.visible = scene.scan is not None
        if scene.scan is not None:
            _draw(self._scan, scene.scan)
        planned = np.isfinite(scene.planned_feet).all(axis=1) & np.isfinite(scene.feet).all(axis=1)
        self._targets.visible = self._paths.visible = bool(planned.any())
        if planned.any():
            self._targets.points = (scene.planned_feet[planned] + DISC_LIFT).astype(np.float32)
            self._paths.points = np.stack(
                [scene.feet[planned], scene.planned_feet[planned]], axis=1
            ).astype(np.float32)
        loaded = (scene.foot_force > LOADED_N) & np.isfinite(scene.feet).all(axis=1)
        self._forces.visible = bool(loaded.any())
        if loaded.any():
            up = np.zeros((int(loaded.sum()), 3))
            up[:, 2] = FORCE_M_PER_N * scene.foot_force[loaded]
            self._forces.points = np.stack(
                [scene.feet[loaded], scene.feet[loaded] + up], axis=1
            ).astype(np.float32)

    def _draw_heights(self, heights: HeightsInWorld | None) -> None:
        self._predicted.visible = self._widths.visible = heights is not None
        self._true.visible = heights is not None and heights.true is not None
        if heights is None:
            return
        _draw(self._predicted, heights)
        if self._predicted.colors.ndim == 1:
            self._widths.colors = self._predicted.colors
        else:
            self._widths.visible = False  # the colours say it, and lines would hide the surface
        up = np.zeros_like(heights.predicted)
        up[:, 2] = heights.half_width_90
        self._widths.points = np.stack(
            [heights.predicted - up, heights.predicted + up], axis=1
        ).astype(np.float32)
        if heights.true is not None:
            self._true.points = _net(heights.true + LIFT, heights.shape)


def _draw(lines: viser.LineSegmentsHandle, heights: HeightsInWorld) -> None:
    """Heights as lines of viser: a curve of one colour,
    or a net whose colours say how sure each point is.
    """
    usable = heights.status in (HeightmapStatus.OK, HeightmapStatus.DEGRADED)
    colour = np.array(PREDICTED if usable else UNTRUSTED, dtype=np.uint8)
    if usable and heights.shape[1] > 1:
        sure = np.clip(1.0 - heights.half_width_90 / GUESS_M, 0.0, 1.0)[:, None]
        mixed = sure * PREDICTED + (1.0 - sure) * np.array(GUESSED)
        colour = _net(mixed, heights.shape).astype(np.uint8)
    if not np.array_equal(lines.colors, colour):
        lines.colors = colour
    lines.points = _net(heights.predicted + 2.0 * LIFT, heights.shape)


def sideways_offsets(worlds: list[SceneWorld]) -> list[float]:
    """Where the y = 0 of each run lies, so that their grounds lie beside each other [m]."""
    places: list[float] = []
    edge = 0.0
    for world in worlds:
        boxes = world.terrain.arrays
        low = float((boxes.center - boxes.extent)[:, 1].min())
        high = float((boxes.center + boxes.extent)[:, 1].max())
        places.append(edge - low if places else 0.0)
        edge = places[-1] + high + GAP_M
    return places


def _net(points: Floats, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Lines between neighbours of a grid, shape (lines, 2, 3):
    a curve where it is a line, else a net.
    """
    table = points.reshape(*shape, 3)
    ahead = np.stack([table[:-1], table[1:]], axis=2).reshape(-1, 2, 3)
    aside = np.stack([table[:, :-1], table[:, 1:]], axis=2).reshape(-1, 2, 3)
    return np.concatenate([ahead, aside]).astype(np.float32)
