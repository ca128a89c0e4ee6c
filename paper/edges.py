"""Rows about single steps and gaps: how high and wide, where feet land, how the trunk pitches."""

from typing import Any

import numpy as np

from paper.drawing import FRONT, OTHER, REAR, draw_ground, legend, subplots
from paper.run_figures import COURSES, Made, sizes_of_courses, spread, success
from paper.runs import Effort, Setting, ran, watched
from saltus.config import TerrainConfig
from saltus.terrain.curriculum import make_terrain

STEP_HEIGHTS_M = (0.2, 0.3, 0.4, 0.5, 0.6)
GAP_WIDTHS_M = (0.2, 0.4, 0.6, 0.8)
STARTS_X = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""As far as trials put robots ahead of the usual start and behind it."""
SHOWN_S = 0.9
"""Body motion that is shown before and after an edge: two bounds."""
LOOK_M = 0.35
"""Before an edge: the robot has not jumped, and its heights reach over the edge."""


def gap_footsteps(effort: Effort) -> Made:
    """Where feet come down before and after gaps of several widths, from several starts."""
    gaps = [make_terrain(TerrainConfig(terrain="gap", gap_m=width)) for width in GAP_WIDTHS_M]
    starts = STARTS_X[: max(1, effort.trials)]
    results = ran([Setting(terrain=gap, starts_x=starts) for gap in gaps], effort)
    figure, axes = subplots(len(gaps), 1, 7.0, sharex=True)
    numbers = {}
    for axis, width, terrain, runs in zip(axes, GAP_WIDTHS_M, gaps, results, strict=True):
        near, far = terrain.edges_x[0], terrain.edges_x[-1]
        axis.axvspan(near, far, color="0.85", linewidth=0)
        rows: dict[str, Any] = {
            "success": sum(run.outcome.success for run in runs),
            "trials": len(runs),
        }
        for pair, colour, offset in (("front", FRONT, -0.12), ("rear", REAR, 0.12)):
            places = [[landing.x for landing in run.landings(pair)] for run in runs]
            for i, xs in enumerate(places):
                axis.plot(
                    xs,
                    np.full(len(xs), i + offset),
                    "o",
                    color=colour,
                    markersize=4,
                    label="" if i else pair,
                )
            before = [[near - x for x in xs if x <= near] for xs in places]
            behind = [[x - far for x in xs if x >= far] for xs in places]
            rows[f"{pair}_last_before_m"] = spread([min(ways) for ways in before if ways])
            rows[f"{pair}_first_behind_m"] = spread([min(ways) for ways in behind if ways])
            rows[f"{pair}_in_the_gap"] = sum(any(near < x < far for x in xs) for xs in places)
        numbers[f"{width:g} m"] = rows
        axis.set_title(
            f"gap of {width:g} m: {rows['success']} of {len(runs)} across", loc="left", fontsize=10
        )
        axis.set_yticks(range(len(starts)), [f"{x:+.1f} m" for x in starts])
        axis.set_ylabel("start")
        axis.set_xlim(near - 1.4, far + 1.6)
    legend(axes[0], fontsize=8, loc="upper left")
    axes[-1].set_xlabel("x [m]; grey: the gap; where front and rear feet came down")
    return Made(
        numbers=numbers,
        figure=figure,
        configuration={"gap_m": GAP_WIDTHS_M, "start_x_m": starts},
        most_seeds=1,
    )


def step_pitch(effort: Effort) -> Made:
    """The pitch of the trunk over steps of several heights."""
    steps = [
        make_terrain(TerrainConfig(terrain="step", height_m=height)) for height in STEP_HEIGHTS_M
    ]
    results = ran([Setting(terrain=terrain) for terrain in steps], effort)
    figure, axis = subplots(1, 1, 3.8)
    import matplotlib as mpl

    colours = mpl.colormaps["viridis"](np.linspace(0.0, 0.85, len(steps)))
    numbers = {}
    for height, terrain, runs, colour in zip(STEP_HEIGHTS_M, steps, results, colours, strict=True):
        edge = terrain.first_edge_x
        highest = []
        for i, run in enumerate([run for run in runs if run.outcome.success]):
            near = np.abs(run.trace.time_s - run.time_at(edge)) < SHOWN_S
            nose_up = -np.degrees(run.trace.pitch)
            highest.append(float(nose_up[near].max()))
            if i == 0:
                x = run.trace.base[:, 0] - edge
                axis.plot(x[near], nose_up[near], color=colour, label=f"{height:g} m")
                air = near & ~run.trace.loaded.any(axis=-1)
                axis.plot(x[air], nose_up[air], "o", color=colour, markersize=3)
        numbers[f"{height:g} m"] = {**success(runs), "nose_up_deg": spread(highest)}
    axis.set_xlabel("trunk before (-) and behind the step's edge [m]; dots: in the air")
    axis.set_ylabel("nose up [deg]")
    legend(axis, title="step", fontsize=8)
    return Made(numbers=numbers, figure=figure, configuration={"height_m": STEP_HEIGHTS_M})


def step_and_gap(effort: Effort) -> Made:
    """One run over the step and one over the gap:
    predicted heights, the camera's image, the robot.
    """
    from saltus.grid import HEIGHTMAP_X, LINE
    from saltus.robots.loading import load_robot
    from saltus.robots.shipped import DEFAULT_ROBOT
    from saltus.sim.video import render_run

    figure, axes = subplots(2, 3, 5.2, gridspec_kw={"width_ratios": (1.7, 1.8, 0.7)})
    robot, numbers = load_robot(DEFAULT_ROBOT), {}
    for line, name in zip(axes, ("step", "gap"), strict=True):
        terrain = make_terrain(COURSES[name])
        run, images = watched(Setting(terrain=terrain), effort)
        trace, edge = run.trace, terrain.first_edge_x
        row = int(np.argmax(trace.base[:, 0] > edge - LOOK_M))
        ahead = trace.base[:, 0, None] + HEIGHTMAP_X
        true = terrain.height_at(ahead, np.zeros_like(ahead)) - trace.pose[:, 2, None]
        error = np.abs(trace.heights - true)[run.going & (trace.base[:, 0] < edge)]
        middle, mean = (
            float(of(error)) if error.size else float("nan") for of in (np.median, np.mean)
        )
        numbers[name] = {
            "success": run.outcome.success,
            "median_error_of_heights_cm": round(100 * middle, 2),
            "mean_error_of_heights_cm": round(100 * mean, 2),
        }
        pose, joints = (
            trace.pose[[row]].astype(np.float64),
            trace.joint_position[[row]].astype(np.float64),
        )
        (picture,) = render_run(
            robot,
            terrain,
            np.zeros(1),
            pose,
            joints,
            LINE,
            trace.heights[[row]].astype(np.float64),
            size=(480, 320),
        )
        line[0].imshow(picture)
        line[0].axis("off")
        line[0].set_title(
            f"{name} of {'0.60' if name == 'step' else '0.80'} m", loc="left", fontsize=10
        )
        axis = line[1]
        draw_ground(axis, terrain, float(trace.base[row, 0]) - 0.5, float(trace.base[row, 0]) + 0.9)
        axis.plot(
            ahead[row],
            trace.heights[row] + trace.pose[row, 2],
            "o-",
            color=OTHER,
            markersize=3,
            label="predicted",
        )
        axis.plot(*trace.base[row], "k^", label="trunk")
        legend(axis, fontsize=7)
        axis.set_xlabel("x [m]")
        axis.set_ylabel("z [m]")
        _, image = min(images, key=lambda taken: abs(taken[0] - trace.time_s[row]))
        shown = line[2].imshow(
            np.where(image > 0.0, image, np.nan), cmap="viridis_r", vmin=0.2, vmax=3.0
        )
        line[2].set_title("its image", loc="left", fontsize=10)
        line[2].axis("off")
        figure.colorbar(shown, ax=line[2], label="depth [m]")
    configuration = {
        **sizes_of_courses({name: COURSES[name] for name in ("step", "gap")}),
        "moment_m_before_the_edge": LOOK_M,
    }
    return Made(numbers=numbers, figure=figure, configuration=configuration, most_seeds=1)
