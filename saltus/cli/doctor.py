"""`saltus doctor`: what is installed, what works, and the cure for what does not."""

import platform
import re
import shutil
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from importlib.metadata import requires
from pathlib import Path
from typing import TYPE_CHECKING

from saltus.cli.output import JsonOption, print_json
from saltus.grid import DEFAULT_GRID, load_grid
from saltus.provenance import current_commit, package_version
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.used_networks import model_path

if TYPE_CHECKING:
    from saltus.robots.robot import Robot

EXTRAS = ("train", "gpu", "watch")
MESA = "install Debian's libosmesa6 (apt-get install libosmesa6)"
PYRENDER = "install Debian's libosmesa6 and libxrender1 (apt-get install libosmesa6 libxrender1)"
LIBRARIES = "install Debian's libgl1, libegl1, libx11-6, libusb-1.0-0, libidn2-0 and libgomp1"
NEEDED_BYTES = 2_000_000_000  # a minute of recording, report and video with room to spare


@dataclass(frozen=True, kw_only=True)
class CheckResult:
    """The result of one check of the installation."""

    name: str
    ok: bool
    detail: str
    cure: str = ""
    optional: bool = False
    """Something that only some commands need."""


@dataclass(frozen=True, kw_only=True)
class Doctor(JsonOption):
    """Checks the installation: versions, models, renderers, transport.

    Names the cure for what is missing.

    Example: saltus doctor --json
    """

    def run(self) -> int:
        """Prints every finding; 0 where nothing that all commands need is wrong, else 1."""
        findings = [*_versions(), *_attempts()]
        if self.json:
            print_json(
                {"commit": current_commit(), "findings": [asdict(finding) for finding in findings]}
            )
        else:
            for finding in findings:
                word = "ok" if finding.ok else "-" if finding.optional else "FAIL"
                cure = "" if finding.ok else f"  -> {finding.cure}"
                print(f"{word:4} {finding.name:28} {finding.detail}{cure}")
        return 0 if all(finding.ok or finding.optional for finding in findings) else 1


def _versions() -> list[CheckResult]:
    supported = (3, 11) <= sys.version_info[:2] <= (3, 12)
    python = CheckResult(
        name="python",
        ok=supported,
        detail=platform.python_version(),
        cure="use Python 3.11 or 3.12",
    )
    findings = [CheckResult(name="saltus", ok=True, detail=current_commit()), python]
    for name, extra in _packages().items():
        found = package_version(name)
        missing = "optional, not installed" if extra else "not installed"
        findings.append(
            CheckResult(
                name=name,
                ok=found != "missing",
                detail=missing if found == "missing" else found,
                cure=f"pip install 'saltus[{extra}]'" if extra else "pip install saltus",
                optional=bool(extra),
            )
        )
    return findings


def _packages() -> dict[str, str]:
    """Packages that saltus declares, each with the extra that brings it.

    None for those that all commands need.
    """
    packages: dict[str, str] = {}
    for requirement in requires("saltus") or ():
        name = re.match(r"[\w.-]+", requirement)
        extra = re.search(r"extra == ['\"](\w+)", requirement)
        if name is not None and (extra is None or extra[1] in EXTRAS):
            packages.setdefault(name[0], extra[1] if extra else "")
    return packages


def _attempts() -> list[CheckResult]:
    """Checks that try the thing itself."""
    checks: tuple[tuple[str, str, Callable[[], str]], ...] = (
        ("heightmap model", "reinstall saltus: a shipped file is missing or damaged", _model),
        ("motion policy", "reinstall saltus: a shipped file is missing or damaged", _policy),
        ("Embree (open3d)", LIBRARIES, lambda: _render("embree")),
        ("pyrender on OSMesa", PYRENDER, lambda: _render("pyrender")),
        ("MuJoCo on OSMesa", MESA, _mujoco_frame),
        (
            "Zenoh on this machine",
            "name a folder for sockets with a short path: TMPDIR=/tmp",
            _zenoh,
        ),
        ("H.264 encoder", "pip install imageio-ffmpeg", _encoder),
        ("free disk", "free 2 GB, or name another folder with --out", _disk),
    )
    findings = []
    for name, cure, attempt in checks:
        try:
            findings.append(CheckResult(name=name, ok=True, detail=attempt()))
        except (
            Exception
        ) as error:  # whatever is wrong with an installation is a finding, not a crash
            findings.append(
                CheckResult(
                    name=name, ok=False, detail=f"{type(error).__name__}: {error}", cure=cure
                )
            )
    return findings


def _model() -> str:
    from saltus.heightmap.service.network import HeightmapNetwork

    return f"sha256 {HeightmapNetwork(_robot(), model_path('heightmap')).model_id}, loads"


def _policy() -> str:
    from saltus.policy.actor import PolicyActor

    return (
        f"sha256 {PolicyActor(_robot(), load_grid(DEFAULT_GRID), model_path('policy')).model_id}, "
        "loads"
    )


def _render(backend: str) -> str:
    import numpy as np

    from saltus.config import TerrainConfig
    from saltus.render.backends import make_renderer
    from saltus.render.camera import RobotCamera
    from saltus.terrain.curriculum import make_terrain

    robot, terrain = _robot(), make_terrain(TerrainConfig(terrain="stairs"))
    renderer = make_renderer(backend, terrain, RobotCamera.on(robot))
    position = np.array([terrain.first_edge_x - 0.9, 0.0, robot.stand_height])
    depth = renderer.render(position, np.array([1.0, 0.0, 0.0, 0.0]), robot.stand_pose)
    if not np.isfinite(depth).any():
        raise RuntimeError("the test image is empty")
    return f"{depth.shape[1]}x{depth.shape[0]} image, nearest {np.nanmin(depth):.2f} m"


def _mujoco_frame() -> str:
    from saltus.sim.video import test_frame

    return "frame {1}x{0}".format(*test_frame(_robot(), load_grid(DEFAULT_GRID)).shape)


def _robot() -> "Robot":
    return load_robot(DEFAULT_ROBOT)


def _zenoh() -> str:
    from saltus.errors import StackError
    from saltus.wire.router import open_router
    from saltus.wire.zenoh_bus import ZenohBus

    endpoint, router = open_router()
    with closing(router), ZenohBus(endpoint, "saltus") as bus:
        if not bus.connected():
            raise StackError("a router that was opened does not answer")
    return "a router answers"


def _encoder() -> str:
    import imageio_ffmpeg

    return f"ffmpeg {imageio_ffmpeg.get_ffmpeg_version()}"


def _disk() -> str:
    free = shutil.disk_usage(Path.cwd()).free
    if free < NEEDED_BYTES:
        raise RuntimeError(f"only {free / 1e9:.1f} GB")
    return f"{free / 1e9:.0f} GB"
