"""The command line: helps that show how a command is used,
and JSON that other programs can read.
"""

import json
import os
import re
import shlex
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from saltus.cli.main import COMMANDS, command_of, main
from saltus.cli.output import without_infinities
from saltus.cli.parsing import BAD_INPUT
from saltus.config import RunConfig
from saltus.errors import SaltusError
from saltus.policy.evaluation.walking_trials import WalkTrials
from saltus.runtime.programs import Program


def help_of(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> str:
    monkeypatch.setenv("COLUMNS", "300")
    with pytest.raises(SystemExit) as stopped:
        main([*command.split(), "--help"])
    assert stopped.value.code == 0
    return capsys.readouterr().out


def test_every_command_has_examples_that_it_takes_and_defaults_that_are_none_of_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    commands, leaves = [""], 0
    for command in commands:
        said = help_of(command, capsys, monkeypatch)
        assert said.startswith(f"usage: saltus {command}".rstrip())
        assert not re.search(r"\bNone\b|default: \)", said), command
        if parts := re.match(r"usage: .* \[-h\] {(.*)}\n", said):
            commands += [f"{command} {part}".strip() for part in parts[1].split(",")]
            continue
        leaves += 1
        examples = re.findall(rf"^(?:Example: | *)saltus ({command}(?: .*)?)$", said, flags=re.M)
        assert examples, command
        for example in examples:
            words = shlex.split(example.removesuffix(" --help"))
            with (
                pytest.raises(SaltusError, match="No such file")
                if "--resume" in words
                else nullcontext()
            ):
                command_of(words)
    assert leaves >= 30


@pytest.mark.parametrize(
    "words", ["heightmap collect gpu --json", "real2sim cycle --json --hidden robot.toml"]
)
def test_a_flag_stays_on_where_defaults_are_read_from_what_goes_on(words: str) -> None:
    group: Any = command_of(words.split()).command
    assert getattr(group, "command", group).json is True


@pytest.mark.parametrize(
    ("words", "camera"),
    [
        ("demo", "d435i"),
        ("up --planner scripted", "d435i"),
        ("up --planner walking", "d435i_whole"),
        ("demo --planner walking --camera ideal", "ideal"),
    ],
)
def test_a_run_that_walks_sees_the_whole_image_unless_a_camera_is_named(
    words: str, camera: str
) -> None:
    run: Any = command_of(words.split())
    assert run.config(1.0).camera == camera


def test_trials_of_walking_have_the_camera_of_runs_that_walk() -> None:
    trials: Any = command_of(["policy", "walk", "trials"])
    while hasattr(trials, "command"):
        trials = trials.command
    assert trials.camera == WalkTrials.camera == "d435i_whole"


def test_json_has_no_infinities() -> None:
    table = without_infinities(
        {"a": float("inf"), "b": [float("nan"), 1.0], "c": {"d": (2.0, float("-inf"))}}
    )
    assert json.loads(json.dumps(table, allow_nan=False)) == {
        "a": None,
        "b": [None, 1.0],
        "c": {"d": [2.0, None]},
    }


def test_the_list_of_commands_says_what_each_says_itself_and_imports_none(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    listed = " ".join(help_of("", capsys, monkeypatch).split())
    for name in COMMANDS:
        own = help_of(name, capsys, monkeypatch).split("\n\n")[1]
        assert f" {name} {' '.join(own.split())}" in listed
    code = (
        "import sys; from saltus.cli.main import main\ntry: main(['--help'])\nexcept SystemExit: "
        "print(*sys.modules)"
    )
    loaded = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert "saltus.cli.main" in loaded
    assert {"numpy", *(f"saltus.cli.{name}" for name in COMMANDS)} & set(loaded) == set()


COMPLETIONS = {
    "saltus heigh": ["heightmap"],
    "saltus heightmap s": ["serve"],
    "saltus demo --terr": ["--terrain"],  # its description has several lines
    "saltus demo --pace ": ["lockstep", "realtime"],
}


def test_bash_completes_commands_flags_and_values(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--completion", "bash"]) == 0
    script = tmp_path / "saltus"
    script.write_text(capsys.readouterr().out)
    for line, expected in COMPLETIONS.items():
        words = [shlex.quote(word) for word in line.split(" ")]
        typed = f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}"
        program = f'source {script}; {typed}; _tyro_saltus; printf "%s\\n" "${{COMPREPLY[@]}}"'
        done = subprocess.run(
            ["/bin/bash", "-c", program], capture_output=True, text=True, check=True
        )
        assert done.stdout.splitlines() == expected


def test_a_shell_that_is_not_known_is_told_those_that_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["--completion", "fish"]) == 2
    assert "bash" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "spared"), [([], {"render"}), (["--standbys"], {"render", "heightmap", "policy"})]
)
def test_up_starts_standbys_where_they_are_asked_for(
    words: list[str], spared: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[str] = []

    def stack(_: RunConfig, __: Path, programs: tuple[Program, ...], **___: object) -> None:
        started.extend(program.name for program in programs if program.spare)
        raise SaltusError("that is all")

    monkeypatch.setattr("saltus.runtime.stack.Stack", stack)
    assert main(["up", "--out", str(tmp_path / "run"), *words]) == BAD_INPUT
    assert set(started) == spared


@pytest.mark.parametrize(
    ("words", "named"),
    [(["--grid", "sacn"], "sacn"), (["--grid", "scan", "--pace", "lockstep"], "saltus replay")],
)
def test_up_refuses_a_scan_that_it_cannot_tell(
    words: list[str], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["up", "--out", str(tmp_path / "run"), *words]) == BAD_INPUT
    assert named in capsys.readouterr().err


@pytest.mark.parametrize(("given", "expected"), [({}, 1), ({"OPENBLAS_NUM_THREADS": "2"}, 2)])
def test_numpy_computes_in_one_thread_unless_the_user_says_other(
    given: dict[str, str], expected: int
) -> None:
    """Threads of BLAS that wait for each other take a busy computer's time."""
    code = (
        "import os\nfrom saltus.cli.main import main\nmain(['--version'])\nimport numpy\n"
        "here = numpy.ones((500, 500))\nhere @ here\nprint(len(os.listdir('/proc/self/task')))"
    )
    environment = {k: v for k, v in os.environ.items() if not k.endswith("NUM_THREADS")} | given
    shown = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    ).stdout
    assert int(shown.splitlines()[-1]) == min(expected, len(os.sched_getaffinity(0)))


@pytest.mark.parametrize("given", ["passive", "active"])
def test_threads_of_torch_sleep_while_they_wait_unless_the_user_says_other(given: str) -> None:
    """Threads that wait in a loop take a busy computer's time."""
    code = "from saltus.cli.main import main\nmain(['--version'])\nimport torch"
    said = {"OMP_WAIT_POLICY": given} if given == "active" else {}
    environment = {k: v for k, v in os.environ.items() if not k.startswith("OMP_")} | said
    told = subprocess.run(
        [sys.executable, "-c", code],
        env=environment | {"OMP_DISPLAY_ENV": "true"}, capture_output=True, text=True, check=True,
    ).stderr  # fmt: skip
    assert f"OMP_WAIT_POLICY = '{given.upper()}'" in told


def test_a_file_gets_few_lines_of_a_progress_bar() -> None:
    script = """
import sys, time
from saltus.cli.main import main
main(["--version"])
from tqdm import tqdm
for _ in tqdm(range(1000), file=sys.stderr):
    time.sleep(0.001)
"""
    environment = {name: value for name, value in os.environ.items() if name[:5] != "TQDM_"}
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=environment, check=True
    )
    assert "1000/1000" in done.stderr
    assert done.stderr.count("%|") < 5
