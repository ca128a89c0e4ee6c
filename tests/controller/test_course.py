import numpy as np
import pytest

from saltus.config import TerrainConfig
from saltus.controller.course_run import AFTERMATH_LIMIT_S, STAND_S, STOP_AFTER_FINISH_M, CourseRun
from saltus.terrain.curriculum import make_terrain
from saltus.wire.messages import ControllerMode

TERRAIN = make_terrain(TerrainConfig(terrain="flat"))
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
DT = 0.01


def follow(position_x, mode, contact_after_s=np.inf, limit_s=20.0):
    course = CourseRun(TERRAIN, limit_s)
    for step in range(1, 4000):
        t = step * DT
        state = course.step(
            t, np.array([position_x(t), 0.0, 0.27]), LEVEL, t > contact_after_s, mode(position_x(t))
        )
        if state.over:
            return t, state
    raise AssertionError("the run never ended")


def damped(_):
    return ControllerMode.DAMP


def running(_):
    return ControllerMode.RUN


def test_a_finished_run_goes_on_past_the_finish_then_stands():
    halt_x = TERRAIN.finish_x + STOP_AFTER_FINISH_M
    stop_x = halt_x + 0.3

    def mode(x):
        return ControllerMode.STAND if x >= stop_x else ControllerMode.RUN

    end_s, state = follow(lambda t: min(t, stop_x), mode)
    assert state.outcome is not None
    assert state.outcome.success
    assert state.halt
    assert end_s == pytest.approx(stop_x + STAND_S, abs=0.03)


def test_nothing_halts_before_the_finish():
    course = CourseRun(TERRAIN, 20.0)
    for step in range(1, 500):
        state = course.step(
            step * DT, np.array([0.01 * step, 0.0, 0.27]), LEVEL, False, ControllerMode.RUN
        )
        assert state.outcome is None
        assert not state.halt
        assert not state.over


def test_a_fall_ends_the_run_soon():
    end_s, state = follow(np.sqrt, damped, contact_after_s=2.0)
    assert state.outcome is not None
    assert state.outcome.cause == "trunk_contact"
    assert end_s == pytest.approx(2.0 + STAND_S, abs=0.03)


def test_a_robot_that_never_comes_to_rest_ends_too():
    end_s, state = follow(np.sqrt, running, limit_s=4.0)
    assert state.outcome is not None
    assert state.outcome.cause == "time_limit"
    assert state.halt
    assert end_s == pytest.approx(4.0 + AFTERMATH_LIMIT_S, abs=0.05)
