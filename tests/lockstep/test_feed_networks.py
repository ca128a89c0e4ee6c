"""The networks are fed by somebody who has their files and cards only,
and say what they say in a run of ours.
"""

import ast
import json
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnxruntime
import pytest
from samples import ROBOT

from saltus.cli.main import main
from saltus.depth_camera import load_camera
from saltus.effects.camera import NOMINAL_LATENCY
from saltus.grid import LINE
from saltus.heightmap.data.delivery import TRAINING
from saltus.heightmap.training.interface import frames_and_feet, model_interface
from saltus.model_file import ModelFile
from saltus.recordings.recording import Recording, read_recording
from saltus.resources import shipped_file
from saltus.wire.messages import DepthFrame, Heightmap, MotionPlan, PlanStatus, RobotState

EXAMPLE = Path(__file__).parents[2] / "examples" / "feed_networks.py"
MODELS = {name: shipped_file(f"models/{name}.onnx") for name in ("heightmap", "policy")}
STEPS = 500


@pytest.fixture(scope="module")
def example() -> SimpleNamespace:
    return SimpleNamespace(**runpy.run_path(str(EXAMPLE)))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Of a run that crosses stairs on the images of a stereo camera."""
    folder, camera = tmp_path_factory.mktemp("run"), ("--camera", "d435i", "--renderer", "embree")
    assert main(["demo", "--terrain", "stairs", *camera, "--no-video", "--out", str(folder)]) == 0
    return read_recording(folder / "recording.mcap")


def own_heights(example: SimpleNamespace, recording: Recording) -> np.ndarray:
    """What the example makes of a run's states and images, shape (steps, 2, 30)."""
    frames = {frame.frame_id: frame for frame in recording.of(DepthFrame)}
    heights, last, found = (
        example.Heights(onnxruntime.InferenceSession(MODELS["heightmap"])),
        -1,
        [],
    )
    for state in recording.of(RobotState):
        given = ()
        if state.depth_due != last:
            frame, last = frames[state.depth_due], state.depth_due
            depth_m = np.where(frame.depth == 65535, np.inf, frame.depth * frame.depth_unit_m)
            image = example.pooled(depth_m, (frame.fx, frame.fy), (frame.cx, frame.cy))
            given = (image, 1e-9 * frame.time_ns)
        found.append(heights.step(1e-9 * state.time_ns, state, *given))
    return np.array(found)


@pytest.mark.slow
def test_heights_are_those_of_the_service(example: SimpleNamespace, recording: Recording) -> None:
    theirs = [np.stack([map_.height, map_.half_width_90]) for map_ in recording.of(Heightmap)]
    assert len(theirs) >= STEPS
    off = np.abs(own_heights(example, recording) - theirs)
    assert off.mean() < 1e-3
    assert off.max() < 1e-5


@pytest.mark.slow
def test_plans_are_those_of_the_planner(example: SimpleNamespace, recording: Recording) -> None:
    network = onnxruntime.InferenceSession(MODELS["policy"])
    maps = {map_.step: map_ for map_ in recording.of(Heightmap)}
    states = {state.step: state for state in recording.of(RobotState)}
    going = [plan for plan in recording.of(MotionPlan) if plan.status == PlanStatus.GO]
    assert [plan.step for plan in going] == list(range(going[0].step, going[0].step + len(going)))
    policy = example.Policy(network)
    own = np.array([policy.step(states[plan.step], maps[plan.step].height) for plan in going])
    scalars = [(p.stepping_frequency_hz, p.velocity_x, p.velocity_z, p.pitch_rate) for p in going]
    residuals = [(*p.foot_residual_front, *p.foot_residual_rear) for p in going]
    theirs = np.concatenate([scalars, residuals], axis=1)
    metadata = network.get_modelmeta().custom_metadata_map
    span = np.subtract(json.loads(metadata["high"]), json.loads(metadata["low"]))
    assert len(going) > 200
    assert np.abs((own - theirs) / span).max() < 1e-5


def test_the_example_needs_no_saltus_and_runs() -> None:
    nodes = [
        node
        for node in ast.walk(ast.parse(EXAMPLE.read_text()))
        if isinstance(node, ast.Import | ast.ImportFrom)
    ]
    names = {getattr(node, "module", None) or alias.name for node in nodes for alias in node.names}
    assert names - set(sys.stdlib_module_names) == {"numpy", "onnxruntime"}
    command = [sys.executable, "-I", str(EXAMPLE), str(MODELS["heightmap"]), str(MODELS["policy"])]
    heights, plan = subprocess.run(
        command, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    level = np.array(heights.split("[")[1].split("]")[0].split(), dtype=float)
    np.testing.assert_allclose(level, -0.285, atol=0.005)
    assert plan.startswith("plan [")


@pytest.mark.parametrize("name", ["heightmap", "policy", "scan"])
def test_a_card_names_the_model_file_that_it_describes(name: str) -> None:
    model_id = ModelFile(shipped_file(f"models/{name}.onnx")).model_id
    title, _ = shipped_file(f"models/{name}.md").read_text(encoding="utf-8").split("\n", 1)
    assert model_id in title


def test_the_cards_say_what_the_code_does() -> None:
    heightmap, policy = (shipped_file(f"models/{name}.md").read_text() for name in MODELS)
    hidden = onnxruntime.InferenceSession(MODELS["heightmap"]).get_inputs()[-1].shape[1]
    assert (
        model_interface(ROBOT, LINE, load_camera("d435i"), NOMINAL_LATENCY, hidden, TRAINING)
        in heightmap
    )
    assert frames_and_feet(ROBOT) in policy
