"""The page: the picture in the middle, what may be done on the left,
a panel of each run on the right.
"""

import html
import queue
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import viser

from saltus.arrays import Floats
from saltus.config import TerrainConfig
from saltus.terrain.curriculum import FAMILIES
from saltus.watch.drawing import SKY, Drawing, sideways_offsets
from saltus.watch.panel import GREY, Panel
from saltus.watch.scene import Scene, SceneWorld
from saltus.watch.server import PageServer

LEFT_PX, RIGHT_PX = 300, 400
CAMERA_AT, CAMERA_LOOKS_AT = (-0.8, -1.5, 0.6), (0.2, 0.0, -0.05)
"""Beside a robot that goes along x, a little behind it, all of the heights that it predicts in view
[m]."""
READ_EVERY = 3
BACK = 0.5  # so many times farther away for each metre to the last of several robots [1/m]
FOLLOW_SHARE, FAR_M = 0.15, 1.0
"""Share of the way to the robot that the picture follows each time that is drawn: jumps do not
shake the picture; from farther away, and where a recording pauses, all of it."""
LIGHT, GROUND = 2.2, (150, 150, 155)
SPEEDS = ("lockstep", "1", "0.5", "0.25", "0.1")
PLAY_SPEEDS = ("1", "0.5", "0.25", "0.1")
BLIND_S, PUSH_NS = 1.0, 15
FAULTS = {
    f"Blind the camera {BLIND_S:g} s": ("blind", f"{BLIND_S:g}"),
    f"Push it to the left, {PUSH_NS} Ns": ("push", f"{PUSH_NS}"),
    f"Push it to the right, {PUSH_NS} Ns": ("push", f"-{PUSH_NS}"),
    "Kill the camera": ("kill", "render"),
    "Kill the heightmap service": ("kill", "heightmap"),
    "Kill the planner": ("kill", "policy"),
}
"""Buttons, and what they ask of the run: code and detail of the operator's event."""


@dataclass(frozen=True, kw_only=True)
class StartRequest:
    """Somebody has pressed the button that starts a run."""

    terrain: str
    seed: int
    speed: str
    """Speed in parts of real time, or "lockstep"."""


@dataclass(frozen=True, kw_only=True)
class RunRequest:
    """A button was pressed on the page of `saltus watch` that asks something of the run."""

    code: str
    detail: str = ""


class Page:
    """The page in a browser: what it shows and what is pressed in it."""

    def __init__(self, server: PageServer) -> None:
        self.server = server
        self.pressed: queue.SimpleQueue[StartRequest | RunRequest] = queue.SimpleQueue()
        """Filled by viser's threads."""
        self.playing = True
        self.time_s = 0.0
        """Time in recordings, since their beginning."""
        self._drawings: list[Drawing] = []
        self._panels: list[viser.PanelHandle] = []
        self._shown: list[Panel] = []
        self._duration_s = 0.0
        self._looked_at = np.zeros(3)
        self._pictures = 0
        self._set_up()
        self._add_controls()

    @property
    def watched(self) -> bool:
        """True where there is a browser that shows this page."""
        return bool(self.server.get_clients())

    @property
    def follows(self) -> bool:
        """True where the picture goes with the robot."""
        return bool(self._follow.value)

    def arrange(self, worlds: list[SceneWorld], duration_s: float, *, may_ask: bool) -> None:
        """Makes room for other runs: their grounds, their panels,
        the time line of recordings, fitting buttons.
        """
        with self.server.atomic():
            old: list[Drawing | viser.PanelHandle] = [*self._drawings, *self._panels]
            for drawn in old:
                drawn.remove()
            places = sideways_offsets(worlds)
            parts = enumerate(zip(worlds, places, strict=True))
            self._drawings = [
                Drawing(self.server, number, world, y) for number, (world, y) in parts
            ]
            last_y = max(places, default=0.0)
            self.server.initial_camera.position = max(1.0, BACK * last_y) * np.array(CAMERA_AT)
            self.server.initial_camera.look_at = np.array(CAMERA_LOOKS_AT) + np.array(
                [0.0, 0.5 * last_y, 0.0]
            )
            self._panels, self._shown = [], []
            for world in worlds:
                panel = self.server.gui.add_panel()
                panel.dock_right()
                panel.set_width(RIGHT_PX)
                with panel.add_tab(world.title):
                    self._shown.append(Panel(self.server, world))
                self._panels.append(panel)
            self._duration_s, self.time_s, self.playing = duration_s, 0.0, True
            self._timeline.visible = duration_s > 0.0
            self._slider.max = max(round(duration_s, 2), 0.01)
            self._faults.visible = self._stop.visible = may_ask
            self._run.visible = not (worlds and duration_s == 0.0)

    def show(self, scenes: list[Scene | None]) -> None:
        """Shows a scene of each run.

        Its numbers and images less often than the robot, as nobody reads faster.
        """
        self._pictures += 1
        read = self._pictures % READ_EVERY == 0 or not self.playing
        with self.server.atomic():
            self._look_at(
                [
                    scene.base_pose
                    for scene in scenes
                    if scene is not None and scene.base_pose is not None
                ]
            )
            for drawing, panel, scene in zip(self._drawings, self._shown, scenes, strict=True):
                if scene is not None:
                    drawing.draw(scene, self._looked_at)
                    if read:
                        panel.show(scene)

    def _look_at(self, poses: list[Floats]) -> None:
        """Follows the foremost robot, and no jump of it, nor to its side."""
        if not self.follows:
            self._looked_at = np.zeros(3)
        elif poses:
            x, _, z = max((pose[:3] for pose in poses), key=lambda position: float(position[0]))
            way = np.array([x, 0.0, z]) - self._looked_at
            near = self.playing and float(np.linalg.norm(way)) < FAR_M
            self._looked_at = self._looked_at + (FOLLOW_SHARE if near else 1.0) * way

    def advance(self, seconds: float) -> None:
        """Recordings go on by so many seconds of this machine; at their end they begin anew."""
        if self._duration_s > 0.0 and self.playing:
            self.time_s += seconds * float(self._play_speed.value)
            if self.time_s > self._duration_s:
                self.time_s = 0.0
            self._slider.value = round(self.time_s, 2)  # type: ignore[misc] # its setter is declared elsewhere

    def say(self, text: str, colour: str = GREY) -> None:
        """Shows what is going on, in one line."""
        content = f'<div style="font-size:0.85em;color:{colour}">{html.escape(text)}</div>'
        if self._state.content != content:
            self._state.content = content

    def _set_up(self) -> None:
        server = self.server
        server.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=(0, 114, 178)
        )
        server.gui.set_panel_label("Saltus")
        server.gui.main_panel.dock_left()
        server.gui.main_panel.set_width(LEFT_PX)
        server.scene.set_background_image(_sky())
        # Without a GPU shadows and reflections take ten times as long as the rest
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_hemisphere(
            "/light", sky_color=(255, 255, 255), ground_color=GROUND, intensity=LIGHT
        )

    def _add_controls(self) -> None:
        gui = self.server.gui
        self._state = gui.add_html("")
        self._follow = gui.add_checkbox("Follow the robot", True)
        self._timeline = gui.add_folder("Recording", visible=False)
        with self._timeline:
            self._slider = gui.add_slider(
                "Time [s]", min=0.0, max=1.0, step=0.01, initial_value=0.0
            )
            self._play = gui.add_button("Pause")
            self._play_speed = gui.add_dropdown("Speed", PLAY_SPEEDS)
        self._run = gui.add_folder("New run")
        with self._run:
            terrain = gui.add_dropdown(
                "Terrain", tuple(FAMILIES), initial_value=TerrainConfig.terrain
            )
            seed = gui.add_number("Seed", initial_value=0, min=0, step=1)
            speed = gui.add_dropdown("Speed", SPEEDS, initial_value="0.5")
            start = gui.add_button("Start")
        self._stop = gui.add_button("Stop", visible=False, color="red")
        self._faults = gui.add_folder("Faults", visible=False)
        with self._faults:
            for label, (code, detail) in FAULTS.items():
                self._on_click(gui.add_button(label), partial(RunRequest, code=code, detail=detail))
        self._on_click(self._stop, partial(RunRequest, code="stop"))
        self._on_click(
            start,
            lambda: StartRequest(
                terrain=str(terrain.value), seed=int(seed.value or 0), speed=str(speed.value)
            ),
        )

        @self._play.on_click
        def _(_: object) -> None:
            self._set_playing(not self.playing)

        @self._slider.on_update
        def _(event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
            if event.client is not None:  # somebody has dragged it
                self._set_playing(False)
                self.time_s = float(self._slider.value)

    def _on_click(
        self, button: viser.GuiButtonHandle, make: Callable[[], StartRequest | RunRequest]
    ) -> None:
        button.on_click(lambda _: self.pressed.put(make()))

    def _set_playing(self, playing: bool) -> None:
        self.playing = playing
        self._play.label = "Pause" if playing else "Play"


def _sky() -> np.ndarray:
    share = np.linspace(0.0, 1.0, 128)[:, None, None]
    low, high = np.array(SKY[1], float), np.array(SKY[0], float)
    return np.broadcast_to(high + share * (low - high), (128, 8, 3)).astype(np.uint8)
