"""The panel beside the picture: depth image, heights, topics, events. One of each run."""

import base64
import html
import math

import cv2
import numpy as np
from numpy.typing import NDArray
from viser import uplot

from saltus.depth import RANGE_M
from saltus.watch.pictures import NEAR_M, PALETTE, PLOTTED_M, curves, picture
from saltus.watch.scene import SILENT, Heights, Scene, World
from saltus.watch.server import Server
from saltus.wire.messages import DepthFrame, HeightmapStatus

IMAGE_HEIGHT = 180  # [px]
EVENTS_SHOWN = 10
GOOD, FAIR, BAD, GREY = "#00664a", "#9a6700", "#b03a00", "#666"
COLOUR = {"ok": GOOD, "degraded": FAIR, "invalid": BAD, "future": BAD, SILENT: BAD}
CELL = "padding:1px 8px 1px 0;text-align:right;font-variant-numeric:tabular-nums"
PADDING = "padding:0 8px"
STYLE = "font-size:0.82em;line-height:1.4;width:100%;padding:0 8px;border-spacing:0"


class Panel:
    """The panel of one run, in the container of the page that is open."""

    def __init__(self, server: Server, world: World) -> None:
        gui = server.gui
        self._head = gui.add_html(_head(world, None))
        self._depth = gui.add_html("")
        x = np.zeros(2)
        self._plot = gui.add_uplot(
            (x, x, x, x, x),
            (
                uplot.Series(label="ahead [m]"),
                uplot.Series(label="low", stroke="rgba(213,94,0,0.25)", width=1, points={"show": False}),
                uplot.Series(label="high", stroke="rgba(213,94,0,0.25)", width=1, points={"show": False}),
                uplot.Series(label="predicted", stroke="#D55E00", width=2),
                uplot.Series(label="true", stroke="#009E73", width=2),
            ),
            bands=(uplot.Band(series=(2, 1), fill="rgba(213,94,0,0.15)"),),
            title="Heights relative to the base [m]",
            scales={"x": uplot.Scale(time=False), "y": uplot.Scale(range=PLOTTED_M)},
            legend=uplot.Legend(show=False),
            height=170,
        )
        self._heights = gui.add_html(_heights_line(None))
        self._topics = gui.add_html("")
        self._events = gui.add_html("")
        self._frame: DepthFrame | None = None
        self._world = world

    def show(self, scene: Scene) -> None:
        """Shows a scene."""
        _set(self._head, _head(self._world, scene))
        _set(self._topics, _topics(scene))
        _set(self._events, _events(scene))
        _set(self._heights, _heights_line(scene.heights))
        if scene.depth is not None and (self._frame is None or scene.depth.time_ns != self._frame.time_ns):
            self._frame = scene.depth
            self._depth.content = _depth(scene.depth)
        if scene.heights is not None:
            self._plot.data = curves(scene.heights, scene)


def _depth(frame: DepthFrame) -> str:
    """An image with its scale beside it."""
    png = base64.b64encode(cv2.imencode(".png", picture(frame)[..., ::-1])[1].tobytes()).decode()
    height, width = frame.depth.shape
    shown = f"max-width:62%;height:{IMAGE_HEIGHT}px;image-rendering:pixelated"
    lines = (
        "<b>Depth</b>", f"{width} x {height} pixels", f"image {frame.frame_id}", f"invalid {_share(frame.depth == 0)}",
        "black: invalid", "grey: nothing", "within range",
    )  # fmt: skip
    return (
        f'<div style="display:flex;gap:10px;font-size:0.75em;color:{GREY};{PADDING}">'
        f'<img alt="depth" style="{shown}" src="data:image/png;base64,{png}">{SCALE}'
        f"<div>{'<br>'.join(lines)}</div></div>"
    )


def _share(mask: NDArray[np.bool_]) -> str:
    return f"{100 * float(mask.mean()):.0f} %"


def _scale() -> str:
    colours = ",".join(f"rgb({r},{g},{b})" for r, g, b in PALETTE[::15].tolist())
    marks = "".join(f"<span>{depth:.2g} m</span>" for depth in np.geomspace(RANGE_M, NEAR_M, 5))
    return (
        f'<div style="width:8px;background:linear-gradient(to bottom,{colours})"></div>'
        f'<div style="display:flex;flex-direction:column;justify-content:space-between">{marks}</div>'
    )


SCALE = _scale()


def _head(world: World, scene: Scene | None) -> str:
    if scene is None:
        return f'<div style="{PADDING}">{html.escape(world.title)}</div>'
    mode = "no robot so far" if scene.mode is None else scene.mode.name.lower()
    plan = "-" if scene.plan is None else scene.plan.name.lower()
    place = "" if scene.base_pose is None else f"{scene.base_pose[0]:.2f} m"
    speed = f"{scene.speed_mps:.2f} m/s" if math.isfinite(scene.speed_mps) else ""
    cells = "".join(
        f'<td style="padding:0 14px 0 0"><span style="color:{GREY}">{name}</span><br><b>{value}</b></td>'
        for name, value in (
            ("time", f"{scene.time_s:.2f} s"), ("controller", mode), ("plan", plan), ("x", place), ("speed", speed),
        )
    )  # fmt: skip
    return f'<table style="{STYLE}"><tr>{cells}</tr></table>'


def _heights_line(heights: Heights | None) -> str:
    parts = [_coloured("predicted", "#D55E00"), "half of the 90 % interval: the band", _coloured("true", "#009E73")]
    if heights is not None:
        colour = {HeightmapStatus.OK: GOOD, HeightmapStatus.INVALID: BAD}.get(heights.status, FAIR)
        parts.append(f"status {_coloured(heights.status.name.lower(), colour)}")
        if heights.true is not None:
            error = float(np.abs(heights.predicted[:, 2] - heights.true[:, 2]).mean())
            parts.append(f"mean error {100 * error:.1f} cm")
    return f'<div style="font-size:0.75em;color:{GREY};{PADDING}">{", ".join(parts)}</div>'


def _topics(scene: Scene) -> str:
    rows = "".join(
        f'<tr><td style="text-align:left">{html.escape(row.name)}</td><td style="{CELL}">{row.rate_hz:.0f}</td>'
        f'<td style="{CELL}">{f"{row.age_ms:.0f}" if math.isfinite(row.age_ms) else "-"}</td>'
        f'<td style="text-align:left">{_coloured(row.status, COLOUR[row.status])}</td></tr>'
        for row in scene.topics
    )
    head = f'<tr style="color:{GREY}"><td>topic</td><td style="{CELL}">Hz</td><td style="{CELL}">age [ms]</td><td></td>'
    return f'<table style="{STYLE}">{head}</tr>{rows}</table>'


def _events(scene: Scene) -> str:
    rows = "".join(
        f'<tr><td style="{CELL};white-space:nowrap">{1e-9 * event.time_ns:.2f} s</td>'
        f"<td>{html.escape(event.process)}</td>"
        f"<td><b>{html.escape(event.code)}</b> {html.escape(event.detail[:80])}</td></tr>"
        for event in reversed(scene.events[-EVENTS_SHOWN:])
    )
    return f'<table style="{STYLE}">{rows}</table>'


def _coloured(text: str, colour: str) -> str:
    return f'<b style="color:{colour}">{html.escape(text)}</b>'


def _set(handle: object, content: str) -> None:
    if getattr(handle, "content", None) != content:
        handle.content = content  # type: ignore[attr-defined]
