"""A Go2 by another MJCF: what is taken from it, and that our policies take it."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.users_go2 import Benchmark, write_robot
from saltus.effects.profile import load_profile
from saltus.errors import ConfigError
from saltus.grid import LINE
from saltus.policy.planner import make_planner
from saltus.robots.loading import load_robot
from saltus.robots.robot import JOINTS
from saltus.robots.shipped import PROFILE_FILE, shipped_folder


@pytest.mark.parametrize("seed", range(4))
def test_masses_joints_and_feet_are_the_models_and_the_shipped_policy_takes_it(
    seed: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    damping, friction, added = rng.uniform(0.01, 2.0, (3, len(JOINTS)))
    torsion, rolling = rng.uniform(0.001, 0.02, 2)
    softness, mass = float(rng.uniform(0.005, 0.05)), float(rng.uniform(5.0, 8.0))
    touch, depth = float(rng.uniform(0.01, 0.9)), float(rng.uniform(0.001, 0.04))
    turns = seed % 2
    spec = mujoco.MjSpec.from_file(str(shipped_folder("go2") / "go2.xml"))
    for i, name in enumerate(JOINTS):
        joint = spec.joint(name)
        joint.damping[0], joint.frictionloss = damping[i], friction[i]
        joint.armature = 0.01 * added[i]
    for leg in ("FR", "FL", "RR", "RL"):
        foot = spec.geom(f"{leg}_foot")
        foot.pos = foot.pos - (0.002, 0.0, 0.0)  # as of published models
        foot.friction, foot.condim = (0.7, torsion, rolling), 6 if turns else 3
        foot.solref[0], foot.solimp[0], foot.solimp[2] = softness, touch, depth
    spec.body("trunk").mass = mass
    model = tmp_path / "theirs.xml"
    model.write_text(spec.to_xml(), encoding="utf-8")

    write_robot(model, tmp_path)
    robot = load_robot(str(tmp_path))
    assert robot.trunk_mass == pytest.approx(mass)
    np.testing.assert_allclose(robot.armature, 0.01 * added, rtol=1e-5)
    np.testing.assert_array_equal(robot.trunk_size, load_robot("go2").trunk_size)
    profile = load_profile(str(tmp_path / PROFILE_FILE), robot)
    of = {effect.name: effect for effect in (*profile.actuator, *profile.body)}
    assert of["viscous_friction"].coefficient == pytest.approx(tuple(damping), rel=1e-5)
    assert of["coulomb_friction"].torque == pytest.approx(tuple(friction), rel=1e-5)
    assert of["contact_compliance"].time_constant == pytest.approx(softness, rel=1e-5)
    feet = of["soft_feet"]
    wanted = (torsion * turns, rolling * turns, touch, depth)
    assert (feet.torsion, feet.rolling, feet.touch, feet.depth) == pytest.approx(wanted, rel=1e-5)
    make_planner("learned", robot, LINE)


def test_a_model_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"there is no model '.*none\.xml'"):
        Benchmark(mjcf=tmp_path / "none.xml").measure()
