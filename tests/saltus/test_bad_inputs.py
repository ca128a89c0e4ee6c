"""Bad inputs to all commands: one line that names the value and what is allowed,
code 2, nothing written, nothing lost.

The heightmap's datasets and full disks are in tests/heightmap/test_bad_files.py, run logs in
tests/real2sim/test_bad_logs.py, benchmarks in tests/benchmarks/test_bench.py.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest
from samples import put_run

from saltus.cli.main import main
from saltus.config import RunConfig, to_toml
from saltus.resources import resource
from saltus.robots.shipped import SUPPLEMENT_FILE, shipped_folder

POLICY = resource("models/checkpoints/policy.pt")
MODEL = resource("models/heightmap.onnx")
HUGE = "99999999999999999999999"
CAMERAS = {
    "ratehz": "ratehz = 30.0",
    "slow": "rate_hz = 5",
    "height": "camera_height = 0.142",
    "degrees": "camera_pitch = 25.0",
    "half": "[image]\nwidth = 640\nheight = 480",
    "wide": "[image]\nwidth = 640\nheight = 480\nfov_deg = [200, 50]",
    "huge": "[image]\nwidth = 640000\nheight = 480\nfov_deg = [80, 50]",
    "inside": "camera_position = [0.0, 0.0, 0.0]",
    "noise": "[stereo.disparity_nois]\nsigma = 0.1",
    "sigma": "[stereo.disparity_noise]\nsigma = 'much'",
    "high": "camera_position = [0.272, 0.0075, 0.15]",
}
BAD = {
    # the command line itself
    "": "demo",
    "dem": "did you mean 'demo'?",
    "--verson": "did you mean '--version'?",
    "demo --sead 3": "did you mean '--seed'?",
    "demo stairs": "'stairs'",
    "demo --json maybe": "'maybe'",
    "demo --seed": "--seed",
    "up --time-limit-s 3": "flag of saltus demo",
    "policy train --minuts 3": "did you mean '--minutes'?",
    "heightmap": "collect",
    "heightmap evl": "did you mean 'eval'?",
    "render calibrat x --out y --json": "there is no command 'calibrat': did you mean 'calibrate'?",
    "heightmap collect": "gpu",
    "heightmap collect gpuu": "did you mean 'gpu'?",
    "heightmap dataset": "merge",
    "real2sim": "find",
    "real2sim fid logs": "did you mean 'find'?",
    "robot": "show",
    "render": "preview",
    "policy": "train",
    "controller": "--run-dir PATH",
    "controller serv --endpoint x --run-dir run": "'serve'",
    # a run
    "demo --seed -1": "seed = -1",
    "demo --seed three": "(--seed INT)",
    "demo --seed 1e400": "(--seed INT)",
    f"demo --seed {HUGE}": "from 0 to",
    "demo --speed 0 --pace realtime": "speed = 0",
    "demo --speed nan --pace realtime": "speed = nan",
    "demo --speed 2 --pace realtime": "at most 1",
    "demo --speed 0.5": 'pace = "realtime"',
    "demo --time-limit-s 0": "time_limit_s = 0",
    "demo --time-limit-s nan": "time_limit_s = nan",
    "demo --time-limit-s inf": "up to 1e+06",
    "demo --time-limit-s 1e300": "up to 1e+06",
    "demo --terrain stair": "did you mean 'stairs'?",
    "demo --terrain missing.toml": "missing.toml",
    "demo --terrain junk.toml": "junk.toml",
    "demo --terrain empty.toml": "empty.toml",
    "demo --steps 0": "from 1 to 100",
    "demo --steps 99999999999": "from 1 to 100",
    "demo --steps 1.5": "(--steps INT)",
    "demo --rise-m -1": "rise_m = -1",
    "demo --rise-m nan": "from 0 to 0.375",
    "demo --gap-m 0.5": "steps, rise_m, run_m",
    "demo --terrain gap --gap-m inf": "from 0.01 to 1.4",
    "demo --terrain stepping_stones --gap-m 0.5 --gap-max-m 0.1": "gap_max_m = 0.1",
    "demo --terrain stepping_stones --stone-m 1e300": "from 0.1 to 2",
    "demo --layout-seed -1": "layout_seed = -1",
    "demo --difficulty 2": "from 0 to 1",
    "demo --difficulty nan": "difficulty = nan",
    "demo --profile g1": "did you mean 'go1'?",
    "demo --profile junk.toml": "junk.toml",
    "demo --profile folder.toml": "folder.toml",
    "demo --profile missing.toml": "missing.toml",
    "demo --profile /proc/self/mem": "/proc/self/mem",
    "demo --camera d435": "did you mean 'd435i'?",
    "demo --renderer pyrende": "pyrender",
    "heightmap collect cpu --renderer auto": "embree",
    "demo --camera missing.toml": "missing.toml",
    "demo --camera junk.toml": "junk.toml",
    "demo --camera folder.toml": "folder.toml",
    "demo --camera camera_ratehz.toml": "did you mean 'rate_hz'?",
    "demo --camera camera_slow.toml": "from 20.0 to 100.0",
    "demo --camera camera_height.toml": "did you mean 'camera_pitch' or 'camera_position'?",
    "demo --camera camera_degrees.toml": "from -pi to pi radians",
    "demo --camera camera_half.toml": "either fov_deg or fx and fy",
    "demo --camera camera_wide.toml": "between 0 and 180",
    "demo --camera camera_huge.toml": "from 1 to 4096",
    "demo --camera camera_inside.toml": "inside the robot's trunk",
    "demo --camera camera_noise.toml": "did you mean 'disparity_noise'?",
    "demo --camera camera_sigma.toml": "camera_sigma.toml: 'stereo.disparity_noise.sigma'",
    "demo --camera camera_high.toml": "+5.8 cm up",
    "up --camera camera_high.toml": "--heightmap-model",
    "policy eval --heightmap predicted --camera camera_high.toml": "--heightmap-model",
    "heightmap eval --camera camera_high.toml": "--heightmap-model",
    "heightmap collect cpu --loop.camera camera_noise.toml": "did you mean 'disparity_noise'?",
    "router --camera camera_slow.toml": "from 20.0 to 100.0",
    "demo --out file": "--out",
    "demo --out file/below": "file/below",
    "demo --out /proc/nowhere": "/proc/nowhere",
    "demo --robot go3": "no robot 'go3': Saltus ships go1, go2; of another give the path",
    "demo --robot junk.xml": "junk.xml",
    "demo --robot other": "train a policy for this robot, or let rules plan (--planner scripted)",
    f"demo --robot other --planner scripted --heightmap-model {MODEL}": "docs/robots.md",
    "up --robot other": "--planner scripted",
    "heightmap collect cpu --loop.robot go3": "no robot 'go3'",
    "heightmap collect gpu --robot go2": "docs/robots.md says what takes another",
    f"heightmap eval --robot go2 --heightmap-model {MODEL}": "heightmap collect cpu --loop.learned 0",
    f"demo --robot moved --planner scripted --heightmap-model {MODEL}": "+2.8 cm ahead",
    "demo --policy-model junk.onnx": "junk.onnx",
    "demo --planner scripted --policy-model junk.onnx": "--planner learned",
    "up --heightmap-model missing.onnx": "missing.onnx",
    "up --seed x": "(--seed INT)",
    "up --pace lockstep --speed 0.5": 'pace = "realtime"',
    "up --speed -1": "speed = -1",
    "up --pace lockstep --standbys": "--pace realtime",
    "up --terrain moon": "stairs",
    "up --profile nosuch": "go1",
    "up --out file": "'file'",
    "router --listen 203.0.113.1:7447 --keys missing": "missing holds no authority",
    "up --listen nonsense": "'nonsense' is no address",
    "keys init --address example.com:7447": "public authority",
    "keys init --address 192.168.0.1": "'192.168.0.1' is no address",
    "keys issue viewr": "'viewer'",
    "keys revoke viewer-1 --keys missing": "missing holds no authority",
    "router --robot go3": "Saltus ships go1, go2",
    "router --prefix #": "#",
    "record": "repair",
    "record run": "--run-dir PATH",
    "record repair": "PATH",
    "record repair missing.mcap": "missing.mcap",
    "record repair folder": "folder",
    "record repair junk.mcap": "junk.mcap",
    "record run --endpoint tcp/127.0.0.1:1 --run-dir missing": "missing/run.toml",
    "record run --endpoint tcp/127.0.0.1:1 --run-dir file": "file/run.toml",
    "record run --endpoint tcp/127.0.0.1:1 --run-dir junk": "junk/run.toml",
    "record run --endpoint tcp/127.0.0.1:1 --run-dir mistyped": "did you mean 'seed'?",
    "record run --endpoint tcp/127.0.0.1:1 --run-dir half": "half/setup.toml",
    "record run --endpoint nonsense --run-dir run": "nonsense",
    "record run --run-dir run": "run/client.json5",
    "policy serve --run-dir run": "run/client.json5",
    "heightmap serve --run-dir run": "run/client.json5",
    "router --robot nobody": "no robot 'nobody'",
    "router --out file": "--out",
    "controller serve --endpoint x --run-dir missing": "missing/run.toml",
    "policy serve --endpoint x --run-dir junk": "junk/run.toml",
    "render serve --endpoint x --run-dir mistyped": "did you mean 'seed'?",
    "ros2 --run-dir missing": "missing/run.toml",
    "ros2 --run-dir run": "run/client.json5",
    "ros2 --run-dir run --namespace 7up": "namespace = 7up: names of ROS begin with a letter",
    "ros2 --run-dir run --domain 300": "domain = 300: it must be from 0 to 232",
    "ros2 --run-dir run --take --joint-names a b": "2 names of joints",
    # recordings
    "watch missing.mcap": "missing.mcap",
    "watch folder.mcap": "folder.mcap",
    "watch empty.mcap": "empty.mcap",
    "watch junk.mcap": "junk.mcap",
    "watch file": "file is not a recording",
    "watch --port 65536": "port = 65536: it must be from 0",
    "watch --port -1": "port = -1: it must be from 0",
    "watch --robots robot/0 robot/1": "--robots names robots of one folder, and 0 are given",
    "watch folder run --robots robot/0": "and 2 are given",
    "watch --robot robot/0": "did you mean '--robots'?",
    "replay": "PATH",
    "replay missing.mcap": "missing.mcap",
    "replay folder.mcap": "folder.mcap",
    "replay empty.mcap": "empty.mcap",
    "replay junk.mcap": "junk.mcap",
    "replay file": "file is not a recording",
    "replay missing.bag --assume-level": "no such file",
    "replay folder.bag": "folder.bag",
    "replay empty.bag --assume-level": "empty.bag",
    "replay junk.bag": "junk.bag",
    "replay junk.mcap --base-height-m nan": "from 0.05 to 2",
    "replay junk.mcap --base-height-m -1": "base_height_m = -1",
    "replay junk.mcap --camera-pitch-deg 1e9": "from -90.0 to 90.0",
    "render fit missing.bag": "missing.bag",
    "render fit junk.bag": "junk.bag",
    "render fit empty.mcap": "empty.mcap",
    "render fit folder": "neither",
    "render fit file": "neither",
    "render preview --out file": "'file'",
    "render preview --out /proc/nowhere": "/proc/nowhere",
    "render preview --camera missing.toml": "missing.toml",
    "render preview --terrain stairs --rise-m nan": "rise_m = nan",
    "render preview --terrain step --height-m inf": "height_m = inf",
    "heightmap report": "at least one",
    "heightmap report missing.mcap": "missing.mcap",
    "heightmap report empty.mcap": "empty.mcap",
    "heightmap report folder": "folder",
    "heightmap serve": "--run-dir",
    "heightmap serve --recording folder --assume-level": "folder",
    "heightmap serve --endpoint x --run-dir missing": "no missing/run.toml, "
    "so 'missing' is no folder of a run",
    # robots and installation
    "robot show": "a shipped robot",
    "robot show go3": "Saltus ships go1, go2",
    "robot show missing.xml": "there is no file 'missing.xml'",
    "robot show junk.xml": "junk.xml",
    "robot show empty.xml": "empty.xml",
    "robot show folder": "there is no folder/robot.toml: put the robot's MJCF there",
    "robot show modelled": "name its model, modelled/one.xml, "
    "or write robot.toml with the line mjcf",
    "robot show two.xml": "'a', 'b' have a free joint each: give a model of the robot alone",
    "robot show held.xml": "add <freejoint/> to it",
    "robot show junk.toml": "junk.toml",
    "robot show go1 missing.toml": "missing.toml",
    "robot show go1 folder": "folder",
    "robot show /proc/self/mem": "/proc/self/mem",
    # models and trainings
    "policy eval --trials 0": "from 1 to 100000",
    "policy eval --trials 99999999999": "from 1 to 100000",
    "policy eval --trials nan": "(--trials INT)",
    f"policy eval --seed {HUGE}": "from 0 to",
    "policy eval --plan-delay-s inf": "from 0 to 0.1",
    "policy eval --friction 0": "friction = 0.0: it must be from 0.01 to 5.0",
    "policy eval --push-ns nan": "push_ns = nan: it must be from 0.0 to 100.0",
    "policy eval --terrain ditch --depth-max-m 0.1": "depth_max_m = 0.1: "
    "it must be at least depth_m = 0.4",
    "policy eval --terrain irregular --run-m 0.3": "run_m = 0.3 has no meaning",
    "policy eval --terrain ramp_up --slope-deg 60": "slope_deg = 60.0 is out of range",
    "policy eval --processes 0": "from 1 to 4096",
    "policy eval --processes 99999999": "from 1 to 4096",
    "policy eval --planner learnt": "'learned'",
    "policy eval --planner scripted --policy-model junk.onnx": "--planner learned",
    "policy eval --policy-model missing.onnx": "missing.onnx",
    "policy eval --policy-model junk.onnx": "junk.onnx",
    "policy eval --policy-model empty.onnx": "empty.onnx",
    "policy eval --policy-model folder": "folder",
    "policy eval --terrain stairs --gap-max-m 0.3": "gap_max_m",
    "policy eval --terrain stepping_stones --gap-max-m 2.0": "gap_max_m",
    "policy eval --heightmap none": "true-exact",
    "policy eval --out file": "'file'",
    "policy export --checkpoint missing.pt": "missing.pt",
    "policy export --checkpoint junk.pt": "no checkpoint",
    "policy export --checkpoint folder.pt": "folder.pt",
    f"policy export --checkpoint {POLICY} --out /proc/nowhere": "/proc/nowhere",
    f"policy export --checkpoint {POLICY} --out policy.onnx": "name a folder",
    "policy train --minutes -1": "minutes = -1",
    "policy train --minutes nan": "minutes = nan",
    "policy train --minutes inf": "have an end",
    "policy train --robots 0": "robots = 0",
    "policy train --robots 99999999999": "from 1 to",
    "policy train --robots many": "(--robots INT)",
    "policy train --seed -1": "seed = -1",
    "policy train --iterations 0": "iterations = 0",
    "policy train --evaluate-minutes nan": "evaluate_minutes = nan",
    "policy train --resume missing.pt": "missing.pt",
    "policy train --resume junk.pt": "no checkpoint",
    "policy train --resume folder": "folder",
    "policy train --config missing.toml": "missing.toml",
    "policy train --config junk.toml": "not valid TOML",
    "policy train --config unknown.toml": "did you mean 'desired_kl'?",
    "policy train --out file": "cannot write into the folder",
    "policy train --profile nobody": "nobody",
    "policy train --device gpu": "cpu",
    "policy train --learning.gamma nan": "gamma = nan",
    "policy train --learning.desired-kl -0.1": "desired_kl = -0.1",
    "policy train --device cpu --learning.minibatches 100000": "minibatches",
    "policy train --device cpu --env.curriculum.flat 0": "shares",
    "policy train --device cpu --env.curriculum.own course.toml 0.3": "course.toml is one course, "
    "without difficulties",
    "policy train --env.randomisation.friction 1.0 0.5": "friction",
    "policy train --env.bounds.low 0 1": "entries",
    "heightmap check": "needs a recording, or --run-dir",
    "heightmap check missing.mcap": "missing.mcap",
    "heightmap check junk.toml": "junk.toml",
    "heightmap check --run-dir folder": "folder",
    "heightmap check --run-dir run --seconds nan": "seconds = nan",
    "router --out made --heightmap-model missing.onnx": "missing.onnx",
    "heightmap give missing.onnx --run-dir run": "missing.onnx",
    "heightmap give junk.onnx --run-dir run": "junk.onnx.sha256",
    "heightmap give junk.onnx --run-dir folder": "setup.toml",
    "heightmap collect cpu --config junk.toml": "junk.toml",
    "heightmap collect cpu --out file": "file",
    "heightmap collect cpu --predictor a.pt": "--predictor",
    "heightmap dagger --loop.robots 0": "robots = 0",
    "heightmap dataset info missing": "missing",
    "heightmap dataset info folder": "manifest.json",
    "heightmap dataset merge --out folder": "nothing to merge",
    "heightmap dataset merge folder": "--out PATH",
    "heightmap train --data folder": "manifest.json",
    "heightmap train --model.channels 1 2": "--model.channels",
    "heightmap train --model.channels 1 2 x": "(--model.channels INT INT INT)",
    "heightmap export --checkpoint junk.pt": "junk.pt",
    "heightmap export --out model.onnx": "name a folder",
    "heightmap eval --time-limit-s 0.1": "time_limit_s = 0.1",
    "heightmap eval --baselines geometrik": "did you mean 'geometric'?",
    "bench depth_to_heights": "score",
    "bench depth_to_heights make --runs 0": "runs = 0: it must be from 1 to 104",
    "bench depth_to_heights make --runs 105": "runs = 105",
    "bench depth_to_heights make --out file": "file: there is a file",
    "bench depth_to_heights make --out file/below": "file",
    "bench depth_to_heights make --processes 0": "from 1 to 4096",
    "bench depth_to_heights score": "saltus bench depth_to_heights make",
    "bench depth_to_heights score --split folder": "folder holds no split",
    "bench depth_to_heights score --baselines geometrik": "did you mean 'geometric'?",
    "bench depth_to_heights score --heightmap-model missing.onnx": "missing.onnx",
    "bench depth_to_heights score --heightmap-model junk.onnx": "junk.onnx",
    # the paper
    "paper stairs": "there is no row 'stairs'",
    "paper staircas": "did you mean 'staircase'?",
    "paper no-sysid --trained none": "no results in none/full-system: "
    "make them with saltus paper train full-system",
    "paper no-feedback --trained none": "make them with saltus paper train full-system",
    "paper train": "there is no ablation ''",
    "paper train no-feedbak": "there is no ablation 'no-feedbak'",
    "paper train imitation": "training 'imitation' needs a GPU",
    "paper staircase stairs": "'stairs' is not understood",
    "paper walking": "a number that is cited only",
    "paper staircase --trials 0": "trials = 0: it must be from 1 to",
    "paper staircase --seed -1": "seed = -1",
    "paper staircase --processes 0": "from 1 to 4096",
    "paper staircase --out file": "'file'",
    # run logs and patches
    "real2sim find": "at least one",
    "real2sim find missing": "missing",
    "real2sim find file": "a folder with meta.json",
    "real2sim find folder": "meta.json",
    "real2sim find folder --profile g1": "did you mean 'go1'?",
    "real2sim find folder --seed -1": "seed = -1",
    "real2sim import": "Missing from saltus real2sim import: PATH",
    "real2sim import missing": "missing",
    "real2sim import folder": "metadata",
    "real2sim import file": "file: name its columns in the [columns] of a file, with --description",
    "real2sim import junk.mcap": "junk.mcap",
    "real2sim import empty.mcap": "empty.mcap",
    "real2sim import junk.bag": "junk.bag",
    "real2sim import empty.bag": "empty.bag",
    "real2sim import folder.bag": "folder.bag",
    "real2sim import table.csv": "--description",
    "real2sim import table.csv --description missing.toml": "missing.toml",
    "real2sim import table.csv --description junk.toml": "not valid TOML",
    "real2sim import table.csv --description unknown.toml": "unknown key 'learning'",
    "real2sim import table.csv --description columns.toml": "'spam'",
    "real2sim import table.csv --description torque.toml": "unknown key 'columns.torque': "
    "choose one of: angle, dq",
    "real2sim import table.csv --description columns.toml --robot go3": "Saltus ships go1, go2",
    "real2sim import junk.bag --topics.joint /a": "did you mean '--topics.joints'?",
    "real2sim apply missing.toml --profile mine": "missing.toml",
    "real2sim apply junk.toml --profile mine": "junk.toml",
    "real2sim apply empty.toml --profile mine": "saltus-patch/1",
    "real2sim apply folder.toml --profile mine": "folder.toml",
    "real2sim apply empty.toml": "--profile NAME",
    "real2sim experiments --run joint_chrip": "did you mean 'joint_chirp'?",
    "real2sim experiments --run drop --camera-latency -1": "--camera-latency",
    "real2sim experiments --run drop --camera-latency nan": "0 to 1 s",
    "real2sim experiments --run drop --out /dev/null/log": "/dev/null/log",
    "real2sim demo --seed -1": "seed = -1",
    "real2sim demo --out file": "'file'",
    "real2sim cycle": "--hidden, or run logs with --logs",
    "real2sim cycle --hidden missing.toml": "missing.toml",
    "real2sim cycle --hidden junk.toml": "junk.toml",
    "real2sim cycle --hidden empty.toml --profile g1": "did you mean 'go1'?",
    "real2sim cycle --hidden empty.toml --out file": "'file'",
    "real2sim cycle --hidden empty.toml --config unknown.toml": "unknown key 'learning'",
    "real2sim cycle --logs missing": "missing",
    "real2sim cycle --hidden empty.toml --experiments joint_chrip": "did you mean 'joint_chirp'?",
    "real2sim cycle --hidden empty.toml --trials 0": "trials = 0",
    "real2sim cycle --hidden empty.toml --policy-minutes nan": "policy_minutes = nan",
    "real2sim cycle --hidden empty.toml --loop.camera d436": "did you mean 'd435i'?",
    "real2sim cycle --hidden empty.toml --export-training folder": "--export-training folder",
    "real2sim cycle --hidden empty.toml --take-training folder": "profile.toml is missing",
    "real2sim cycle --hidden empty.toml --take-training a --export-training b": "not together",
    "bench nosuch": "qp",
}

HEIGHTMAP: dict[str, dict[str, list[str]]] = {
    "train": {
        "--updates": ["0", "-1", "nan", "99999999999999"],
        "--batch": ["-5", "100000000000"],
        "--window": ["0", "100000000000"],
        "--learning-rate": ["nan", "inf", "-1"],
        "--gradient-norm": ["0", "nan"],
        "--forgets": ["-0.1", "1.5", "nan"],
        "--seed": ["-1", "1e400"],
        "--save-every-s": ["-1", "nan"],
        "--model.hidden": ["0", "99999999999"],
        "--model.head": ["-1"],
        "--delivery": ["late"],
    },
    "dagger": {
        "--rounds": ["0"],
        "--batches": ["-1"],
        "--batch": ["99999999999"],
        "--loop.courses": ["0", "33"],
        "--loop.variation": ["nan"],
        "--processes": ["0"],
    },
    "collect cpu": {
        "--batches": ["0", "nan"],
        "--seed": ["-1"],
        "--profile": ["nosuch"],
        "--processes": ["-1"],
    },
    "collect gpu": {
        "--episodes": ["-1"],
        "--loop.robots": ["0", "99999999999"],
        "--loop.ticks": ["59", "nan"],
        "--loop.hardest": ["1.3", "nan"],
        "--loop.cameras": ["d435"],
        "--device": ["tpu"],
    },
    "eval": {
        "--runs": ["0", "-1", "99999999"],
        "--seed": ["-1", "99999999"],
        "--time-limit-s": ["nan", "inf", "-3", "0"],
        "--processes": ["0"],
        "--camera": ["d436"],
    },
}
"""Values that flags of the heightmap's commands refuse; each is named."""
BAD |= {
    f"heightmap {name} {flag} {value}": value
    for name, flags in HEIGHTMAP.items()
    for flag in flags
    for value in flags[flag]
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all that is named above; what is named missing is."""
    root = tmp_path_factory.mktemp("place")
    junk = np.random.default_rng(0).bytes(3000)
    for suffix in ("mcap", "bag", "onnx", "pt", "toml", "xml"):
        (root / f"empty.{suffix}").touch()
        (root / f"junk.{suffix}").write_bytes(junk)
        (root / f"folder.{suffix}").mkdir()
    (root / "file").write_text("kept")
    (root / "unknown.toml").write_text("[learning]\ndesired_klm = 1.0\n")
    (root / "table.csv").write_text("t,angle\n0.0,0.1\n0.1,spam\n")
    (root / "torque.toml").write_text('[columns]\nq = "angle"\ntorque = "load"\n')
    (root / "columns.toml").write_text('[columns]\ntime = "t"\nq = "angle"\njoints = ["FR_hip"]\n')
    contents = {
        "junk": junk,
        "mistyped": b"sed = 3",
        "half": b"",
        "run": to_toml(RunConfig(robot="go1", grid="line")).encode(),
    }
    for name, content in contents.items():
        (root / name).mkdir()
        (root / name / "run.toml").write_bytes(content)
    put_run(root / "run", RunConfig(robot="go1", grid="line"))
    for name, content in CAMERAS.items():
        (root / f"camera_{name}.toml").write_text(content)
    (root / "folder").mkdir()
    (root / "modelled").mkdir()
    body, free = '<body name="{}"><geom size="0.1"/>{}</body>', "<freejoint/>"
    for name, bodies in {
        "modelled/one": body.format("a", free), "held": body.format("a", ""),
        "two": body.format("a", free) + body.format("b", free),
    }.items():  # fmt: skip
        (root / f"{name}.xml").write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    for robot, ours, theirs in (
        ("other", 'name = "go1"', 'name = "other"'),
        ("moved", "[0.272,", "[0.3,"),
    ):
        supplement = Path(shutil.copytree(shipped_folder("go1"), root / robot)) / SUPPLEMENT_FILE
        supplement.write_text(supplement.read_text().replace(ours, theirs))
    return root


def files(place: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in place.rglob("*")}


@pytest.mark.sample(65)
@pytest.mark.parametrize("words", BAD, ids=str)
def test_bad_input(
    words: str, place: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    monkeypatch.delenv("SALTUS_PROFILES", raising=False)
    before = files(place)
    assert main(words.split()) == 2
    said = capfd.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert said.err.startswith("saltus: ")
    assert BAD[words] in said.err
    assert files(place) == before
