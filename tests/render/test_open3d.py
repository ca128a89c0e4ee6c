"""A process that casts rays loads little.

In processes of their own, since a module is loaded once.
"""

import subprocess
import sys

LOADED = "import sys; print(sorted({'dash', 'plotly', 'open3d', 'scipy'} & set(sys.modules)))"
REFUSED = """
import open3d
from saltus.errors import SaltusError
try:
    open3d.visualization.draw_plotly([])
except SaltusError as error:
    print(error)
"""


def said(program: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    ).stdout.strip()


def test_a_camera_loads_open3d_without_its_plots() -> None:
    assert said(f"import saltus.render.__main__, saltus.render.embree\n{LOADED}") == "['open3d']"


def test_motions_without_a_camera_need_no_open3d() -> None:
    barred = "import sys; sys.modules['open3d'] = None"  # as where it is not installed
    made = """
from saltus.effects.profile import IDEAL
from saltus.real2sim.experiments.menu import experiment_named
from saltus.real2sim.experiments.run import run_experiment
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
log = run_experiment(experiment_named("joint_chirp"), load_robot(DEFAULT_ROBOT), IDEAL)
print(len(log.joints.q))
"""
    assert int(said(barred + made)) > 1000


def test_plots_are_left_alone_where_open3d_was_loaded_before() -> None:
    assert (
        said(f"import open3d, saltus.render.embree\nopen3d.visualization.draw_plotly\n{LOADED}")[
            :15
        ]
        == "['dash', 'open3"
    )


def test_what_was_left_out_says_so() -> None:
    assert "import open3d before render" in said(f"import saltus.render.embree\n{REFUSED}")
