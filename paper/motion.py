"""Rows about motion: what each measures, and how it is drawn.

Everything here is measured in simulation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from paper.drawing import FRONT, OTHER, OURS, REAR, draw_ground, draw_stance, legend, subplots
from paper.new_ground import NEW_GROUND
from paper.runs import PAIRS, Effort, Ran, Setting, ran, watched
from saltus.arrays import Floats
from saltus.config import TerrainConfig
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain

STAIRS = TerrainConfig(terrain="stairs", steps=14, rise_m=0.20, run_m=0.25)
"""The paper's staircase: 14 steps, 3.5 m long and 2.8 m high."""
STONES = TerrainConfig(
    terrain="stepping_stones", stone_m=0.5, gap_m=0.1, gap_max_m=0.5, layout_seed=1
)
"""The paper does not say how wide its stones and gaps are."""
COURSES = {
    "stairs": STAIRS,
    "stepping stones": STONES,
    "step": TerrainConfig(terrain="step", height_m=0.60),
    "gap": TerrainConfig(terrain="gap", gap_m=0.80),
}
STEP_HEIGHTS_M = (0.2, 0.3, 0.4, 0.5, 0.6)
GAP_WIDTHS_M = (0.2, 0.4, 0.6, 0.8)
STARTS_X = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""As far as trials put robots ahead of the usual start and behind it."""
LOOK_M = 0.35
"""Before an edge: the robot has not jumped, and its heights reach over the edge."""
GAITS = 4
"""Trials of which one is drawn."""
SHOWN_S = 0.9
"""Body motion that is shown before and after an edge: two bounds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Made:
    """Result of a row."""

    numbers: dict[str, Any]
    figure: Any
    """Figure of matplotlib."""
    configuration: dict[str, Any]
    """Sizes and kinds of what was run."""
    most_seeds: int | None = None
    """Most seeds of those that were asked for, where not all are run."""


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
    table = {name: _summary(runs) for name, runs in zip(COURSES, results, strict=True)}
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
            values = [_values(runs, key) for runs in results]
            axis.boxplot([v or [float("nan")] for v in values], tick_labels=list(table))
        axis.set_title(title, loc="left", fontsize=10)
        axis.tick_params(axis="x", rotation=25)
    return Made(numbers=table, figure=figure, configuration=_courses(COURSES))


def staircase(effort: Effort) -> Made:
    """14 stairs: time, speeds and jumps; one run from the side."""
    return _course("stairs", STAIRS, effort)


def stones(effort: Effort) -> Made:
    """Stepping stones: time, speed and jumps; one run from the side."""
    return _course("stepping stones", STONES, effort)


def _course(name: str, course: TerrainConfig, effort: Effort) -> Made:
    terrain = make_terrain(course)
    (runs,) = ran([Setting(terrain=terrain)], effort)
    numbers = _summary(runs)
    first, last = float(terrain.edges_x[0]), float(terrain.edges_x[-1])
    length = last - first + (course.run_m or 0.0)
    rise = float(terrain.height_at(last + 0.1, 0.0))
    over = [run.time_at(first + length) - run.time_at(first) for run in runs if run.outcome.success]
    numbers |= {
        "length_m": round(length, 3),
        "rise_m": round(rise, 3),
        "time_over_it_s": _spread(over),
        "horizontal_mps": _spread([length / t for t in over]),
        "vertical_mps": _spread([rise / t for t in over]),
    }
    figure, axis = subplots(1, 1, 4.2 if rise else 2.6)
    _side(axis, _shown(runs), first - 0.8, last + 0.9)
    axis.set_title(f"{name}: trunk (line) and where feet came down", loc="left", fontsize=10)
    axis.set_aspect("equal")
    return Made(numbers=numbers, figure=figure, configuration=_courses({name: course}))


def gait(effort: Effort) -> Made:
    """The four modes of the bounding gait as they are planned and as feet bear on the stairs."""
    (runs,) = ran(
        [Setting(terrain=make_terrain(STAIRS))], replace(effort, trials=min(effort.trials, GAITS))
    )
    run = _shown(runs)
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
        "stepping_frequency_hz": _spread(run.frequency_hz[going].tolist()),
    }
    figure, axis = subplots(1, 1, 2.2)
    draw_stance(
        axis, run.trace.time_s, (("front feet", front, bears[0]), ("rear feet", rear, bears[1]))
    )
    axis.set_xlim(1.0, run.trace.time_s[-1])
    axis.set_xlabel("time [s]; grey: to stand, red: bears")
    return Made(
        numbers=numbers, figure=figure, configuration=_courses({"stairs": STAIRS}), most_seeds=GAITS
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
        error = np.concatenate([(run.velocity - run.reference)[_on_ground(run)] for run in runs])
        rms = np.sqrt(np.mean(error**2, axis=0)) if len(error) else np.full(3, np.nan)
        numbers[label] = {
            "rms_ahead_mps": round(float(rms[0]), 3),
            "rms_up_mps": round(float(rms[1]), 3),
            "rms_pitch_rate_rad_s": round(float(rms[2]), 3),
            "success": sum(run.outcome.success for run in runs),
            "steps_before_failure": _spread([run.edges_passed for run in runs]),
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
    return Made(numbers=numbers, figure=figure, configuration=_courses({"stairs": STAIRS}))


def no_feedback_deployment(effort: Effort) -> Made:
    """The shipped policy with the velocity feedback of legs that stand switched off when it is deployed."""
    courses = [make_terrain(course) for course in COURSES.values()]
    settings = [
        Setting(terrain=terrain, feedback=on) for on in (True, False) for terrain in courses
    ]
    results = ran(settings, effort)
    numbers: dict[str, Any] = {}
    for i, label in enumerate(("with feedback", "without")):
        for name, runs in zip(COURSES, results[i * len(COURSES) :], strict=False):
            numbers.setdefault(name, {})[label] = {
                **_success(runs),
                "edges": _spread([r.edges_passed for r in runs]),
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
    return Made(numbers=numbers, figure=figure, configuration=_courses(COURSES))


def generalisation(effort: Effort) -> Made:
    """Ground that no training has: stairs of planks, stairs with noses, several obstacles in a row."""
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
            **_success(runs),
            "failures": {cause: failures.count(cause) for cause in sorted(set(failures))},
            "success_with_true_heights": _success(told[name])["success"],
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
            rows[f"{pair}_last_before_m"] = _spread([min(ways) for ways in before if ways])
            rows[f"{pair}_first_behind_m"] = _spread([min(ways) for ways in behind if ways])
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
        numbers[f"{height:g} m"] = {**_success(runs), "nose_up_deg": _spread(highest)}
    axis.set_xlabel("trunk before (-) and behind the step's edge [m]; dots: in the air")
    axis.set_ylabel("nose up [deg]")
    legend(axis, title="step", fontsize=8)
    return Made(numbers=numbers, figure=figure, configuration={"height_m": STEP_HEIGHTS_M})


def step_and_gap(effort: Effort) -> Made:
    """One run over the step and one over the gap: predicted heights, the camera's image, the robot."""
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
        **_courses({name: COURSES[name] for name in ("step", "gap")}),
        "moment_m_before_the_edge": LOOK_M,
    }
    return Made(numbers=numbers, figure=figure, configuration=configuration, most_seeds=1)


def _summary(runs: Sequence[Ran]) -> dict[str, Any]:
    """Summary of one course."""
    return {
        **_success(runs),
        "speed_mps": _spread(_values(runs, "speed_mps")),
        "time_s": _spread([run.outcome.time_s for run in runs if run.outcome.success]),
        "jumps": _spread(_values(runs, "jumps")),
    }


def _success(runs: Sequence[Ran]) -> dict[str, int]:
    return {"success": sum(run.outcome.success for run in runs), "trials": len(runs)}


def _values(runs: Sequence[Ran], key: str) -> list[float]:
    """Values of successes."""
    good = [run for run in runs if run.outcome.success]
    return [float(run.jumps) if key == "jumps" else run.outcome.mean_speed_mps for run in good]


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    """Least, median and greatest; nothing where there are no values."""
    if not values:
        return None
    low, median, high = np.quantile(np.asarray(values, np.float64), (0.0, 0.5, 1.0)).tolist()
    return {"least": round(low, 3), "median": round(median, 3), "most": round(high, 3)}


def _on_ground(run: Ran) -> Any:
    """A leg that is to stand bears, once the robot bounds."""
    return run.going & (run.trace.stance & run.trace.loaded).any(axis=-1)


def _shown(runs: Sequence[Ran]) -> Ran:
    """The first that succeeded; the first of all where none did."""
    return next((run for run in runs if run.outcome.success), runs[0])


def _side(axis: Any, run: Ran, low: float, high: float) -> None:
    draw_ground(axis, run.terrain, low, high)
    axis.plot(*run.trace.base.T, color="0.3", linewidth=1)
    for pair, colour in (("front", FRONT), ("rear", REAR)):
        places: Floats = np.array(
            [(landing.x, landing.z) for landing in run.landings(pair)]
        ).reshape(-1, 2)
        axis.plot(*places.T, "o", color=colour, markersize=5, label=f"{pair} feet")
    axis.set_xlabel("x [m]")
    axis.set_ylabel("z [m]")
    legend(axis, fontsize=8, loc="lower right")  # on the ground


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


def _courses(courses: dict[str, TerrainConfig]) -> dict[str, Any]:
    return {
        "courses": {name: dict(make_terrain(course).params) for name, course in courses.items()}
    }
