"""A strip of pictures of one trial: the robot, and on the terrain what the planner saw."""

import cv2
import numpy as np
from markupsafe import Markup

from saltus.errors import SaltusError
from saltus.policy.evaluation.trial_trace import TrialTrace
from saltus.reports.page_templates import data_url
from saltus.setup import Setup
from saltus.sim.video import render_snapshots

MOMENTS = 6
FIRST_S = 1.2  # the robot stands for 1 s
SIZE = (320, 240)


def picture_strip(setup: Setup, trace: TrialTrace) -> Markup:
    """HTML with pictures at even times from the first jump to the end.

    A sentence where there is no way to draw.
    """
    last = len(trace.pose) - 1
    chosen = np.linspace(min(FIRST_S, trace.time_s[last]), trace.time_s[last], MOMENTS)
    rows = np.searchsorted(trace.time_s, chosen - 1e-9)
    try:
        poses = trace.pose[rows], trace.joint_position[rows]
        pose, joints, heights = (
            array.astype(np.float64) for array in (*poses, trace.heights[rows])
        )
        frames = render_snapshots(
            setup.robot, setup.terrain, pose, joints, setup.grid, heights, size=SIZE
        )
    except SaltusError as error:
        return Markup("<p>No pictures: {}</p>").format(error)
    shown = Markup('<img src="{}" alt="robot at {:.2f} s" width="33%">')
    return Markup().join(
        shown.format(_source(frame), time_s) for frame, time_s in zip(frames, chosen, strict=True)
    )


def _source(frame: np.ndarray) -> str:
    return data_url("jpeg", cv2.imencode(".jpg", cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))[1])
