"""A model is given to a running service: whatever is wrong with it,
the service keeps the one that it has.
"""

import contextlib
import errno
import json
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from samples import ROBOT, put_robot

from saltus.cli.main import main
from saltus.errors import ModelError
from saltus.grid import LINE
from saltus.heightmap.service import model_inbox as heightmap_model_inbox
from saltus.heightmap.service.model_inbox import FILE, ModelInbox, give_model
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.model_file import checksum_path, put_model
from saltus.runtime.run_folder import SETUP_FILE

PATIENCE_S = 60.0


@pytest.fixture
def inbox(tmp_path: Path) -> Iterator[ModelInbox]:
    inbox = ModelInbox(ROBOT, LINE, tmp_path / FILE)
    yield inbox
    inbox.close()


def verdict(inbox: ModelInbox) -> HeightmapNetwork:
    deadline_s = time.monotonic() + PATIENCE_S
    waiting = threading.Event()
    while (network := inbox.poll()) is None:
        assert time.monotonic() < deadline_s
        waiting.wait(0.01)
    return network


def put(data: bytes, place: Path) -> None:
    """Puts bytes with a checksum that fits."""
    partial = place.with_name(".new")
    partial.write_bytes(data)
    put_model(partial, place)


def changed(model_path: Path, tmp_path: Path, change: Callable[[Any], None]) -> bytes:
    model = onnx.load(model_path)
    change(model)
    onnx.save(model, tmp_path / "changed")
    return (tmp_path / "changed").read_bytes()


def wrong_grid(model: Any) -> None:
    table = {p.key: json.loads(p.value) for p in model.metadata_props}
    table["grid_m"][3] += 0.01
    onnx.helper.set_model_props(model, {name: json.dumps(value) for name, value in table.items()})


def not_finite(model: Any) -> None:
    """Puts a NaN into the first weights."""
    weights = next(w for w in model.graph.initializer if len(w.dims) > 1)
    values = onnx.numpy_helper.to_array(weights).copy()
    values.flat[0] = np.nan
    weights.CopyFrom(onnx.numpy_helper.from_array(values, weights.name))


def test_a_good_model_is_handed_over_once(
    inbox: ModelInbox, model_path: Path, tmp_path: Path
) -> None:
    assert inbox.poll() is None
    model_id = give_model(model_path, put_robot(tmp_path))
    assert verdict(inbox).model_id == model_id == HeightmapNetwork(ROBOT, model_path).model_id
    assert inbox.poll() is None


def test_what_was_there_before_is_no_news(model_path: Path, tmp_path: Path) -> None:
    give_model(model_path, put_robot(tmp_path))
    inbox = ModelInbox(ROBOT, LINE, tmp_path / FILE)
    assert inbox.poll() is None
    assert inbox._check is None
    inbox.close()


@pytest.mark.parametrize(
    "how", ["truncated", "empty", "grid", "not finite", "flipped", "no checksum"]
)
def test_a_bad_model_is_refused_with_a_reason(
    inbox: ModelInbox, model_path: Path, tmp_path: Path, how: str
) -> None:
    good, place = model_path.read_bytes(), tmp_path / FILE
    reasons = {
        "truncated": "not a model that can be run",
        "empty": "has 0 bytes",
        "grid": r"'grid_m\[3\]'",
        "not finite": "fails its check: after 0 good images the heightmap is INVALID",
        "flipped": "is not the file that heightmap.onnx.sha256 names",
        "no checksum": "has no heightmap.onnx.sha256",
    }
    if how == "truncated":
        put(good[: len(good) // 2], place)
    elif how == "empty":
        put(b"", place)
    elif how == "grid":
        put(changed(model_path, tmp_path, wrong_grid), place)
    elif how == "not finite":
        put(changed(model_path, tmp_path, not_finite), place)
    elif how == "flipped":
        put(good, place)
        place.write_bytes(good[:-1000] + bytes([good[-1000] ^ 4]) + good[-999:])
    else:
        shutil.copyfile(model_path, place)
    with pytest.raises(ModelError, match=reasons[how]) as caught:
        verdict(inbox)
    assert "\n" not in str(caught.value)
    assert inbox.poll() is None


def test_after_a_bad_model_a_good_one_is_taken(
    inbox: ModelInbox, model_path: Path, tmp_path: Path
) -> None:
    put(b"not a model", tmp_path / FILE)
    with pytest.raises(ModelError, match="not a model"):
        verdict(inbox)
    give_model(model_path, put_robot(tmp_path))
    assert verdict(inbox).model_id == HeightmapNetwork(ROBOT, model_path).model_id


@pytest.mark.parametrize("how", ["damaged", "no checksum"])
def test_a_model_that_cannot_be_used_is_not_even_given(
    model_path: Path, tmp_path: Path, how: str
) -> None:
    model, run_dir = tmp_path / "new.onnx", tmp_path / "run"
    run_dir.mkdir()
    put_robot(run_dir)
    shutil.copyfile(model_path, model)
    if how == "damaged":
        checksum_path(model).write_text(checksum_path(model_path).read_text())
        model.write_bytes(model.read_bytes()[:-1])
    with pytest.raises(ModelError, match=r"new\.onnx"):
        give_model(model, run_dir)
    assert [path.name for path in run_dir.iterdir()] == [SETUP_FILE]


def test_closing_does_not_wait_for_a_check(model_path: Path, tmp_path: Path) -> None:
    inbox = ModelInbox(ROBOT, LINE, tmp_path / FILE)
    give_model(model_path, put_robot(tmp_path))
    assert inbox.poll() is None
    before_s = time.monotonic()
    inbox.close()
    assert time.monotonic() - before_s < PATIENCE_S / 2
    assert inbox._check is not None
    assert inbox._check.done()


def test_a_check_that_cannot_begin_refuses_the_model(
    inbox: ModelInbox, model_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_memory(*_: object, **__: object) -> None:
        raise OSError(errno.ENOMEM, "Cannot allocate memory")

    monkeypatch.setattr(subprocess, "Popen", no_memory)
    give_model(model_path, put_robot(tmp_path))
    assert inbox.poll() is None
    with pytest.raises(ModelError, match="Cannot allocate memory"):
        verdict(inbox)


def test_a_check_that_is_killed_refuses_the_model(
    inbox: ModelInbox, model_path: Path, tmp_path: Path
) -> None:
    """As it is when the runtime crashes or asks for too much memory."""
    give_model(model_path, put_robot(tmp_path))
    assert inbox.poll() is None
    deadline_s, waiting = time.monotonic() + PATIENCE_S, threading.Event()
    while inbox._process is None:
        assert time.monotonic() < deadline_s
        waiting.wait(0.001)
    inbox._process.kill()
    with pytest.raises(ModelError, match="ended its check with code -9"):
        verdict(inbox)


@pytest.fixture
def looking(inbox: ModelInbox) -> Iterator[None]:
    """A service that looks into the folder."""
    stopped = threading.Event()

    def look() -> None:
        while not stopped.wait(0.01):
            with contextlib.suppress(ModelError):
                inbox.poll()

    thread = threading.Thread(target=look)
    thread.start()
    yield
    stopped.set()
    thread.join()


@pytest.mark.usefixtures("looking")
def test_the_command_puts_a_model_where_the_service_looks(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["heightmap", "give", str(model_path), "--run-dir", str(put_robot(tmp_path))]) == 0
    model_id = HeightmapNetwork(ROBOT, tmp_path / FILE).model_id
    assert capsys.readouterr().out == f"model {model_id} is accepted\n"
    assert checksum_path(tmp_path / FILE).read_text() == checksum_path(model_path).read_text()


@pytest.mark.usefixtures("looking")
def test_the_command_fails_where_the_service_refuses(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    put(changed(model_path, tmp_path, not_finite), tmp_path / "new.onnx")
    assert (
        main(
            ["heightmap", "give", str(tmp_path / "new.onnx"), "--run-dir", str(put_robot(tmp_path))]
        )
        == 1
    )
    assert "is refused: " in capsys.readouterr().out


def test_without_a_service_the_command_fails_and_leaves_nothing(
    model_path: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(heightmap_model_inbox, "HEARD_S", 0.3)
    assert main(["heightmap", "give", str(model_path), "--run-dir", str(put_robot(tmp_path))]) == 2
    assert (
        f"no heightmap service looks into '{tmp_path}'" in capsys.readouterr().err.splitlines()[-1]
    )
    assert [path.name for path in tmp_path.iterdir()] == [SETUP_FILE]


def test_the_command_says_what_is_wrong_and_ends_with_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "new.onnx"
    put(b"not a model", model)
    assert main(["heightmap", "give", str(model), "--run-dir", str(put_robot(tmp_path))]) == 2
    assert "new.onnx is not a model that can be run" in capsys.readouterr().err
