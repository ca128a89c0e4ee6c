"""Runs of the whole robot on its feet: what hides in trunk, ground and IMU."""

from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.hidden_effects import stances
from benchmarks.hidden_effects.mjcf import model_text
from benchmarks.hidden_effects.motions import Segment
from benchmarks.hidden_effects.noise import coloured
from benchmarks.hidden_effects.pushes import Pushes
from benchmarks.hidden_effects.robot import STAND, Floats
from benchmarks.hidden_effects.scene import Family, Scene, Setting, draw_sign

STEP_S = 0.0005
CONTROL_DT = 0.002
SETTLE_S = 1.0
FEET_EVERY = 5
"""Rows of the control loop per reading of the feet: 100 Hz."""
GROUND = {"friction": 0.8, "contact_time_constant": 0.008}
"""The claimed ground: rubber on a floor.

A contact that gives way by well below a millimetre [1, s].
"""
PAYLOAD_POSITION = (0.0, 0.0, 0.08)
"""Where a payload sits: on top of the trunk, above its origin [m]."""
SIGNALS = {
    "rpy": 2e-3, "z": 1e-3, "velocity": 0.02, "q": 1e-3, "dq": 0.05, "tau_est": 0.2,
    "imu_rpy": 3e-3, "gyro": 0.01, "acc": 0.15,
}  # fmt: skip
"""Sigma of the noise of each signal [rad, m, m/s, rad, rad/s, Nm, rad, rad/s, m/s^2]."""
SHOWN = ("rpy", "z", "velocity", "q", "dq", "imu_rpy", "gyro")
"""Signals that count in a response; accelerations at touch-down are spikes."""


def _direction(rng: np.random.Generator) -> dict[str, float]:
    along = rng.normal(size=3) * np.array([1.0, 0.7, 0.5])
    along /= np.linalg.norm(along)
    return dict(zip("xyz", along.tolist(), strict=True))


def _bias(rng: np.random.Generator) -> dict[str, float]:
    return dict(
        zip(
            ("gyro_x", "gyro_y", "gyro_z", "roll", "pitch"),
            rng.uniform(-1, 1, 5).tolist(),
            strict=True,
        )
    )


BODY = {
    "payload_mass": Family(usual=0.1, largest=4.0),
    "com_offset": Family(usual=0.003, largest=0.08, shape=_direction),
    "base_inertia": Family(usual=0.1, largest=1.5),
    "foot_friction": Family(usual=0.01, largest=0.5),
    "contact_compliance": Family(usual=0.01, largest=0.06),
    # never hidden here, but what a payload can be taken for
    "torque_gain": Family(usual=0.02, largest=0.5, shape=draw_sign),
}
IMU = {
    "imu_bias": Family(usual=0.02, largest=0.3, shape=_bias),
    "imu_latency": Family(usual=0.005, largest=0.05),
}
OUTSIDE = {
    "side_wind": Family(
        usual=2.0, largest=25.0, shape=lambda rng: {"rate": float(rng.uniform(0.2, 0.7))}
    ),
    "hidden_bump": Family(
        usual=0.002, largest=0.02, shape=lambda rng: {"leg": float(rng.integers(4))}
    ),
    "gyro_scale": Family(usual=0.02, largest=0.5, shape=draw_sign),
    "acc_hum": Family(
        usual=0.2, largest=4.0, shape=lambda rng: {"rate": float(rng.uniform(10, 60))}
    ),
    "loose_load": Family(
        usual=0.1, largest=2.0, shape=lambda rng: {"rate": float(rng.uniform(1.0, 2.5))}
    ),
    "nudges": Family(
        usual=2.0, largest=30.0, shape=lambda rng: {"seed": float(rng.integers(1000))}
    ),
    "gyro_cross": Family(usual=0.02, largest=0.4, shape=draw_sign),
    "attitude_wander": Family(
        usual=4e-3, largest=0.1, shape=lambda rng: {"rate": float(rng.uniform(0.1, 0.4))}
    ),
}
SHAKES = ("side_wind", "hidden_bump", "loose_load", "nudges")
"""Those of them that change how the robot moves."""
FAMILIES = {**BODY, **IMU, **OUTSIDE}


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Motion as it happened, without noise; one row per control step."""

    base: Floats
    """Position and quaternion of the trunk, (rows, 7)."""
    base_velocity: Floats
    """In the world, (rows, 3)."""
    gyro: Floats
    acc: Floats
    joints: Floats
    """Position, velocity, torque; (rows, 12, 3)."""
    load: Floats
    """Normal force of each foot [N], (readings, 4)."""
    slope: float
    """Largest ratio of tangential to normal force of a loaded foot."""


class BodyScene(Scene):
    """A robot that moves its body with its feet on the ground.

    Args:
        imu: The library is that of the IMU.
    """

    families = FAMILIES
    sizing_rounds = 1

    def __init__(self, seed: int, *, tuning: bool, imu: bool) -> None:
        rng = np.random.default_rng(seed)
        self.tuning, self.seed = tuning, seed
        self.library = tuple(IMU) if imu else tuple(BODY)
        self.outside = tuple(OUTSIDE)
        self.kp, self.kd = (
            float(rng.uniform(80, 120).__round__(1)),
            float(rng.uniform(2, 4).__round__(2)),
        )
        self.position, self.velocity, self.segments = stances.commands(
            rng, control_dt=CONTROL_DT, tuning=tuning
        )
        self.corner_hz = float(rng.uniform(20, 150))
        self.level = np.exp(rng.uniform(-0.3, 0.3))
        self.known_payload_kg = self.release_m = 0.0
        self._model = mujoco.MjModel.from_xml_string(
            model_text(
                free=True,
                timestep=STEP_S,
                friction=GROUND["friction"],
                contact_time=GROUND["contact_time_constant"],
            )
        )
        self._ideal = self._simulate({})
        self._slope = self._ideal.slope
        self._known: dict[str, Floats] = {}
        self._index()

    def perform(
        self,
        position: Floats,
        segments: tuple[Segment, ...],
        *,
        known_payload_kg: float,
        release_m: float,
    ) -> None:
        """Has the same robot do something else,
        with a payload that is claimed, or let fall onto its feet.
        """
        self.position, self.velocity = position, np.gradient(position, CONTROL_DT, axis=0)
        self.segments = segments
        self.known_payload_kg, self.release_m = known_payload_kg, release_m
        self._known.clear()
        self._ideal = self._simulate({})
        self._index()

    def respond(self, variants: list[tuple[Setting, ...]]) -> Floats:
        """Where the robot has wandered to does not count: small slips add up."""
        for settings in variants:
            if repr(settings) not in self._known:
                read = self.read(settings)
                scaled = [read[name][::4] / (SIGNALS[name] * self.level) for name in SHOWN]
                self._known[repr(settings)] = np.concatenate([signal.ravel() for signal in scaled])
        return np.stack([self._known[repr(settings)] for settings in variants])

    def parameters(self, setting: Setting) -> dict[str, float | list[list[float]]]:
        size = setting.size
        if setting.effect in ("com_offset", "imu_bias"):
            return {name: part * size for name, part in setting.shape.items()}
        table: dict[str, dict[str, float]] = {
            "payload_mass": {"mass": size},
            "base_inertia": {"scale": 1 + size},
            "foot_friction": {"coefficient": self._friction(size)},
            "contact_compliance": {"time_constant": GROUND["contact_time_constant"] + size},
            "imu_latency": {"delay": size},
        }
        return dict(table.get(setting.effect, {"size": size, **setting.shape}))

    def read(self, settings: tuple[Setting, ...]) -> dict[str, Floats]:
        """Returns what every sensor would read without noise, one row per control step."""
        by = {setting.effect: setting for setting in settings}
        physical = {name: setting for name, setting in by.items() if name in BODY or name in SHAKES}
        motion = self._simulate(physical) if physical else self._ideal
        rpy = euler(motion.base[:, 3:])
        t = np.arange(len(rpy)) * CONTROL_DT
        late = t - (by["imu_latency"].size if "imu_latency" in by else 0.0)
        imu_rpy, gyro, acc = (
            _delayed(values, t, late) for values in (rpy, motion.gyro, motion.acc)
        )
        if "imu_bias" in by:
            bias = {name: part * by["imu_bias"].size for name, part in by["imu_bias"].shape.items()}
            gyro = gyro + np.array([bias["gyro_x"], bias["gyro_y"], bias["gyro_z"]])
            imu_rpy = imu_rpy + np.array([bias["roll"], bias["pitch"], 0.0])
        if "gyro_scale" in by:
            gyro = gyro * (1 + by["gyro_scale"].size * by["gyro_scale"].shape["sign"])
        if "gyro_cross" in by:
            angle = by["gyro_cross"].size * by["gyro_cross"].shape["sign"]
            gyro = gyro @ np.array([[1.0, angle, 0.0], [-angle, 1.0, 0.0], [0.0, 0.0, 1.0]])
        if "attitude_wander" in by:
            wander = by["attitude_wander"]
            phase = 2 * np.pi * wander.shape["rate"] * t
            wave = np.stack(
                [np.sin(phase), 0.6 * np.sin(0.7 * phase + 1), np.zeros_like(t)], axis=1
            )
            imu_rpy = imu_rpy + wander.size * wave
        if "acc_hum" in by:
            hum = by["acc_hum"]
            acc = acc + hum.size * np.sin(2 * np.pi * hum.shape["rate"] * t)[:, None]
        return {
            "x": motion.base[:, :1], "y": motion.base[:, 1:2], "z": motion.base[:, 2:3], "rpy": rpy,
            "velocity": motion.base_velocity, "q": motion.joints[..., 0],
            "dq": motion.joints[..., 1],
            "tau_est": motion.joints[..., 2], "imu_rpy": imu_rpy, "gyro": gyro, "acc": acc,
            "load": motion.load,
        }  # fmt: skip

    def noise(self, name: str, values: Floats, rng: np.random.Generator) -> Floats:
        """A signal with its sensor's noise."""
        sigma = SIGNALS.get(name, SIGNALS["z"]) * self.level
        return values + sigma * coloured(
            rng, values.shape, self.corner_hz, 1 / CONTROL_DT, self.tuning
        )

    def _friction(self, size: float) -> float:
        """Below what the motion needs: from there on feet slip."""
        return (
            GROUND["friction"]
            if size == 0
            else min(GROUND["friction"], self._slope * (1 - size**0.5))
        )

    def _simulate(self, by: dict[str, Setting]) -> Motion:
        model, data = self._altered(by), None
        data = mujoco.MjData(model)
        data.qpos[7:] = STAND
        per_row = round(CONTROL_DT / STEP_S)
        data.qpos[2] += self.release_m
        settle = 0 if self.release_m else round(SETTLE_S / CONTROL_DT)
        rows = len(self.position)
        base, velocity, gyro, acc = (
            np.zeros((rows, 7)),
            np.zeros((rows, 3)),
            np.zeros((rows, 3)),
            np.zeros((rows, 3)),
        )
        joints, load = np.zeros((rows, 12, 3)), np.zeros((-(-rows // FEET_EVERY), 4))
        slopes = []
        push = Pushes(by, rows)
        drive = by.get("torque_gain")
        gain = 1.0 if drive is None else 1.0 + drive.size * drive.shape["sign"]
        for k in range(-settle, rows):
            row = max(k, 0)
            q, dq = data.qpos[7:], data.qvel[6:]
            torque = self.kp * (self.position[row] - q) + self.kd * (self.velocity[row] - dq)
            data.ctrl[:] = gain * torque
            data.xfrc_applied[1, :2] = push.force(k, data.qvel[:2])
            if k >= 0:
                joints[k, :, 0], joints[k, :, 1], joints[k, :, 2] = q, dq, torque
                base[k], velocity[k], gyro[k] = data.qpos[:7], data.qvel[:3], data.qvel[3:6]
                before = data.qvel[:3].copy()
            mujoco.mj_step(model, data, nstep=per_row)
            if k >= 0:
                acc[k] = (data.qvel[:3] - before) / CONTROL_DT
                if k % FEET_EVERY == 0:
                    load[k // FEET_EVERY], slope = _contacts(model, data)
                    slopes.append(slope)
        turn = rotations(base[:, 3:])
        acc = np.einsum("nji,nj->ni", turn, acc + np.array([0.0, 0.0, 9.81]))
        return Motion(
            base=base, base_velocity=velocity, gyro=gyro, acc=acc, joints=joints, load=load,
            slope=float(np.quantile(slopes, 0.998)),
        )  # fmt: skip

    def _altered(self, by: dict[str, Setting]) -> "mujoco.MjModel":
        """The claimed model with trunk, ground or feet changed."""
        model = self._model.__copy__()
        if "com_offset" in by:
            shape = by["com_offset"].shape
            model.body_ipos[1] += by["com_offset"].size * np.array(
                [shape["x"], shape["y"], shape["z"]]
            )
        if "base_inertia" in by:
            model.body_inertia[1] *= 1 + by["base_inertia"].size
        _load(
            model,
            self.known_payload_kg + (by["payload_mass"].size if "payload_mass" in by else 0.0),
        )
        if "foot_friction" in by:
            model.geom_friction[:, 0] = self._friction(by["foot_friction"].size)
        if "contact_compliance" in by:
            model.geom_solref[:, 0] = (
                GROUND["contact_time_constant"] + by["contact_compliance"].size
            )
        if "hidden_bump" in by:
            model.geom_size[1 + int(by["hidden_bump"].shape["leg"]), 0] += by["hidden_bump"].size
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def _index(self) -> None:
        rows = np.arange(len(self.position))[::4]
        starts = np.array([segment.start_s for segment in self.segments])
        segment = np.searchsorted(starts, rows * CONTROL_DT + 1e-9, side="right") - 1
        read = self.read(())
        groups = []
        for number, name in enumerate(SHOWN):
            width = read[name].shape[1]
            groups.append(np.repeat(segment * len(SHOWN) + number, width))
        self.group = np.concatenate(groups)
        self.nuisances = np.zeros((0, len(self.group)))
        self.places = np.full(len(self.group), "trunk")


def _load(model: "mujoco.MjModel", mass: float) -> None:
    """Puts a small heavy thing onto the trunk."""
    if mass == 0.0:
        return
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[1])
    axes = turn.reshape(3, 3)
    own, centre = float(model.body_mass[1]), model.body_ipos[1].copy()
    arm = np.array(PAYLOAD_POSITION) - centre
    reduced = own * mass / (own + mass)
    inertia = axes @ np.diag(model.body_inertia[1]) @ axes.T + reduced * (
        arm @ arm * np.eye(3) - np.outer(arm, arm)
    )
    principal, directions = np.linalg.eigh(inertia)
    directions[:, 2] *= np.linalg.det(directions)
    model.body_mass[1] = own + mass
    model.body_ipos[1] = centre + mass / (own + mass) * arm
    model.body_inertia[1] = principal
    mujoco.mju_mat2Quat(model.body_iquat[1], directions.ravel())


def euler(quaternion: Floats) -> Floats:
    """Roll, pitch, yaw of quaternions w, x, y, z; shape (n, 3)."""
    w, x, y, z = quaternion.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=1)


def quaternions(rpy: Floats) -> Floats:
    """Quaternions w, x, y, z of roll, pitch, yaw; shape (n, 4)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy.T / 2), np.sin(rpy.T / 2)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )


def rotations(quaternion: Floats) -> Floats:
    """Rotation matrices body to world, (n, 3, 3)."""
    out = np.zeros((len(quaternion), 9))
    for number, one in enumerate(quaternion):
        mujoco.mju_quat2Mat(out[number], one)
    return out.reshape(-1, 3, 3)


def _delayed(values: Floats, t: Floats, late: Floats) -> Floats:
    return np.stack([np.interp(late, t, column) for column in values.T], axis=1)


def _contacts(model: "mujoco.MjModel", data: "mujoco.MjData") -> tuple[Floats, float]:
    """Normal force of each foot and the largest ratio of tangential to normal force."""
    load, slope = np.zeros(4), 0.0
    force = np.zeros(6)
    for number in range(data.ncon):
        contact = data.contact[number]
        mujoco.mj_contactForce(model, data, number, force)
        load[max(contact.geom1, contact.geom2) - 1] += force[0]
        if force[0] > 8.0:
            slope = max(slope, float(np.hypot(force[1], force[2]) / force[0]))
    return load, slope
