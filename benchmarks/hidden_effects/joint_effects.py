"""Effects of drives: from a size and a shape to a table for the kernel,
and to the schema's parameters.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from benchmarks.hidden_effects.leg_kernel import CURVE_POINTS
from benchmarks.hidden_effects.legs import BEND, Hidden, PacketTiming
from benchmarks.hidden_effects.robot import ARMATURE, JOINTS, STAND, TORQUE_LIMIT, Floats
from benchmarks.hidden_effects.scene import Family, Setting, draw_sign

# Torque of the original's knee by table [Nm]: commanded, delivered
TABLE_COMMANDED = np.array([0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0])
TABLE_DELIVERED = np.array([0.0, 5.0, 9.78, 14.12, 17.23, 20.34, 24.01, 25.68])
SOFTEST_TEETH, STIFFEST_TEETH = 4.0e3, 4.0e4
"""Stiffness of teeth in contact [Nm/rad]: 10 Nm twist the softest by two and a half times an
encoder's noise."""
MOTOR_SIDE = 0.8
"""Share of drives with play whose log is that of the motor's encoder, as of most that have one
encoder."""
LARGEST_LOSS = 0.95
"""Share of the largest torque that a curve with a level may take."""
CURVES = ("table", "knee", "tanh", "clip")
"""Shapes of a saturation: the knee's table, a smooth power law beyond an onset, and two that end at
a level."""


def _knee(rng: np.random.Generator) -> dict[str, float]:
    return {
        "onset": float(rng.uniform(0.15, 0.4)),
        "curve": float(rng.integers(len(CURVES))),
        "power": float(rng.uniform(1.3, 2)),
    }


def _way(rng: np.random.Generator) -> dict[str, float]:
    return {
        "jitter": float(rng.uniform(0.02, 0.2)),
        "late": float(rng.uniform(0.0, 0.05)),
        "is_whole": float(rng.uniform() < 0.4),
    }


def _bristle(rng: np.random.Generator, most: float = 1e-3) -> dict[str, float]:
    """How far bristles bend before they give way [rad]: from nothing to what an encoder sees."""
    return {"bend": float(np.exp(rng.uniform(np.log(5e-5), np.log(most))))}


def _stribeck(rng: np.random.Generator) -> dict[str, float]:
    """Bristles that bend far never reach the peak: they are faster than its velocity before."""
    return {"velocity": float(np.exp(rng.uniform(-3.5, -1.5))), **_bristle(rng, 4e-4)}


def _teeth(rng: np.random.Generator) -> dict[str, float]:
    """Stiffness, part of the critical damping of a rotor on them, and the side of the encoder."""
    return {
        "stiffness": float(np.exp(rng.uniform(np.log(SOFTEST_TEETH), np.log(STIFFEST_TEETH)))),
        "damped": float(rng.uniform(0.1, 0.6)),
        "motor_side": float(rng.uniform() < MOTOR_SIDE),
    }


LIBRARY = {
    "command_delay": Family(usual=1.3e-3, largest=0.03, shape=_way),
    "feedforward_delay": Family(usual=4e-3, largest=0.03, shape=_way),
    "actuator_lag": Family(usual=2e-3, largest=0.03),
    "velocity_filter": Family(usual=1e-3, largest=0.03),
    "velocity_scale": Family(usual=0.02, largest=0.5, shape=draw_sign),
    "torque_gain": Family(usual=0.02, largest=0.5, shape=draw_sign),
    "viscous_friction": Family(usual=0.02, largest=1.5),
    "coulomb_friction": Family(usual=0.04, largest=3.0, shape=_bristle),
    "stiction": Family(usual=0.2, largest=3.0, shape=_stribeck),
    "backlash": Family(usual=5e-3, largest=0.08, shape=_teeth),
    "armature": Family(usual=3e-4, largest=0.03),
    "battery_sag": Family(usual=0.03, largest=0.4),
    "encoder_bias": Family(usual=1e-3, largest=0.15, shape=draw_sign),
    "encoder_quantisation": Family(usual=3e-3, largest=0.025),
    "joint_spring": Family(
        usual=0.3, largest=8.0, shape=lambda rng: {"rest": float(rng.uniform(-0.5, 0.5))}
    ),
    "torque_saturation": Family(usual=0.05, largest=0.45, shape=_knee),
    "torque_speed_limit": Family(
        usual=0.01, largest=0.45, shape=lambda rng: {"corner": float(rng.uniform(0.3, 0.8))}
    ),
}
OUTSIDE = {
    "cogging": Family(
        usual=0.1, largest=1.5, shape=lambda rng: {"cycles": float(rng.uniform(25, 80))}
    ),
    "kp_slope": Family(usual=0.1, largest=2.0, shape=draw_sign),
    "heating": Family(usual=3e-3, largest=0.1),
    "dead_zone": Family(usual=0.05, largest=1.5),
    "asymmetric_gain": Family(usual=0.02, largest=0.4),
    "quadratic_drag": Family(usual=5e-3, largest=0.2),
    "hum": Family(usual=0.1, largest=1.5, shape=lambda rng: {"rate": float(rng.uniform(4, 25))}),
    "coupling": Family(usual=0.02, largest=0.3, shape=draw_sign),
    "slew_limit": Family(usual=5e-4, largest=0.02),
    "flexible_gear": Family(usual=1e-3, largest=8e-3),
    "integral_term": Family(usual=0.01, largest=2.0),
    "rubbing_spot": Family(
        usual=0.2, largest=4.0, shape=lambda rng: {"at": float(rng.uniform(-0.25, 0.25))}
    ),
    "dropouts": Family(usual=0.1, largest=1.0),
    "eccentric_encoder": Family(
        usual=1.5e-3, largest=0.03, shape=lambda rng: {"cycles": float(rng.uniform(6, 25))}
    ),
}
"""A size is: Nm, 1/rad, 1/Nm^2, Nm, 1, Nm s^2/rad^2, Nm, 1, s/Nm, rad/Nm; 1/s, Nm, 1, rad."""
FAMILIES = {**LIBRARY, **OUTSIDE}


@dataclass(frozen=True, kw_only=True)
class Peak:
    """Fastest motion and largest torque of each joint in a log of the ideal robot, shape (12,)."""

    speed: Floats
    torque: Floats


def hidden(settings: tuple[Setting, ...], peak: Peak, period_s: float = np.inf) -> Hidden:
    """Table of the kernel for several effects at once.

    Packets come in whole periods only where they take one, `period_s`, or more: of a shorter delay
    a few packets would be a whole period late. Sizes are found without such periods, in which they
    would make a jump.
    """
    values: dict[str, Floats] = {}
    command_delay = forward_delay = curve = None
    command_way = forward_way = PacketTiming()
    for setting in settings:
        there = np.isin(JOINTS, setting.where)
        if setting.size == 0.0:
            continue
        if setting.effect == "command_delay":
            command_delay, command_way = there * setting.size, _packets(setting, period_s)
        elif setting.effect == "feedforward_delay":
            forward_delay, forward_way = there * setting.size, _packets(setting, period_s)
        elif setting.effect == "torque_saturation":
            curve = there[:, None] * lost_curve(setting, peak)
        else:
            for name, value, null in _columns(setting, peak):
                before = values.get(name, np.full(12, null))
                values[name] = np.where(there, value, before)
    return Hidden(
        values=values,
        command_delay=command_delay,
        forward_delay=forward_delay,
        command_way=command_way,
        forward_way=forward_way,
        curve=curve,
    )


def _packets(setting: Setting, period_s: float) -> PacketTiming:
    shape = setting.shape
    if not shape:
        return PacketTiming()
    is_whole = bool(shape["is_whole"]) and setting.size >= period_s
    return PacketTiming(jitter=shape["jitter"], late=shape["late"], is_whole=is_whole)


def largest(setting: Setting, peak: Peak) -> float:
    """Largest size that a real robot could have.

    Of a saturation that at which more command gives more.
    """
    if setting.effect != "torque_saturation" or CURVES[int(setting.shape["curve"])] in (
        "tanh",
        "clip",
    ):
        return FAMILIES[setting.effect].largest
    curves = lost_curve(setting.sized(np.inf), peak)[np.isin(JOINTS, setting.where)]
    limits = TORQUE_LIMIT[np.isin(JOINTS, setting.where)]
    return float(min(FAMILIES[setting.effect].largest, (curves[:, -1] / limits).min()))


def no_load(size: float) -> float:
    """No-load speed in parts of the fastest motion:
    the residual grows with about the third power of the cut.
    """
    return 1.1 * (1.0 - size**0.4)


def lost_curve(setting: Setting, peak: Peak) -> Floats:
    """Torque lost at equal steps of the command up to each joint's limit, shape (12, points)."""
    curves = []
    kind = CURVES[int(setting.shape["curve"])]
    for joint in range(12):
        limit = TORQUE_LIMIT[joint]
        command = np.linspace(0.0, limit, CURVE_POINTS)
        if kind in ("tanh", "clip"):
            # a share of the largest torque of the log is lost there
            most = min(peak.torque[joint], limit)
            level = _level(kind, min(setting.size, LARGEST_LOSS)) * most
            curves.append(
                command
                - (
                    np.minimum(command, level)
                    if kind == "clip"
                    else level * np.tanh(command / level)
                )
            )
            continue
        onset = setting.shape["onset"] * peak.torque[joint]
        if kind == "table":
            # the knee's table, stretched so that its bend lies at the onset
            scaled = command * 5.0 / onset
            slope = (TABLE_DELIVERED[-1] - TABLE_DELIVERED[-2]) / 5.0
            beyond = np.maximum(scaled - 35.0, 0.0)
            delivered = np.interp(scaled, TABLE_COMMANDED, TABLE_DELIVERED) + slope * beyond
            loss = (scaled - delivered) * onset / 5.0
        else:
            loss = np.maximum(command - onset, 0.0) ** setting.shape["power"]
        steepest = np.max(np.diff(loss)) / (command[1] - command[0])
        # never steeper than one: more command would give less torque
        curves.append(loss * min(setting.size * limit / loss[-1], 0.98 / steepest))
    return np.array(curves)


def _gear(shape: dict[str, float]) -> list[tuple[str, Floats | float, float]]:
    """Two masses; the side of the log is that of one encoder for all."""
    stiffness = shape.get("stiffness", STIFFEST_TEETH)
    damping = 2.0 * shape.get("damped", 0.1) * np.sqrt(stiffness * ARMATURE)
    return [
        ("gear_stiffness", stiffness, 0.0),
        ("gear_damping", damping, 0.0),
        ("motor_side", shape.get("motor_side", 1.0), 0.0),
    ]


def _level(kind: str, size: float) -> float:
    """Where a curve ends that loses this share of a command of 1."""
    if kind == "clip":
        return 1.0 - size
    return float(brentq(lambda k: k * np.tanh(1.0 / k) - (1.0 - size), 1e-3, 1e3))


def _columns(setting: Setting, peak: Peak) -> list[tuple[str, Floats | float, float]]:
    """Columns of the kernel's table that an effect sets: name, value, value where it is absent."""
    size, shape = setting.size, setting.shape
    sign = shape.get("sign", 1.0)
    if setting.effect == "torque_speed_limit":
        none = no_load(size) * peak.speed
        return [("speed_none", none, 0.0), ("speed_corner", shape["corner"] * none, 0.0)]
    bend = [("presliding", shape.get("bend", BEND), BEND)]
    several: dict[str, list[tuple[str, Floats | float, float]]] = {
        "backlash": [("gap", size, 0.0), *_gear(shape)],
        "flexible_gear": [("gear_stiffness", 1.0 / size, 0.0), ("gear_damping", 0.3, 0.0)],
        "coulomb_friction": [("coulomb", size, 0.0), *bend],
        "stiction": [
            ("breakaway", size, 0.0),
            ("stribeck_velocity", shape.get("velocity", 0.1), 0.1),
            *bend,
        ],
        "cogging": [("cogging", size, 0.0), ("cogging_cycles", shape.get("cycles", 0.0), 0.0)],
        "joint_spring": [
            ("spring", size, 0.0),
            ("spring_rest", STAND + shape.get("rest", 0.0), 0.0),
        ],
        "hum": [("hum", size, 0.0), ("hum_rate", shape.get("rate", 0.0), 0.0)],
        "coupling": [("coupling", sign * size, 0.0)],
        "torque_gain": [("gain", 1.0 + sign * size, 1.0)],
        "velocity_scale": [("speed_scale", 1.0 + sign * size, 1.0)],
        "encoder_bias": [("bias", sign * size, 0.0)],
        "kp_slope": [("kp_slope", sign * size, 0.0)],
        "slew_limit": [("slew", 1.0 / size, 0.0)],
        "rubbing_spot": [("rub", size, 0.0), ("rub_at", STAND + shape.get("at", 0.0), 0.0)],
        "eccentric_encoder": [
            ("eccentric", size, 0.0),
            ("eccentric_cycles", shape.get("cycles", 0.0), 0.0),
        ],
    }
    single = {
        "actuator_lag": "lag", "velocity_filter": "velocity_filter", "viscous_friction": "viscous",
        "armature": "armature", "battery_sag": "sag",
        "encoder_quantisation": "quantum", "heating": "heating", "dead_zone": "dead_zone",
        "asymmetric_gain": "asymmetry", "quadratic_drag": "damping_slope",
        "integral_term": "integral", "dropouts": "dropout",
    }  # fmt: skip
    return (
        several[setting.effect]
        if setting.effect in several
        else [(single[setting.effect], size, 0.0)]
    )


def parameters(setting: Setting, peak: Peak) -> dict[str, float | list[list[float]]]:
    """The schema's parameters.

    Where joints differ, those of the first of them: see `parameters_at`.
    """
    joint = JOINTS.index(setting.where[0])
    size, sign = setting.size, setting.shape.get("sign", 1.0)
    if setting.effect == "torque_saturation":
        return _curve_parameters(lost_curve(setting, peak)[joint], float(TORQUE_LIMIT[joint]))
    if setting.effect == "torque_speed_limit":
        none = float(no_load(size) * peak.speed[joint])
        return {"corner": setting.shape["corner"] * none, "no_load": none}
    names = {
        "command_delay": "delay", "feedforward_delay": "delay", "actuator_lag": "time_constant",
        "velocity_filter": "time_constant", "viscous_friction": "coefficient",
        "coulomb_friction": "torque",
        "backlash": "width", "armature": "added", "battery_sag": "loss_at_end",
        "encoder_quantisation": "step",
    }  # fmt: skip
    if setting.effect == "torque_gain":
        return {"gain": 1.0 + sign * size}
    if setting.effect == "velocity_scale":
        return {"scale": 1.0 + sign * size}
    if setting.effect == "encoder_bias":
        return {"bias": sign * size}
    if setting.effect == "joint_spring":
        return {"torque": size * (float(STAND[joint]) + setting.shape["rest"]), "stiffness": size}
    if setting.effect == "stiction":
        return {"breakaway": size, "stribeck_velocity": setting.shape["velocity"]}
    return {
        names.get(setting.effect, "size"): size,
        **({} if setting.effect in names else setting.shape),
    }


def parameters_at(setting: Setting, peak: Peak) -> dict[str, dict[str, float | list[list[float]]]]:
    """The schema's parameters of each joint, for effects that depend on its range.

    Empty for others.
    """
    if setting.effect not in ("torque_saturation", "torque_speed_limit", "joint_spring"):
        return {}
    return {joint: parameters(replace(setting, where=(joint,)), peak) for joint in setting.where}


def _curve_parameters(loss: Floats, limit: float) -> dict[str, float | list[list[float]]]:
    command = np.linspace(0.0, limit, CURVE_POINTS)
    part = loss[1:] / command[1:]
    beyond = np.flatnonzero(part >= 0.05)
    knee = (
        limit
        if len(beyond) == 0
        else float(np.interp(0.05, part[: beyond[0] + 1], command[1 : beyond[0] + 2]))
    )
    curve = np.stack([command, command - loss], axis=1)
    return {"knee": knee, "plateau": float(limit - loss[-1]), "curve": curve.round(4).tolist()}
