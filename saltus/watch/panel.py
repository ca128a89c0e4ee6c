"""The panel beside the picture: depth image, heights, topics, events. One of each run."""

import cv2
import numpy as np
from viser import uplot

from saltus.depth import RANGE_M
from saltus.reports.page_templates import data_url, template_beside
from saltus.watch.pictures import NEAR_M, PALETTE, PLOTTED_M, depth_picture, heightmap_curves
from saltus.watch.scene import SILENT, Scene, SceneWorld
from saltus.watch.server import PageServer
from saltus.wire.messages import DepthFrame, HeightmapStatus

IMAGE_HEIGHT = 180  # [px]
EVENTS_SHOWN = 10
GOOD, FAIR, BAD, GREY = "#00664a", "#9a6700", "#b03a00", "#666"
COLOUR = {"ok": GOOD, "degraded": FAIR, "invalid": BAD, "future": BAD, SILENT: BAD}


class Panel:
    """The panel of one run, in the container of the page that is open."""

    def __init__(self, server: PageServer, world: SceneWorld) -> None:
        gui = server.gui
        self._head = gui.add_html(_html("title", world))
        self._depth = gui.add_html("")
        x = np.zeros(2)
        self._plot = gui.add_uplot(
            (x, x, x, x, x),
            (
                uplot.Series(label="ahead [m]"),
                uplot.Series(
                    label="low", stroke="rgba(213,94,0,0.25)", width=1, points={"show": False}
                ),
                uplot.Series(
                    label="high", stroke="rgba(213,94,0,0.25)", width=1, points={"show": False}
                ),
                uplot.Series(label="predicted", stroke="#D55E00", width=2),
                uplot.Series(label="true", stroke="#009E73", width=2),
            ),
            bands=(uplot.Band(series=(2, 1), fill="rgba(213,94,0,0.15)"),),
            title="Heights relative to the base [m]",
            scales={"x": uplot.Scale(time=False), "y": uplot.Scale(range=PLOTTED_M)},
            legend=uplot.Legend(show=False),
            height=170,
        )
        self._heights = gui.add_html(_html("heights", None))
        self._topics = gui.add_html("")
        self._events = gui.add_html("")
        self._frame: DepthFrame | None = None
        self._world = world

    def show(self, scene: Scene) -> None:
        """Shows a scene."""
        _set(self._head, _html("head", scene))
        _set(self._topics, _html("topics", scene.topics))
        _set(self._events, _html("events", scene.events[-EVENTS_SHOWN:]))
        _set(self._heights, _html("heights", scene.heights))
        if scene.depth is not None and (
            self._frame is None or scene.depth.time_ns != self._frame.time_ns
        ):
            self._frame = scene.depth
            self._depth.content = _html("depth", scene.depth)
        if scene.heights is not None:
            self._plot.data = heightmap_curves(scene.heights, scene)


_MACROS = template_beside(__file__).make_module(
    {
        "picture": lambda frame: data_url(
            "png", cv2.imencode(".png", depth_picture(frame)[..., ::-1])[1]
        ),
        "image_height": IMAGE_HEIGHT,
        "palette": PALETTE[::15].tolist(),
        "marks": np.geomspace(RANGE_M, NEAR_M, 5).tolist(),
        "mean_error_cm": lambda predicted, true: (
            100.0 * float(np.abs(predicted - true)[:, 2].mean())
        ),
        "status_colour": {HeightmapStatus.OK: GOOD, HeightmapStatus.INVALID: BAD},
        "colour": COLOUR,
        "fair": FAIR,
        "grey": GREY,
    }
)


def _html(name: str, shown: object) -> str:
    """A part of the panel, by the macro of this name; viser takes no other kind of text."""
    return str(getattr(_MACROS, name)(shown))


def _set(handle: object, content: str) -> None:
    if getattr(handle, "content", None) != content:
        handle.content = content  # type: ignore[attr-defined]
