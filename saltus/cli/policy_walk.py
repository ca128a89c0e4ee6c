"""`saltus policy walk trials`: a walking policy as deployed, on true and predicted heights."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from saltus.cli.output import JsonOption, table_lines
from saltus.cli.run_options import RobotOption, mounted_camera
from saltus.config import WALKING_CAMERA, check_between
from saltus.errors import ConfigError
from saltus.flags import flag_help
from saltus.grid import WALKING_GRID
from saltus.robots.loading import load_robot
from saltus.used_networks import model_id, model_path, walking_path
from saltus.workers import check_processes

if TYPE_CHECKING:
    from saltus.policy.evaluation.walking_jumps import JumpAngles
    from saltus.policy.evaluation.walking_trials import WalkTrialKind
    from saltus.policy.evaluation.walks import RobotHeightSourceFactory

    Table = dict[tuple[str, WalkTrialKind, str], dict[str, Any]]

ERRAND_COLUMNS = {
    "way [m]": "way_m", "time [s]": "time_s", "offset [m]": "offset_m", "heading [deg]": "heading_deg",
}  # fmt: skip
BAR = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
CONDITIONS = ("push_ns", "friction", "askew_deg", "heading_deg")
CAMERA_FLAGS = ("pixels_gone", "camera_blank_s", "camera_late_s")
ALL = ("plain", "rubble", "stairs", "irregular", "stones", "ramps", "hurdles")


@dataclass(frozen=True, kw_only=True)
class WalkTrialsCommand(RobotOption, JsonOption):
    """Trials of a walking policy with the deployed planner, controller and heightmaps, without bus.

    A crossing is 10 m of a ground at 0.5 to 1.0 m/s, drawn by the seed. A drill is six drawn commands
    of 4 s, a stop from 1.0 m/s, and a turn by 180 degrees on the spot. A route leads over goals, a
    stop ends a walk at 1.0 m/s within 1 m, a line is a place and heading to stand at within 5 cm and
    3 degrees. The operator sees where the robot is.

    For example:
      saltus policy walk trials --trials 100 --json
      saltus policy walk trials --model walk.onnx --grounds stairs --drills --heights true
      saltus policy walk trials --grounds rubble --drills --push-ns 20
      saltus policy walk trials --grounds --drills --routes landing course arena --stops stairs
      saltus policy walk trials --grounds --drills --jumps trench --askew-deg 30
    """

    model: Annotated[Path | None, flag_help("PATH", "the shipped policy of the robot")] = None
    """The policy: an ONNX file, or a TOML file about somebody else's."""
    grounds: tuple[str, ...] = ALL
    """Grounds to cross; none by --grounds alone."""
    drills: tuple[str, ...] = ("plain", "rubble")
    """Grounds of the drills; none by --drills alone."""
    routes: Annotated[tuple[str, ...], flag_help("STR", "none")] = ()
    """Routes over goals: landing (stairs round a corner), course (eight drawn parts), arena."""
    stops: Annotated[tuple[str, ...], flag_help("STR", "none")] = ()
    """Grounds to stop on."""
    lines: Annotated[tuple[str, ...], flag_help("STR", "none")] = ()
    """Grounds of the drills on which a line is to be reached."""
    jumps: Annotated[tuple[str, ...], flag_help("STR", "none")] = ()
    """Grounds to jump over by the shipped jumping policy: plain, stairs, stones, trench."""
    jump_stops: Annotated[tuple[str, ...], flag_help("STR", "none")] = ()
    """The same grounds to stop on while the robot jumps."""
    askew_deg: float = 0.0
    """Angle by which the grounds of --jumps lie askew."""
    heading_deg: float = 0.0
    """Angle by which a robot of --jumps is told to turn, to the left, as soon as it jumps."""
    push_ns: float = 0.0
    """One push sideways while a robot walks, of 0.1 s, at a drawn place and to a drawn side [Ns]."""
    friction: Annotated[float | None, flag_help("FLOAT", "0.5 to 1.0, drawn")] = None
    """Friction between feet and ground."""
    camera_late_s: Annotated[float | None, flag_help("FLOAT", "0.03 to 0.06, drawn")] = None
    """Time from exposure to arrival of images [s]; for predicted heights."""
    camera_blank_s: float = 0.0
    """The camera shows nothing for so long, once, at a drawn time [s]; for predicted heights."""
    pixels_gone: float = 0.0
    """Share of the pixels of each image that are invalid; for predicted heights."""
    heights: tuple[Literal["true", "predicted"], ...] = ("true", "predicted")
    """true: the terrain as it is. predicted: what the scan's service makes of late depth images."""
    heightmap_model: Annotated[Path | None, flag_help("PATH", "the shipped network")] = None
    """ONNX file of the scan's network."""
    camera: str = WALKING_CAMERA
    """Camera of predicted heights: d435i_whole, d435i, ideal, or a TOML file."""
    profile: str = "shipped"
    """Effects of the hardware: shipped, ideal, one of your own, or a TOML file."""
    trials: int = 20
    """Trials of each ground."""
    seed: int = 0
    """Seed of the first trial; the others have SEED + 1, SEED + 2, ..."""
    processes: Annotated[int | None, flag_help("INT", "one for each core")] = None
    """How many run at once. The results do not depend on it."""

    def run(self) -> int:
        """Runs them; prints a row for each ground and source of heights."""
        from tqdm import tqdm

        from saltus.policy.evaluation.walking_conditions import WalkConditions
        from saltus.policy.evaluation.walking_trials import ROWS, WalkTrials, run_tasks, trial_tasks

        self._check()
        seeds = range(self.seed, self.seed + self.trials)
        conditions = WalkConditions(
            push_ns=self.push_ns, friction=self.friction, camera_late_s=self.camera_late_s
        )
        trials = WalkTrials(
            robot=self.robot, grid=WALKING_GRID, model=self._policy,
            camera=self.camera, profile=self.profile, conditions=conditions,
            angles=self._angles,
        )  # fmt: skip
        named = [
            (source, kind, name, task)
            for source in self.heights
            for kind, grounds in self._asked.items()
            for name in grounds
            for task in trial_tasks(kind, [name], self._height_source(source), seeds)
        ]
        total = self.trials * len(self.heights) * sum(map(len, self._asked.values()))
        with tqdm(total=total, desc="trials", bar_format=BAR, file=sys.stderr) as bar:
            results = run_tasks(trials, [task for *_, task in named], self.processes, bar.update)
        found: dict[tuple[str, WalkTrialKind, str], list[Any]] = {}
        for (source, kind, name, _), part in zip(named, results, strict=True):
            found.setdefault((source, kind, name), []).extend(part)
        table = {key: ROWS[key[1]](value) for key, value in found.items()}
        print(*_lines(table), sep="\n")
        self.tell_json(self._told(table))
        return 0

    def _check(self) -> None:
        """Says at once what is wrong with a model, a ground or a number."""
        from saltus.grid import load_grid
        from saltus.heightmap.scan.predictor import ScanNetwork
        from saltus.policy.evaluation.walking_trials import prepare_trial
        from saltus.policy.joints.policy import JointPolicy

        check_between(self, trials=(1, 100_000), seed=(0, 2**32))
        check_processes(self.processes)
        check_between(self, push_ns=(0.0, 1000.0), camera_blank_s=(0.0, 100.0))
        check_between(self, pixels_gone=(0.0, 1.0))
        check_between(self, askew_deg=(-45.0, 45.0), heading_deg=(-45.0, 45.0))
        if self.friction is not None:
            check_between(self, friction=(0.01, 5.0))
        if self.camera_late_s is not None:
            check_between(self, camera_late_s=(0.0, 0.5))
        if not self.heights or not any(self._asked.values()):
            raise ConfigError("nothing to measure: name a ground or a drill, and true or predicted")
        for flag in CAMERA_FLAGS if "true" in self.heights else ():
            if getattr(self, flag):
                raise ConfigError(
                    f"{flag} = {getattr(self, flag):g} changes no true heights: "
                    "ask for --heights predicted"
                )
        for kind, names in self._asked.items():
            for name in names:
                prepare_trial(kind, name, self.seed, self._angles)
        _, robot = mounted_camera(self.camera, load_robot(self.robot))
        policy = JointPolicy(self._policy)
        policy.refuse_other(robot)
        load_grid(WALKING_GRID).places_of(policy.description.height_grid())
        ScanNetwork(model_path("scan", self.heightmap_model))

    @property
    def _asked(self) -> "dict[WalkTrialKind, tuple[str, ...]]":
        return {
            "cross": self.grounds, "drill": self.drills, "route": self.routes,
            "stop": self.stops, "line": self.lines,
            "jump": self.jumps, "jump_stop": self.jump_stops,
        }  # fmt: skip

    @property
    def _angles(self) -> "JumpAngles":
        from saltus.policy.evaluation.walking_jumps import JumpAngles

        return JumpAngles(askew_deg=self.askew_deg, heading_deg=self.heading_deg)

    @property
    def _policy(self) -> Path:
        return walking_path(self.robot, self.model).resolve()

    def _height_source(self, source: str) -> "RobotHeightSourceFactory":
        from saltus.heightmap.data.arriving_images import ImageDamage
        from saltus.heightmap.data.scan_heights import ScanHeightSourceFactory
        from saltus.policy.evaluation.walks import TrueHeightSource

        if source == "true":
            return TrueHeightSource
        damage = ImageDamage(gone=self.pixels_gone, blank_s=self.camera_blank_s)
        return ScanHeightSourceFactory(
            model=model_path("scan", self.heightmap_model).resolve(), damage=damage
        )

    def _told(self, table: "Table") -> dict[str, Any]:
        paths = {"policy": self._policy, "heightmap": model_path("scan", self.heightmap_model)}
        return {
            "robot": self.robot, "camera": self.camera, "profile": self.profile,
            "trials": self.trials, "seed": self.seed,
            "conditions": {name: getattr(self, name) for name in (*CONDITIONS, *CAMERA_FLAGS)},
            "models": {kind: model_id(path.read_bytes()) for kind, path in paths.items()},
            "rows": [
                {"heights": source, "kind": kind, "ground": name, **row}
                for (source, kind, name), row in table.items()
            ],
        }  # fmt: skip


def _lines(table: "Table") -> list[str]:
    """The crossings and the drills, each as a table for people."""
    crossed = [
        (
            f"{name}, {source}",
            {
                "crossed": f"{row['successes']} of {row['trials']}",
                "way [m]": row["distance_m"], "speed / commanded": row["speed_by_commanded"],
                "failed": ", ".join(f"{n} {cause}" for cause, n in row["failures"].items()),
            },
        )
        for (source, kind, name), row in table.items()
        if kind == "cross"
    ]  # fmt: skip
    drilled = [
        (
            f"{name}, {source}",
            {
                "fell": f"{sum(row['failures'].values())} of {row['trials']}",
                "ahead [m/s]": row["ahead_mps"], "aside [m/s]": row["aside_mps"],
                "turn [rad/s]": row["turn_rps"], "stop [m]": row["stop_m"],
                "within 1 m": row["stopped_within_1_m"], "180 deg [s]": row["turn_s"],
                "within 4 s": row["turned_within_4_s"],
            },
        )
        for (source, kind, name), row in table.items()
        if kind == "drill"
    ]  # fmt: skip
    errands = [
        (
            f"{kind} {name}, {source}",
            {
                "done": f"{row['successes']} of {row['trials']}",
                **{
                    title: row.get(figure)
                    for title, figure in ERRAND_COLUMNS.items()
                },
                "failed": ", ".join(f"{n} {cause}" for cause, n in row["failures"].items()),
            },
        )
        for (source, kind, name), row in table.items()
        if kind not in ("cross", "drill")
    ]  # fmt: skip
    return [line for rows in (crossed, drilled, errands) if rows for line in table_lines(rows)]
