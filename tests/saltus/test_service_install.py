"""service.txt: a computer that only serves heights needs no more than it names,
and that is small.
"""

import contextlib
import importlib.util
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from saltus.runtime.run_folder import endpoint_of
from saltus.wire.zenoh_bus import ZenohBus

ROOT = Path(__file__).parents[2]
MOST_BYTES = 300e6
PATIENCE_S = 60.0
_spec = importlib.util.spec_from_file_location("service", ROOT / "tools" / "service.py")
assert _spec is not None
assert _spec.loader is not None
tool = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(tool)
LISTED = [
    Requirement(line) for line in tool.FILE.read_text().splitlines() if not line.startswith("#")
]


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the packages of service.txt and no others, as links to their files."""
    folder = tmp_path_factory.mktemp("packages")
    files = {
        str(file): str(file.locate())
        for listed in LISTED
        for file in distribution(listed.name).files or ()
    }
    for name, file in files.items():
        link = folder / name
        if ".." not in link.parts and link.suffix != ".pyc":
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(file)
    return folder


# -S: without the packages of this Python
SALTUS = (
    sys.executable,
    "-S",
    "-P",
    "-m",
    "saltus.cli.main",
)


def with_only(environment: Path) -> dict[str, str]:
    """The environment of a process that sees these packages alone."""
    return {**os.environ, "PYTHONPATH": f"{environment}{os.pathsep}{ROOT}"}


@contextlib.contextmanager
def running(environment: Path, *command: str) -> Iterator["subprocess.Popen[str]"]:
    """A command of Saltus with these packages; a service manager ends it."""
    words = [*SALTUS, *command]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, text=True, env=with_only(environment)
    ) as process:
        try:
            yield process
        finally:
            process.terminate()
        assert process.wait(PATIENCE_S) == -signal.SIGTERM


def test_the_list_is_what_the_packages_say_that_they_need() -> None:
    made = [Requirement(line) for line in tool.service_requirements()]
    assert [listed.name for listed in LISTED] == [each.name for each in made], (
        "run python tools/service.py"
    )


def test_all_of_it_is_small() -> None:
    files = {
        str(file.locate()) for listed in LISTED for file in distribution(listed.name).files or ()
    }
    sizes = [Path(file).stat().st_size for file in files if not file.endswith(".pyc")]
    own = sum(path.stat().st_size for path in (ROOT / "models").glob("*.onnx"))
    assert 100e6 < sum(sizes) + own < MOST_BYTES


def test_a_router_and_the_service_run_on_it(environment: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    with running(environment, "router", "--out", str(run)) as router:
        assert router.stdout is not None
        assert router.stdout.readline().startswith("router at")
        with ZenohBus(endpoint_of(run), "robot/0") as bus:
            status = bus.latest("status", "heightmap")
            with running(environment, "heightmap", "serve", "--run-dir", str(run)):
                sample = status.wait(PATIENCE_S)
                assert sample is not None
                assert sample.message.ready


def test_a_command_that_needs_more_says_so_in_one_line(environment: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [*SALTUS, "demo"], env=with_only(environment), cwd=tmp_path, capture_output=True, text=True,
        check=False,
        timeout=PATIENCE_S,
    )  # fmt: skip
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("saltus: this needs the package '")
