import copy
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from samples import ROBOT

from saltus.errors import ModelError
from saltus.grid import LINE
from saltus.heightmap.model import HeightmapModel
from saltus.heightmap.service.network import INPUTS, HeightmapNetwork
from saltus.heightmap.training.export import random_inputs
from saltus.robots.robot import Robot


def mutated(model_path: Path, target: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    model = onnx.load(model_path)
    table = {p.key: json.loads(p.value) for p in model.metadata_props}
    change(table)
    onnx.helper.set_model_props(model, {name: json.dumps(value) for name, value in table.items()})
    onnx.save(model, target)
    return target


def at(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(table: dict[str, Any]) -> None:
        *parents, last = path.split("/")
        node: Any = table
        for name in parents:
            node = node[int(name) if isinstance(node, list) else name]
        node[int(last) if isinstance(node, list) else last] = value

    return change


def without(name: str) -> Callable[[dict[str, Any]], None]:
    def change(table: dict[str, Any]) -> None:
        del table[name]

    return change


MUTATIONS = {
    "format": at("format", "other"),
    "robot": at("robot", "longlegs"),
    "grid_m[3]": at("grid_m/3", 0.3),
    "grid_m": at("grid_m", [0.0, 1.0]),
    "camera.width": at("camera/width", 60),
    "camera.fx": at("camera/fx", 42.3),
    "camera.cy": at("camera/cy", 23.9),
    "camera.range_m": at("camera/range_m", 4.0),
    "camera": at("camera/pitch_rad", "steep"),
    "proprioception[0]": at("proprioception/0", "yaw"),
    "proprioception": at("proprioception", ["roll"]),
    "warmup_frames": at("warmup_frames", 0),
    "nominal_delay_s": at("nominal_delay_s", "soon"),
}


def test_a_tick_has_half_of_the_90_percent_interval(
    model: HeightmapModel, model_path: Path
) -> None:
    (given,) = random_inputs(model, np.random.default_rng(0), 1)
    network = HeightmapNetwork(ROBOT, model_path)
    tick = network.tick(*given)
    session = onnxruntime.InferenceSession(model_path)
    stated = session.run(
        ["std"], {name: np.float32(a) for name, a in zip(INPUTS, given, strict=True)}
    )
    np.testing.assert_allclose(tick.half_width_90, 1.645 * stated[0], rtol=1e-5)


@pytest.mark.parametrize("field", MUTATIONS)
def test_metadata_that_do_not_fit_are_refused_by_name(
    model_path: Path, tmp_path: Path, field: str
) -> None:
    path = mutated(model_path, tmp_path / "changed.onnx", MUTATIONS[field])
    with pytest.raises(ModelError, match=f"'{field}'".replace("[", r"\[")) as caught:
        HeightmapNetwork(ROBOT, path, LINE)
    assert "\n" not in str(caught.value)


def test_a_model_is_refused_for_another_robot_or_another_camera(model_path: Path) -> None:
    for robot, field in (
        (
            replace(ROBOT, name="longlegs"),
            "'robot' is 'go1', and heights are wanted for 'longlegs'",
        ),
        (_moved(pitch=0.027), "1.5 deg more down, and training covers 1 cm and 1.5 deg"),
        (_moved(-0.011), "-1.1 cm ahead"),
        (_moved(0.0, 0.0, 0.05), "5.0 cm up"),
    ):
        with pytest.raises(ModelError, match=field) as caught:
            HeightmapNetwork(robot, model_path)
        assert "\n" not in str(caught.value)
    # No more than training covers
    HeightmapNetwork(_moved(0.009, -0.009, 0.009, pitch=-0.026), model_path)
    # The same robot, measured again
    HeightmapNetwork(replace(ROBOT, foot_radius=0.021), model_path)


def _moved(*by: float, pitch: float = 0.0) -> Robot:
    position = ROBOT.camera_position + np.pad(by, (0, 3 - len(by)))
    return replace(ROBOT, camera_position=position, camera_pitch=ROBOT.camera_pitch + pitch)


@pytest.mark.parametrize(
    "field",
    ["format", "robot", "grid_m", "camera", "proprioception", "warmup_frames", "nominal_delay_s"],
)
def test_missing_metadata_are_refused_by_name(model_path: Path, tmp_path: Path, field: str) -> None:
    path = mutated(model_path, tmp_path / "changed.onnx", without(field))
    with pytest.raises(ModelError, match=f"'{field}' is missing"):
        HeightmapNetwork(ROBOT, path)


@pytest.mark.parametrize(
    "name", ["image", "age", "proprioception", "hidden", "height", "std", "hidden_out"]
)
def test_shapes_that_do_not_fit_are_refused_by_name(
    model_path: Path, tmp_path: Path, name: str
) -> None:
    model = onnx.load(model_path)
    for value in (*model.graph.input, *model.graph.output):
        if value.name == name:
            value.name = f"{name}_renamed"
    for node in model.graph.node:
        for names in (node.input, node.output):
            renamed = [f"{name}_renamed" if entry == name else entry for entry in names]
            del names[:]
            names.extend(renamed)
    onnx.save(model, tmp_path / "changed.onnx")
    with pytest.raises(ModelError, match=f"'{name}'"):
        HeightmapNetwork(ROBOT, tmp_path / "changed.onnx")


@pytest.mark.parametrize("content", [b"", b"\x00" * 100, b"not a model", "truncated"])
def test_files_that_are_no_models_are_refused(
    model_path: Path, tmp_path: Path, content: bytes | str
) -> None:
    path = tmp_path / "broken.onnx"
    path.write_bytes(model_path.read_bytes()[:5000] if isinstance(content, str) else content)
    with pytest.raises(ModelError, match=r"broken\.onnx") as caught:
        HeightmapNetwork(ROBOT, path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="nowhere"):
        HeightmapNetwork(ROBOT, tmp_path / "nowhere.onnx")


def test_one_tick_depends_on_nothing_but_its_arguments(model_path: Path) -> None:
    network = HeightmapNetwork(ROBOT, model_path)
    rng = np.random.default_rng(0)
    arguments = (
        rng.uniform(size=(1, 2, 48, 16)),
        [0.05],
        [True],
        rng.normal(size=(1, 21)),
        np.zeros((1, 256)),
    )
    before = copy.deepcopy(arguments)
    first, second = network.tick(*arguments), network.tick(*arguments)
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
    assert all(np.array_equal(a, b) for a, b in zip(arguments, before, strict=True))


def test_answers_stay_what_they_were(model_path: Path) -> None:
    """Whatever is asked next, for however many robots: nobody else's arrays are handed out."""
    network = HeightmapNetwork(ROBOT, model_path)
    rng = np.random.default_rng(0)
    answers = []
    for robots in (1, 2, 1, 3, 2):
        arguments = (
            rng.uniform(size=(robots, 2, 48, 16)),
            np.full(robots, 0.05),
            np.ones(robots, np.bool_),
        )
        answer = network.tick(
            *arguments, rng.normal(size=(robots, 21)), rng.uniform(size=(robots, 256))
        )
        answers.append((answer, copy.deepcopy(answer)))
    for answer, as_it_was in answers:
        for array, kept in zip(answer, as_it_was, strict=True):
            np.testing.assert_array_equal(array, kept)
