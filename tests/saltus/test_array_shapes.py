"""Shapes are types: the laws keep the shapes that their annotations state,
and what is deployed does not ask.
"""

import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]
CALLS = (
    "rotations.rotation_matrix(np.zeros(3))",
    "rotations.quaternion_from_roll_pitch_yaw(np.zeros(5), np.zeros(4), np.zeros(5))",
    "grid.LINE.points_in_world(np.zeros((5, 3)), np.zeros(4))",
    "joint_command.JointCommand(**dict.fromkeys(('position', 'velocity', 'kp', 'kd', 'torque'), "
    "np.zeros((4, 3))))",
)
REFUSED = f"""
import shape_checks, numpy as np
from saltus import grid, joint_command, rotations
for call in {CALLS}:
    try:
        eval(call)
    except Exception as error:
        print(type(error).__name__)
"""


def python(code: str) -> subprocess.CompletedProcess[str]:
    """Runs a program in a fresh process, beside the modules that tests share."""
    return subprocess.run(
        [sys.executable, "-c", code], cwd=TESTS, capture_output=True, text=True, check=False
    )


def test_laws_of_numpy_and_torch_keep_the_shapes_that_they_state() -> None:
    run = python("import shaped_laws; shaped_laws.main()")
    assert run.returncode == 0, run.stderr[-3000:]


def test_other_shapes_are_refused() -> None:
    run = python(REFUSED)
    assert run.returncode == 0, run.stderr[-3000:]
    assert run.stdout.split() == ["TypeCheckError"] * len(CALLS)


def test_what_is_deployed_loads_no_checks() -> None:
    loaded = (
        "import sys, saltus.controller.control_loop, saltus.effects.chain; "
        "assert 'jaxtyping' not in sys.modules"
    )
    assert python(loaded).returncode == 0
