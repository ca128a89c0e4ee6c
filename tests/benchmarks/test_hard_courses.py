"""`saltus bench hard_courses`: its rows are what they say,
and trials that were kept are not run again.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import hard_courses
from benchmarks.hard_courses import ROWS
from saltus.cli.main import main
from saltus.effects.chain import BodyChain
from saltus.policy.evaluation.evaluate import courses_of
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.sim import robot_model
from saltus.sim.plant import Plant
from saltus.terrain.curriculum import FAMILIES
from saltus.terrain.terrain import check_terrain

pytestmark = pytest.mark.slow

SHORT = ["gap 0.8", "step down 0.6"]


def table(capsys: pytest.CaptureFixture[str], out: Path, *words: str) -> dict[str, Any]:
    given = ["--rows", *SHORT, "--processes", "1", "--out", str(out), "--json", *words]
    assert main(["bench", "hard_courses", "--", *given]) == 0
    figures: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return figures


def test_trials_that_were_kept_are_not_run_again_and_more_are_added(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out, seeds = tmp_path / "trials.jsonl", list[int]()
    really = hard_courses.run

    def counting(heights: Any, camera: str, task: Any) -> dict[int, dict[str, Any]]:
        seeds.extend(task[2])
        return really(heights, camera, task)

    monkeypatch.setattr(hard_courses, "run", counting)
    first = table(capsys, out, "--trials", "1")
    again = table(capsys, out, "--trials", "1")
    assert again == first
    assert seeds == 2 * [70_000]
    more = table(capsys, out, "--trials", "2")
    assert seeds == [*2 * [70_000], *2 * [70_001]]
    for row in SHORT:
        cells = more["rows"][row]
        assert cells["success 1"] + sum(cells["failures 1"].values()) == 2
        assert cells["success 1"] >= first["rows"][row]["success 1"]
    assert len(out.read_text().splitlines()) == 4


@pytest.mark.parametrize("name", ROWS)
def test_every_row_has_a_course_that_can_be_finished(name: str) -> None:
    for terrain in courses_of(ROWS[name].course, (1, 2, 3)):
        assert check_terrain(terrain, name) is terrain


def test_rows_have_all_families_but_flat_ground() -> None:
    assert {row.course.terrain for row in ROWS.values()} == set(FAMILIES) - {"flat"}


def test_soft_feet_resist_torsion_and_rolling() -> None:
    (terrain,) = courses_of(ROWS["stairs 0.20"].course, (0,))
    body = BodyChain(ROWS["stairs 0.20, soft feet"].effects)
    model = Plant(load_robot(DEFAULT_ROBOT), terrain, friction=0.7, body=body).model
    own = model.geom_group == robot_model.ROBOT_GROUP
    assert set(model.geom_condim[own]) == {6}
    np.testing.assert_allclose(
        model.geom_friction[own], np.tile([0.7, 0.02, 0.01], (own.sum(), 1)), atol=2e-5
    )
    np.testing.assert_allclose(
        model.geom_solimp[own, :3], np.tile([0.015, 0.99, 0.022], (own.sum(), 1))
    )
