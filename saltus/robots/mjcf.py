"""A robot from an MJCF and one short TOML, and what of it was read,
given, derived, guessed or not found.
"""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.constants import GRAVITY
from saltus.robots.legs import LegKinematics
from saltus.robots.plain_mjcf import kept_rod, trunk_box, write_mjcf
from saltus.robots.robot import JOINTS, LINKS, Gains, Robot
from saltus.robots.similarity import CAMERA_PITCH, INERTIA_FACTOR, STAND_SHARE, Similarity
from saltus.robots.structure import RobotStructure, read_structure
from saltus.robots.supplement import RobotSupplement, load_supplement

OriginKind = Literal["model", "toml", "derived", "guessed", "missing"]
STAND_KEYFRAMES = ("stand", "home")
LEVEL_M = 0.03  # the feet of a standing robot are at one height within this [m]
ANGLE_TOLERANCE = 1e-3  # of a keyframe beyond a joint's limit [rad]


@dataclass(frozen=True, kw_only=True)
class FieldOrigin:
    """Where a field of a robot comes from."""

    field: str
    kind: OriginKind
    """model: read there. toml: given there. derived: from both. guessed: nobody says it. missing:
    taken as none."""
    detail: str


@dataclass(frozen=True, kw_only=True)
class RobotDerivation:
    """A robot, and where its fields come from."""

    robot: Robot
    origins: tuple[FieldOrigin, ...]


def derive_robot(mjcf: Path, supplement: Path | None = None) -> RobotDerivation:
    """Derives a robot from its model, and a TOML file with fields
    of `saltus.robots.supplement.RobotSupplement`.

    Raises:
        ModelError: the model cannot be read, or its legs are not of our kind.
        ConfigError: the TOML cannot be read, or one of its values cannot be.
    """
    given = load_supplement(supplement)
    return _Deriver(read_structure(str(mjcf)), given, given.name or mjcf.stem).result()


class _Deriver:
    """One derivation, with the origins that are known so far."""

    def __init__(self, structure: RobotStructure, given: RobotSupplement, name: str) -> None:
        self._model, self._structure, self._given, self._name = (
            structure.model,
            structure,
            given,
            name,
        )
        self._bodies = [body for leg in structure.legs for body in leg.body]
        self._joints = np.array([joint for leg in structure.legs for joint in leg.joint])
        self._signs = np.array([sign for leg in structure.legs for sign in leg.sign])
        self._origins: list[FieldOrigin] = []

    def result(self) -> RobotDerivation:
        """First what is read and given, then what follows from it."""
        geometry = self._geometry()
        robot = Robot(
            name=self._name, **geometry, **self._masses(), **self._drives(),
            **self._control(geometry),
            stand_pose=np.zeros(12), stand_height=1.0, inertia=np.ones(3), mjcf="",
        )  # fmt: skip
        robot = replace(robot, stand_pose=self._stand_pose(robot))
        robot = replace(robot, stand_height=self._stand_height(robot))
        robot = replace(robot, mjcf=self._plain_model(robot))
        robot = replace(robot, inertia=self._inertia(robot))
        return RobotDerivation(robot=robot, origins=tuple(self._origins))

    def _geometry(self) -> dict[str, Any]:
        legs = self._structure.legs
        lengths = legs[0].lengths
        center, size = trunk_box(self._structure)
        fields = {
            "hip_anchor": np.array(
                [leg.offset[0] + leg.offset[1] * (1.0, 0.0, 0.0) for leg in legs]
            ),
            "abduction_offset": np.array([leg.sideways for leg in legs]),
            "thigh_length": lengths["length of the thigh"],
            "calf_length": lengths["length of the calf"],
            "thigh_zero": lengths["angle of the thigh at zero"],
            "shin_zero": lengths["angle of the calf at zero"],
            "foot_radius": lengths["radius of the foot"],
        }
        for name in fields:
            self._note(name, "model")
        fields["trunk_size"] = self._take(
            "trunk_size", size, "model", "box around what is solid of the trunk"
        )
        fields["trunk_center"] = self._take("trunk_center", center, "model", "its middle")
        rods = [
            link
            for k, link in enumerate(LINKS)
            if any(kept_rod(self._model, leg, k) is None for leg in legs)
        ]
        if rods:
            self._note(
                "mjcf", "guessed", f"the rods that stand for {', '.join(rods)}: from their lengths"
            )
        return fields

    def _masses(self) -> dict[str, Any]:
        for name in ("trunk_mass", "link_mass"):
            self._note(name, "model")
        mass = self._model.body_mass
        return {"trunk_mass": float(mass[self._structure.base]), "link_mass": mass[self._bodies]}

    def _drives(self) -> dict[str, Any]:
        lower, upper = self._joint_limits()
        armature = self._model.dof_armature[self._model.jnt_dofadr[self._joints]]
        turned = _named(self._signs < 0.0)
        self._note(
            "joint_sign", "model", f"the model counts {turned} the other way" if turned else ""
        )
        return {
            "joint_sign": self._signs,
            "joint_lower": self._limit("joint_lower", lower),
            "joint_upper": self._limit("joint_upper", upper),
            "torque_limit": self._limit("torque_limit", self._torque_limits()),
            "speed_limit": self._limit("speed_limit", np.full(len(JOINTS), np.inf)),
            "armature": self._take(
                "armature",
                armature,
                "model" if armature.any() else "missing",
                "" if armature.any() else "taken as 0",
            ),
            "reduction": self._take("reduction", np.ones(len(JOINTS)), "missing", "taken as 1"),
        }

    def _control(self, geometry: dict[str, Any]) -> dict[str, Any]:
        hips, sideways = geometry["hip_anchor"], geometry["abduction_offset"]
        mass = float(self._model.body_mass[[self._structure.base, *self._bodies]].sum())
        size = Similarity.of(geometry["thigh_length"] + geometry["calf_length"], mass)
        below = np.array([np.abs(hips[:, 0]).mean(), np.abs(hips[:, 1] + sideways).mean()])
        return {
            "gains": self._gains(size.gains),
            "neutral_foot": self._take(
                "neutral_foot", below, "derived", "below the axes of the thighs"
            ),
            "swing_foot_z": self._guess("swing_foot_z", size.swing_foot_z),
            "landing_reach": self._guess("landing_reach", size.landing_reach),
            "foot_force": self._guess("foot_force", size.foot_force),
            "camera_position": self._guess(
                "camera_position", size.camera_position(float(hips[0, 0]))
            ),
            "camera_pitch": self._guess("camera_pitch", CAMERA_PITCH),
            "camera_roll": self._guess("camera_roll", 0.0),
            "camera_yaw": self._guess("camera_yaw", 0.0),
            "profile": self._take("profile", "ideal", "missing", f"no effects{self._passive()}"),
        }

    def _joint_limits(self) -> tuple[Floats, Floats]:
        model, joints, signs = self._model, self._joints, self._signs
        limited = model.jnt_limited[joints].astype(bool)
        ends = (
            np.where(limited[:, None], model.jnt_range[joints], [-np.inf, np.inf]) * signs[:, None]
        )
        return ends.min(axis=1), ends.max(axis=1)

    def _torque_limits(self) -> Floats:
        """The smallest limit that the joint or one of its motors has [Nm]."""
        model = self._model
        limits = np.full(len(JOINTS), np.inf)
        for i, joint in enumerate(self._joints):
            if model.jnt_actfrclimited[joint]:
                limits[i] = np.abs(model.jnt_actfrcrange[joint]).max()
            for motor in np.flatnonzero(
                (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
                & (model.actuator_trnid[:, 0] == joint)
            ):
                limits[i] = min(limits[i], _motor_limit(model, int(motor)))
        return limits

    def _gains(self, guessed: Gains) -> Gains:
        given = self._given.gains
        rest = [name for name in asdict(guessed) if name not in given]
        if given:
            self._note("gains", "toml", ", ".join(given) if rest else "")
        if rest:
            self._note("gains", "guessed", f"{', '.join(rest)}: scaled to size and mass")
        return replace(guessed, **given)

    def _passive(self) -> str:
        """Returns what the model says of its joints that only a profile can hold."""
        model = self._model
        dofs = model.jnt_dofadr[self._joints]
        found = {"damping": model.dof_damping[dofs], "dry friction": model.dof_frictionloss[dofs]}
        said = [
            f"{name} {values.min():.3g} to {values.max():.3g}"
            for name, values in found.items()
            if values.any()
        ]
        return (
            f"; the model's {' and '.join(said)} of the joints: left to a profile" if said else ""
        )

    def _stand_pose(self, robot: Robot) -> Floats:
        if self._given.stand_pose is not None:
            return self._take("stand_pose", None, "toml")
        refused = ""
        for name in STAND_KEYFRAMES:
            found = [key for key in range(self._model.nkey) if self._model.key(key).name == name]
            if not found:
                continue
            pose = (
                self._signs * self._model.key_qpos[found[0]][self._model.jnt_qposadr[self._joints]]
            )
            wrong = _why_no_stand(robot, pose)
            if not wrong:
                return self._take("stand_pose", pose, "model", f"keyframe '{name}'")
            refused += f"; keyframe '{name}' is none: {wrong}"
        feet = robot.hip_anchor + np.stack(
            [0.0 * robot.side, robot.abduction_offset, 0.0 * robot.side], axis=-1
        )
        feet[:, 2] -= STAND_SHARE * robot.leg_length
        crouch = LegKinematics(robot).inverse(feet)
        how = f"feet below the thighs' axes, {STAND_SHARE:g} of the leg's length{refused}"
        return self._take("stand_pose", crouch, "derived", how)

    def _stand_height(self, robot: Robot) -> float:
        """Soles on the ground, and what the drives give way under the robot's weight."""
        foot, jacobian = LegKinematics(robot).position_and_jacobian(robot.stand_pose)
        weight = robot.mass * GRAVITY / len(foot)
        sag = float((jacobian[:, 2] ** 2).sum(axis=-1).mean()) * weight / robot.gains.stand_kp
        height = robot.foot_radius - float(foot[:, 2].mean()) - sag
        return self._take(
            "stand_height", height, "derived", f"from the pose, less {1000.0 * sag:.1f} mm of sag"
        )

    def _plain_model(self, robot: Robot) -> str:
        return write_mjcf(
            robot.name,
            self._structure,
            stand_height=robot.stand_height,
            trunk_center=robot.trunk_center,
            trunk_size=robot.trunk_size,
            joint_lower=robot.joint_lower,
            joint_upper=robot.joint_upper,
            armature=robot.armature,
        )

    def _inertia(self, robot: Robot) -> Floats:
        model = mujoco.MjModel.from_xml_string(robot.mjcf)
        data, matrix = mujoco.MjData(model), np.zeros((model.nv, model.nv))
        data.qpos[7:] = robot.stand_pose
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, matrix)
        factors = ", ".join(f"{factor:g}" for factor in INERTIA_FACTOR)
        inertia = INERTIA_FACTOR * np.diag(matrix)[3:6]
        return self._take(
            "inertia", inertia, "derived", f"{factors} times that of the standing robot"
        )

    def _limit(self, name: str, found: Floats) -> Floats:
        missing = _named(~np.isfinite(found))
        detail = f"of {missing}: taken as none" if missing else ""
        return self._take(name, found, "missing" if missing else "model", detail)

    def _guess(self, name: str, value: object) -> Any:
        return self._take(name, value, "guessed", "scaled to size and mass")

    def _take(self, name: str, value: object, kind: OriginKind, detail: str = "") -> Any:
        """Returns what the TOML says of a field, else `value`."""
        given = getattr(self._given, name)
        self._note(name, kind if given is None else "toml", detail if given is None else "")
        return value if given is None else given

    def _note(self, name: str, kind: OriginKind, detail: str = "") -> None:
        self._origins.append(FieldOrigin(field=name, kind=kind, detail=detail))


def _motor_limit(model: mujoco.MjModel, motor: int) -> float:
    """Largest torque of a motor at its joint [Nm]; infinite where none is said."""
    gear = abs(float(model.actuator_gear[motor, 0]))
    limit = float("inf")
    if model.actuator_forcelimited[motor]:
        limit = float(np.abs(model.actuator_forcerange[motor]).max()) * gear
    is_torque = model.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_NONE
    if is_torque and model.actuator_ctrllimited[motor]:
        gain = abs(float(model.actuator_gainprm[motor, 0]))
        limit = min(limit, float(np.abs(model.actuator_ctrlrange[motor]).max()) * gain * gear)
    return limit


def _why_no_stand(robot: Robot, pose: Floats) -> str:
    """Empty where a robot can stand in a pose."""
    feet = LegKinematics(robot).position(pose)
    level = float(np.ptp(feet[:, 2]))
    if level > LEVEL_M:
        return f"its feet are {level:.2f} m apart in height"
    beyond = (pose < robot.joint_lower - ANGLE_TOLERANCE) | (
        pose > robot.joint_upper + ANGLE_TOLERANCE
    )
    if beyond.any():
        return f"{_named(beyond)} beyond their limits"
    hips = robot.hip_anchor[:, 2]
    return (
        ""
        if (feet[:, 2] < hips - 0.5 * STAND_SHARE * robot.leg_length).all()
        else "its feet are not below its hips"
    )


def _named(mask: NDArray[np.bool_]) -> str:
    """Joints in words: links where all legs have them, else joint by joint."""
    legs = np.asarray(mask).reshape(-1, len(LINKS))
    if (legs == legs[0]).all():
        return ", ".join(link for link, is_in in zip(LINKS, legs[0], strict=True) if is_in)
    return ", ".join(joint for joint, is_in in zip(JOINTS, mask, strict=True) if is_in)
