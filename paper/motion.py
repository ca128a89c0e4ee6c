"""Rows about motion: what each measures, and how it is drawn.

Everything here is measured in simulation.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from paper.drawing import OTHER, OURS, draw_stance, legend, subplots
from paper.new_ground import NEW_GROUND
from paper.run_figures import (
    COURSES,
    STAIRS,
    STONES,
    Made,
    draw_side,
    first_success,
    on_ground,
    sizes_of_courses,
    spread,
    success,
    summary,
    values_of,
)
from paper.runs import PAIRS, Effort, Setting, ran
from saltus.config import TerrainConfig
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain

GAITS = 4
"""Trials of which one is drawn."""


def terrains(effort: Effort) -> Made:
    """The four kinds at three difficulties, and their sizes."""
    del effort  # nothing is run
    difficulties = (0.25, 0.5, 1.0)
    figure, axes = subplots(len(COURSES), 1, 6.4)
    numbers = {}
    for axis, (name, course) in zip(axes, COURSES.items(), strict=True):
        made = [
            make_terrain(TerrainConfig(terrain=course.terrain, difficulty=d)) for d in difficulties
        ]
        for terrain, shade in zip(
            reversed(made), ("tab:red", "tab:orange", "tab:green"), strict=True
        ):
            x = np.linspace(0.0, 6.5, 2000)
            axis.plot(
                x,
                terrain.height_at(x, np.zeros_like(x)),
                color=shade,
                linewidth=1,
                label=_sizes(terrain),
            )
        axis.set_ylabel("z [m]")
        axis.set_title(name, loc="left", fontsize=10)
        legend(axis, loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7)
        numbers[name] = {
            f"difficulty {d:g}": dict(t.params) for d, t in zip(difficulties, made, strict=True)
        }
    axes[-1].set_xlabel("x [m]")
    return Made(numbers=numbers, figure=figure, configuration={"difficulties": difficulties})


def performance(effort: Effort) -> Made:
    """The table of courses: success, speed, jumps."""
    results = ran([Setting(terrain=make_terrain(course)) for course in COURSES.values()], effort)
    table = {name: summary(runs) for name, runs in zip(COURSES, results, strict=True)}
    figure, axes = subplots(1, 3, 3.0)
    for axis, key, title in zip(
        axes,
        ("success", "speed_mps", "jumps"),
        ("successes", "mean speed [m/s]", "jumps"),
        strict=True,
    ):
        if key == "success":
            axis.bar(list(table), [row["success"] for row in table.values()], color=OURS)
        else:
            values = [values_of(runs, key) for runs in results]
            axis.boxplot([v or [float("nan")] for v in values], tick_labels=list(table))
        axis.set_title(title, loc="left", fontsize=10)
        axis.tick_params(axis="x", rotation=25)
    return Made(numbers=table, figure=figure, configuration=sizes_of_courses(COURSES))


def staircase(effort: Effort) -> Made:
    """14 stairs: time, speeds and jumps; one run from the side."""
    return _course("stairs", STAIRS, effort)


def stones(effort: Effort) -> Made:
    """Stepping stones: time, speed and jumps; one run from the side."""
    return _course("stepping stones", STONES, effort)


def _course(name: str, course: TerrainConfig, effort: Effort) -> Made:
    terrain = make_terrain(course)
    (runs,) = ran([Setting(terrain=terrain)], effort)
    numbers = summary(runs)
    first, last = float(terrain.edges_x[0]), float(terrain.edges_x[-1])
    length = last - first + (course.run_m or 0.0)
    rise = float(terrain.height_at(last + 0.1, 0.0))
    over = [run.time_at(first + length) - run.time_at(first) for run in runs if run.outcome.success]
    numbers |= {
        "length_m": round(length, 3),
        "rise_m": round(rise, 3),
        "time_over_it_s": spread(over),
        "horizontal_mps": spread([length / t for t in over]),
        "vertical_mps": spread([rise / t for t in over]),
    }
    figure, axis = subplots(1, 1, 4.2 if rise else 2.6)
    draw_side(axis, first_success(runs), first - 0.8, last + 0.9)
    axis.set_title(f"{name}: trunk (line) and where feet came down", loc="left", fontsize=10)
    axis.set_aspect("equal")
    return Made(numbers=numbers, figure=figure, configuration=sizes_of_courses({name: course}))


def gait(effort: Effort) -> Made:
    """The four modes of the bounding gait as they are planned and as feet bear on the stairs."""
    (runs,) = ran(
        [Setting(terrain=make_terrain(STAIRS))], replace(effort, trials=min(effort.trials, GAITS))
    )
    run = first_success(runs)
    going = run.going
    front, rear = run.trace.stance[:, 0], run.trace.stance[:, 2]
    modes = {
        "front stance": front & ~rear, "rear stance": rear & ~front, "flight": ~front & ~rear,
        "all stand": front & rear
    }  # fmt: skip
    share = {name: round(float(mask[going].mean()), 3) for name, mask in modes.items()}
    bears = [np.asarray(run.trace.loaded[:, legs].any(axis=-1)) for legs in PAIRS.values()]
    off = ~(bears[0] | bears[1])
    numbers = {
        "share_of_time_planned": share,
        "share_of_time_in_the_air": round(float(off[going].mean()), 3),
        "stepping_frequency_hz": spread(run.frequency_hz[going].tolist()),
    }
    figure, axis = subplots(1, 1, 2.2)
    draw_stance(
        axis, run.trace.time_s, (("front feet", front, bears[0]), ("rear feet", rear, bears[1]))
    )
    axis.set_xlim(1.0, run.trace.time_s[-1])
    axis.set_xlabel("time [s]; grey: to stand, red: bears")
    return Made(
        numbers=numbers,
        figure=figure,
        configuration=sizes_of_courses({"stairs": STAIRS}),
        most_seeds=GAITS,
    )


def tracking(effort: Effort) -> Made:
    """Velocities that the policy asks for and gets, with and without feedback."""
    terrain = make_terrain(STAIRS)
    results = ran([Setting(terrain=terrain, feedback=on) for on in (True, False)], effort)
    numbers: dict[str, Any] = {}
    figure, axes = subplots(3, 2, 6.2, sharex=True, sharey="row")
    names = ("ahead [m/s]", "up [m/s]", "pitch rate [rad/s]")
    for column, (label, runs) in enumerate(
        zip(("with feedback", "feed-forward only"), results, strict=True)
    ):
        error = np.concatenate([(run.velocity - run.reference)[on_ground(run)] for run in runs])
        rms = np.sqrt(np.mean(error**2, axis=0)) if len(error) else np.full(3, np.nan)
        numbers[label] = {
            "rms_ahead_mps": round(float(rms[0]), 3),
            "rms_up_mps": round(float(rms[1]), 3),
            "rms_pitch_rate_rad_s": round(float(rms[2]), 3),
            "success": sum(run.outcome.success for run in runs),
            "steps_before_failure": spread([run.edges_passed for run in runs]),
        }
        run, time_s = runs[0], runs[0].trace.time_s
        for row, name in enumerate(names):
            axis = axes[row][column]
            ground = (run.trace.stance & run.trace.loaded).any(axis=-1)
            axis.fill_between(
                time_s,
                0,
                1,
                where=~ground,
                transform=axis.get_xaxis_transform(),
                color="0.93",
                linewidth=0,
            )
            axis.plot(
                time_s, run.reference[:, row], "--", color="0.3", linewidth=1, label="asked for"
            )
            axis.plot(
                time_s,
                run.velocity[:, row],
                color=OURS if column == 0 else OTHER,
                linewidth=1,
                label="measured",
            )
            axis.set_ylabel(name if column == 0 else "")
        axes[0][column].set_title(
            f"{label}: pitch rate off by {rms[2]:.2f} rad/s", loc="left", fontsize=10
        )
        axes[2][column].set_xlabel("time [s]; grey: nothing that stands touches the ground")
    legend(axes[0][0], fontsize=7, loc="lower right")
    axes[0][0].set_xlim(1.0, 3.5)
    return Made(numbers=numbers, figure=figure, configuration=sizes_of_courses({"stairs": STAIRS}))


def no_feedback_deployment(effort: Effort) -> Made:
    """The shipped policy with the velocity feedback of legs
    that stand switched off when it is deployed.
    """
    courses = [make_terrain(course) for course in COURSES.values()]
    settings = [
        Setting(terrain=terrain, feedback=on) for on in (True, False) for terrain in courses
    ]
    results = ran(settings, effort)
    numbers: dict[str, Any] = {}
    for i, label in enumerate(("with feedback", "without")):
        for name, runs in zip(COURSES, results[i * len(COURSES) :], strict=False):
            numbers.setdefault(name, {})[label] = {
                **success(runs),
                "edges": spread([r.edges_passed for r in runs]),
            }
    figure, axes = subplots(1, 2, 3.2)
    place = np.arange(len(COURSES))
    for i, (label, colour) in enumerate((("with feedback", OURS), ("without", OTHER))):
        axes[0].bar(
            place + 0.4 * i,
            [numbers[n][label]["success"] for n in COURSES],
            0.38,
            color=colour,
            label=label,
        )
        steps = [run.edges_passed for run in results[i * len(COURSES)]]
        axes[1].hist(
            steps, bins=np.arange(-0.5, 15.5), rwidth=0.8, alpha=0.6, color=colour, label=label
        )
    axes[0].set_xticks(place + 0.2, list(COURSES), rotation=20, fontsize=8)
    axes[0].set_ylim(0.0, 1.25 * effort.trials)  # room for what the colours mean
    axes[0].set_title(f"successes of {effort.trials}", loc="left", fontsize=10)
    axes[1].set_title("steps of the staircase before failure (14: all)", loc="left", fontsize=10)
    axes[1].set(xlabel="steps", ylabel="trials")
    legend(axes[0], fontsize=8, ncols=2, loc="upper left")
    return Made(numbers=numbers, figure=figure, configuration=sizes_of_courses(COURSES))


def generalisation(effort: Effort) -> Made:
    """Ground that no training has: stairs of planks,
    stairs with noses, several obstacles in a row.
    """
    ground = {name: make() for name, make in NEW_GROUND.items()}
    settings = [
        Setting(terrain=terrain, true_heights=true)
        for true in (False, True)
        for terrain in ground.values()
    ]
    results = ran(settings, effort)
    told = dict(zip(ground, results[len(ground) :], strict=True))
    numbers = {}
    figure, axes = subplots(len(ground), 1, 7.0)
    for axis, (name, runs) in zip(
        axes, zip(ground, results[: len(ground)], strict=True), strict=True
    ):
        failures = [run.failure for run in runs if run.failure]
        numbers[name] = {
            **success(runs),
            "failures": {cause: failures.count(cause) for cause in sorted(set(failures))},
            "success_with_true_heights": success(told[name])["success"],
        }
        _draw_boxes(axis, ground[name])
        for run in runs:
            colour = "tab:green" if run.outcome.success else OTHER
            axis.plot(*run.trace.base.T, color=colour, linewidth=0.8, alpha=0.6)
        good, best = (numbers[name][key] for key in ("success", "success_with_true_heights"))
        title = (
            f"{name}: {good} of {len(runs)}; {best} with true heights in place of predicted ones"
        )
        axis.set_title(title, loc="left", fontsize=10)
        axis.set_ylabel("z [m]")
    axes[-1].set_xlabel("x [m]; way of the trunk, red where the trial failed")
    return Made(numbers=numbers, figure=figure, configuration={"terrains": list(ground)})


def _draw_boxes(axis: Any, terrain: Terrain) -> None:
    """All boxes from the side: also what lies under others."""
    for box in terrain.boxes:
        axis.fill_between(
            (box.low[0], box.high[0]), box.low[2], box.high[2], color="0.72", linewidth=0
        )
    axis.set_xlim(0.5, terrain.finish_x + 0.5)
    axis.set_ylim(
        -0.5, float(np.max(terrain.height_at(np.asarray([terrain.finish_x]), np.zeros(1)))) + 0.8
    )


def _sizes(terrain: Terrain) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in terrain.params.items())
