"""Every file of a stranger is read rightly, or refused by one line that names the cure; soon, and in little memory."""

import re
import time
from dataclasses import asdict
from pathlib import Path

import pytest
import tomli_w
from strangers import FILES, Stranger

from saltus.cli.main import main
from saltus.recordings.run_log import read_run_log

SOON_S = 5.0  # of a processor


def _plain(value: object) -> object:
    """A description as TOML has it: without what is not said."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items() if inner is not None and inner != {}}
    return list(value) if isinstance(value, tuple) else value


@pytest.mark.parametrize("stranger", FILES, ids=lambda stranger: stranger.name)
def test_a_file_is_read_rightly_or_refused_with_its_cure(
    stranger: Stranger, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = stranger.write(tmp_path)
    (tmp_path / "mine.toml").write_text(tomli_w.dumps(_plain(asdict(stranger.description))), encoding="utf-8")
    out, before_s = tmp_path / "log", time.process_time()
    code = main(["real2sim", "import", str(path), "--description", str(tmp_path / "mine.toml"), "--out", str(out)])
    told = capsys.readouterr()
    assert time.process_time() - before_s < SOON_S
    if stranger.check is None:
        assert (code, told.out) == (2, "")
        assert told.err.count("\n") == 1
        assert told.err.startswith("saltus: ")
        assert len(told.err) < 600
        assert re.search(stranger.says, told.err), told.err
        assert not out.exists()
    else:
        assert code == 0, told.err
        assert re.search(stranger.says, told.out), told.out
        first = next(line for line in told.out.splitlines() if line.startswith(str(out)))
        stranger.check(read_run_log(Path(first)))
