"""`saltus bench pages`: which commands it finds,
runs and leaves out, and what it says of one that fails.
"""

import re
from pathlib import Path

import pytest

from benchmarks.pages import LACKS, ROOT, Benchmark, commands

PAGE = """
```sh
saltus robot list                 # what ships
saltus robot \\
    show examples/nothing.xml
saltus router --out runs/mine     # one terminal
docker build -t saltus .
```

```
   prints this
python -c "import saltus; open('runs/mine/made', 'w')"
python -c "import nothing_of_that_name"
```
"""


def test_commands_are_those_of_a_page_in_their_order() -> None:
    readme = commands(ROOT / "README.md")
    assert readme == ["make demo", "make test"]
    every = [command for page in ROOT.glob("docs/**/*.md") for command in commands(page)]
    assert len(every) > 90
    assert [command for command in every if "#" in command] == []


def test_each_reason_to_leave_a_command_out_is_one_of_a_page() -> None:
    pages = [*ROOT.glob("docs/**/*.md"), ROOT / "README.md", *ROOT.glob("models/*.md")]
    every = [f"{page.relative_to(ROOT)}: {command}" for page in pages for command in commands(page)]
    assert [part for part in LACKS if not any(re.search(part, line) for line in every)] == []


def test_a_page_is_run_in_a_folder_of_its_own_and_what_fails_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    assert commands(page)[1] == "saltus robot show examples/nothing.xml"
    run = Benchmark(pages=(page,), out=tmp_path / "rows.jsonl")
    found = run.measure()
    assert (found["commands"], found["ran"]) == (6, 5)
    assert [line.split(": ", 1)[1] for line in found["failed"]] == [
        "saltus robot show examples/nothing.xml: 2",
        'python -c "import nothing_of_that_name": 1',
    ]
    assert list(found["not_run"].values()) == [1]
    assert "no robot 'examples/nothing.xml'" in capsys.readouterr().err
    assert not (Path("runs") / "mine" / "made").exists()
    assert run.measure() == found  # from its file: nothing runs
    assert capsys.readouterr().err == ""
