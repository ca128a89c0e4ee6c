"""A run whose commands are a script: jumps obey it, and each process repeats to the bit."""

import pytest
from lockstep_run import check_repeats, recorded_run

from saltus.config import RunConfig, TerrainConfig
from saltus.recordings.recording import Recording
from saltus.runtime.programs import OPERATOR, PROGRAMS
from saltus.wire.messages import ControllerMode, DriveCommand, RobotState

pytestmark = pytest.mark.slow
SCRIPT = """time_s,mode
0.5,jump
1.5,stand
2.3,lie_down
2.6,jump
4.1,stand
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("run")
    script = folder / "script.csv"
    script.write_text(SCRIPT, encoding="utf-8")
    config = RunConfig(
        robot="go1",
        grid="line",
        terrain=TerrainConfig(terrain="flat"),
        commands=str(script),
        time_limit_s=4.3,
    )
    return recorded_run(folder, config)


def test_it_jumps_stands_lies_and_jumps_again_as_the_script_says(recording: Recording) -> None:
    states = list(recording.of(RobotState))
    modes = [state.mode.name for state in states]
    order = [mode for mode, before in zip(modes, [None, *modes], strict=False) if mode != before]
    assert order[:8] == ["STAND", "RUN", "LANDING", "STAND", "LIE", "STAND", "RUN", "LANDING"]
    began = {mode: 1e-9 * states[modes.index(mode)].time_ns for mode in ("RUN", "LANDING", "LIE")}
    # A first stand of 1 s; a mode is told with the state after the tick that it began in
    assert began == pytest.approx({"RUN": 1.01, "LANDING": 1.51, "LIE": 2.31}, abs=0.011)
    assert ControllerMode.STOPPED not in {state.mode for state in states}


def test_there_is_one_command_for_each_state(recording: Recording) -> None:
    asked = [state.step for state in recording.of(RobotState)]
    told = [command.step for command in recording.of(DriveCommand)]
    assert told[: 4 * 100] == asked[: 4 * 100]


@pytest.mark.parametrize("name", [program.name for program in (OPERATOR, *PROGRAMS)])
def test_every_process_repeats_to_the_bit(recording: Recording, name: str) -> None:
    check_repeats(recording, name, 150)
