"""Patches: what a verdict says of a robot is what its profile holds after the patch."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from samples import CURVE, PROFILE, ROBOT

from saltus.depth import D435I
from saltus.effects.delay_line import CommandDelay
from saltus.effects.depth_errors import DepthNoise, EdgeHoles
from saltus.effects.image_pixels import to_images
from saltus.effects.joint_loads import CoulombFriction
from saltus.effects.motors import TorqueSaturation
from saltus.effects.profile import IDEAL, Profile
from saltus.errors import ConfigError
from saltus.real2sim.experiments.menu import EXPERIMENTS
from saltus.real2sim.experiments.next_experiment import next_experiment, separations
from saltus.real2sim.patch import (
    PatchEvidence,
    PatchRange,
    ProfilePatch,
    evidence_of,
    patch_from_toml,
    patchable_effects,
)
from saltus.real2sim.pipeline import without_ruled_out
from saltus.real2sim.problem.joints.torque_curve import as_knee, delivered_torque
from saltus.real2sim.search.findings import (
    FoundEffect,
    ParameterInterval,
    SearchFindings,
    SignalGap,
)
from saltus.robots.robot import JOINTS

TESTED = (SignalGap(signal="q", residuals=100, before=5.0, after=1.0, floor=1.0),)
CALVES = ("FR_calf", "FL_calf", "RR_calf", "RL_calf")
REACH = PatchRange(torque_nm=20.0, duration_s=24.0)


def found(name: str, where: str | tuple[str, ...], **values: float) -> FoundEffect:
    params = {
        key: ParameterInterval(value=v, ci90=(0.9 * v, 1.1 * v), unit="")
        for key, v in values.items()
    }
    return FoundEffect(name=name, where=where, params=params)


def patch(*effects: FoundEffect) -> ProfilePatch:
    return ProfilePatch(
        effects=effects, evidence=(PatchEvidence(log="a", sha256="0" * 64),), range=REACH
    )


ONE_OF_EACH_PART = (
    found("coulomb_friction", CALVES, torque=0.3),
    found("command_delay", "all", delay=0.004),
    found("torque_saturation", ("FR_calf",), knee=14.0, plateau=25.0),
    found("stiction", ("FR_calf",), breakaway=0.3, stribeck_velocity=0.1),
    found("battery_sag", "all", loss_at_end=0.1),
    found("camera_latency", "camera", latency=0.06),
    found("imu_bias", "imu", roll=0.01, pitch=-0.01),
    found("payload_mass", "trunk", mass=1.2),
)


@pytest.mark.parametrize("one", ONE_OF_EACH_PART, ids=lambda effect: effect.name)
def test_of_two_findings_of_one_effect_the_surer_goes_in(one: FoundEffect) -> None:
    def shifted(by: float, width: float) -> FoundEffect:
        params = {
            name: ParameterInterval(
                value=by * p.value,
                ci90=(p.value - width * abs(p.value), p.value + width * abs(p.value)),
                unit="",
            )
            for name, p in one.params.items()
        }
        return dataclasses.replace(one, params=params)

    sure, unsure = shifted(1.0, 0.05), shifted(1.01, 0.1)
    assert patchable_effects((sure, unsure)) == patchable_effects((unsure, sure)) == (sure,)
    elsewhere = dataclasses.replace(unsure, where="FL_hip")
    assert patchable_effects((sure, elsewhere)) == (sure, elsewhere)


def test_a_patch_and_the_profile_that_it_makes_survive_toml() -> None:
    whole = patch(*ONE_OF_EACH_PART)
    assert patch_from_toml(whole.to_toml()) == whole
    profile = whole.applied_to(IDEAL, ROBOT)
    assert Profile.from_toml(profile.to_toml()) == profile
    names = {
        e.name
        for part in (profile.actuator, profile.camera, profile.imu, profile.body)
        for e in part
    }
    assert names == {effect.name for effect in ONE_OF_EACH_PART}


def test_values_stand_at_the_joints_that_were_named_and_nowhere_else() -> None:
    profile = patch(
        found("coulomb_friction", CALVES, torque=0.3),
        found("coulomb_friction", ("FR_hip",), torque=0.1),
    )
    (friction,) = profile.applied_to(IDEAL, ROBOT).actuator
    assert isinstance(friction, CoulombFriction)
    expected = np.tile([0.0, 0.0, 0.3], 4)
    expected[0] = 0.1
    np.testing.assert_array_equal(friction.torque, expected)


def test_a_patch_composes_with_what_the_profile_has() -> None:
    base = Profile(actuator=(CoulombFriction(torque=0.2), CommandDelay(delay=0.002)))
    profile = patch(found("coulomb_friction", ("RL_hip",), torque=0.5)).applied_to(base, ROBOT)
    assert {effect.name for effect in profile.actuator} == {"coulomb_friction", "command_delay"}
    friction = next(e for e in profile.actuator if isinstance(e, CoulombFriction))
    np.testing.assert_array_equal(friction.torque, np.where(np.array(JOINTS) == "RL_hip", 0.5, 0.2))
    assert (
        patch(found("camera_latency", "camera", latency=0.06)).applied_to(PROFILE, ROBOT).actuator
        == PROFILE.actuator
    )


def test_what_is_no_size_reaches_no_patch() -> None:
    def at(name: str, **told: tuple[float, float, float]) -> FoundEffect:
        params = {
            key: ParameterInterval(value=v, ci90=(low, high), unit="")
            for key, (v, low, high) in told.items()
        }
        return FoundEffect(name=name, where="all", params=params)

    good = (
        *ONE_OF_EACH_PART,
        at("torque_speed_limit", corner=(0.0, -0.2, 0.2), no_load=(30.0, 28.0, 32.0)),
        at("stiction", breakaway=(0.3, 0.2, 0.4), stribeck_velocity=(0.05, -0.1, 0.2)),
        at("camera_latency", latency=(0.0, -0.001, 0.001)),
        at("imu_bias", gyro_x=(0.02, 0.01, 0.03), roll=(0.0, -0.01, 0.01)),
    )
    assert patchable_effects(good) == good
    assert not patchable_effects(
        (
            at("torque_saturation", knee=(0.01, 0.005, 0.015), plateau=(20.0, 19.0, 21.0)),
            at("torque_saturation", knee=(9.0, -3.0, 21.0), plateau=(20.0, 19.0, 21.0)),
            at("torque_gain", gain=(1.02, 0.97, 1.07)),
            at("coulomb_friction", torque=(0.1, -0.05, 0.25)),
        )
    )


def test_a_patch_takes_back_what_a_profile_has_and_a_log_does_not_show() -> None:
    nothing = FoundEffect(
        name="coulomb_friction",
        where="all",
        params={"torque": ParameterInterval(value=0.0, ci90=(-0.01, 0.01), unit="Nm")},
    )
    rubbing = Profile(actuator=(CoulombFriction(torque=0.2),))
    taken_back = patchable_effects((nothing,), rubbing)
    assert patch(*taken_back).applied_to(rubbing, ROBOT) == Profile(
        actuator=(CoulombFriction(torque=0.0),)
    )
    assert not patchable_effects((nothing,))


def test_a_curve_is_that_of_its_joints_and_leaves_the_others() -> None:
    """One for calves on a profile that has a knee at hips already:
    both are there afterwards, to the fourth digit.
    """
    before = TorqueSaturation(
        knee=(9.0, np.inf, np.inf) * 4, plateau=(17.0, np.inf, np.inf) * 4
    ).fitted(ROBOT)
    curve = ((10.0, 10.0), (20.0, 18.0), (30.0, 24.0))
    one = FoundEffect(
        name="torque_saturation", where=CALVES, params=found("", "", knee=14.0, plateau=26.0).params
    )
    applied = patch(dataclasses.replace(one, curve=curve)).applied_to(
        Profile(actuator=(before,)), ROBOT
    )
    (after,) = Profile.from_toml(applied.to_toml()).actuator
    assert isinstance(after, TorqueSaturation)
    torque = np.linspace(0.0, 40.0, 81)[:, None] * np.ones(12)
    expected = np.where(
        np.arange(12) % 3 == 2, delivered_torque(curve, torque), before.delivered(torque)
    )
    np.testing.assert_allclose(after.fitted(ROBOT).delivered(torque), expected, atol=1e-3)


def test_an_empty_patch_changes_nothing() -> None:
    assert patch().applied_to(PROFILE, ROBOT) == PROFILE


def test_a_sag_lasts_as_long_as_the_log_that_showed_it() -> None:
    (sag,) = patch(found("battery_sag", "all", loss_at_end=0.1)).applied_to(IDEAL, ROBOT).actuator
    assert getattr(sag, "duration_s") == 24.0  # noqa: B009 - the effect's type is not known here


def test_a_curve_and_its_knee_and_plateau_deliver_alike_where_they_are_defined() -> None:
    curve = TorqueSaturation(curve=CURVE).fitted(ROBOT)
    knee = as_knee(ROBOT, curve).fitted(ROBOT)
    limit = np.asarray(ROBOT.torque_limit)
    np.testing.assert_allclose(knee.delivered(limit), curve.delivered(limit), rtol=1e-9)
    at_knee = np.where(np.isfinite(knee.knee), knee.knee, 1.0)
    np.testing.assert_allclose(knee.delivered(at_knee), curve.delivered(at_knee), rtol=2e-3)


@pytest.mark.parametrize(
    ("effect", "hint"),
    [
        (found("coulomb_frictoin", "all", torque=0.1), "coulomb_friction"),
        (found("coulomb_friction", "all", torqe=0.1), "torque"),
        (found("coulomb_friction", ("FR_claf",), torque=0.1), "FR_calf"),
        (found("command_delay", "all", delay=-3.0), "must lie within"),
    ],
    ids=str,
)
def test_what_this_version_does_not_know_is_refused_with_the_nearest(
    effect: FoundEffect, hint: str
) -> None:
    with pytest.raises(ConfigError, match=hint):
        patch(effect).applied_to(IDEAL, ROBOT)


@pytest.mark.parametrize(
    "text", ["x", "schema = 'saltus-run/1'", "schema = 'saltus-patch/1'\n[[effects]]\nwhere = 1"]
)
def test_what_is_no_patch_is_refused(text: str) -> None:
    with pytest.raises(ConfigError):
        patch_from_toml(text)


def test_evidence_changes_with_every_byte_and_every_name(tmp_path: Path) -> None:
    (tmp_path / "meta.json").write_text("{}")
    (tmp_path / "joints.csv").write_text("t\n0\n")
    first = evidence_of(tmp_path)
    assert evidence_of(tmp_path) == first
    (tmp_path / "joints.csv").write_text("t\n1\n")
    second = evidence_of(tmp_path)
    (tmp_path / "joints.csv").rename(tmp_path / "imu.csv")
    assert len({first.sha256, second.sha256, evidence_of(tmp_path).sha256}) == 3


def test_every_entry_of_the_measured_table_belongs_to_the_menu() -> None:
    table = separations()
    assert set(table) <= set(EXPERIMENTS)
    for entry in table.values():
        assert all(0.0 <= cosine <= 1.0 for row in entry.cosine for cosine in row)
        assert all(size >= 0.0 and sigma >= 0.0 for size, sigma in entry.visible.values())


def test_latency_and_smear_on_one_sine_call_for_the_chirp() -> None:
    rivals = (
        found("camera_latency", "camera", latency=0.05),
        found("temporal_smear", "camera", alpha=0.4),
    )
    proposed = next_experiment(ROBOT, [("camera_latency", "temporal_smear")], rivals)
    assert proposed is not None
    assert proposed.name == "heave_and_pitch"
    assert proposed.expected_separation > 10.0


def test_scale_and_height_on_a_flat_floor_call_for_a_vertical_face() -> None:
    proposed = next_experiment(ROBOT, [("camera_height", "depth_scale")], ())
    assert proposed is not None
    assert EXPERIMENTS[proposed.name].terrain().edges_x.size


def test_no_set_needs_no_experiment() -> None:
    assert next_experiment(ROBOT, (), ()) is None


def test_a_log_that_names_one_of_a_set_resolves_the_set_of_another() -> None:
    unsure = SearchFindings(
        problem="joints", verdict="set", sets=(("command_delay", "actuator_lag"),), gaps=TESTED
    )
    delay = found("command_delay", "all", delay=0.004)
    sure = SearchFindings(problem="joints", verdict="named", effects=(delay,), gaps=TESTED)
    first, second = without_ruled_out((unsure, sure))
    assert first.sets == ()
    assert first.verdict == "named"
    assert (second.sets, second.verdict, second.effects) == (sure.sets, sure.verdict, sure.effects)
    (alone,) = without_ruled_out((unsure,))
    assert (alone.sets, alone.verdict) == (unsure.sets, "set")


@pytest.mark.parametrize("focal_px", [50.0, D435I.fx, 600.0])
def test_what_is_told_in_pixels_is_told_of_the_images_of_the_log(focal_px: float) -> None:
    told = (
        found("edge_holes", "camera", width=3.0),
        found("depth_noise", "camera", subpixel_sigma=0.05),
    )
    whole = ProfilePatch(effects=told, evidence=(), range=PatchRange(focal_px=focal_px))
    profile = whole.applied_to(IDEAL, ROBOT)
    holes = next(e for e in profile.camera if isinstance(e, EdgeHoles))
    noise = next(e for e in profile.camera if isinstance(e, DepthNoise))
    assert holes.width == pytest.approx(3.0 * D435I.fx / focal_px)  # the same angle
    assert noise.subpixel_sigma / noise.focal_px == pytest.approx(0.05 / focal_px)  # the same depth
    back = to_images(profile, focal_px)
    assert [e.width for e in back.camera if isinstance(e, EdgeHoles)] == pytest.approx([3.0])
    assert whole.applied_to(profile, ROBOT) == profile
    assert patch_from_toml(whole.to_toml()) == whole
