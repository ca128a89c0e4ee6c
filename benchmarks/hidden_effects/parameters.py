"""How well parameters are measured: errors, and whether intervals hold the truth."""

from typing import Any

import numpy as np

from benchmarks.hidden_effects.body import GROUND
from benchmarks.hidden_effects.cases import Case
from benchmarks.hidden_effects.shares import median, share


def parameter_rows(cases: list[Case]) -> dict[str, Any]:
    """Errors of parameters, and how often the 90 % intervals hold the truth."""
    relative: list[float] = []
    delays: list[float] = []
    holds: list[bool] = []
    for case in cases:
        effect = case.truth["effects"][0]
        main, null, is_delay = MAIN[effect["name"]]
        for said in case.verdict["effects"]:
            values = _values(said, main, effect["params"])
            if values is None or not _overlap(said["where"], effect["where"]):
                continue
            true = _true(said["where"], effect, main)
            error = float(np.linalg.norm(values[:, 0] - true))
            (delays if is_delay else relative).append(
                error if is_delay else error / max(_size(true, null), 1e-12)
            )
            holds += [
                bool(low <= t <= high) for (_, low, high), t in zip(values, true, strict=True)
            ]
    return {
        "median_parameter_error": median(relative),
        "median_delay_error_ms": median([1e3 * delay for delay in delays]),
        "intervals_hold_truth": share(holds),
    }


MAIN: dict[str, tuple[tuple[str, ...], float, bool]] = {
    "torque_saturation": (("knee",), 0.0, False),
    "torque_speed_limit": (("no_load",), 0.0, False),
    "command_delay": (("delay",), 0.0, True),
    "feedforward_delay": (("delay",), 0.0, True),
    "actuator_lag": (("time_constant",), 0.0, False),
    "velocity_scale": (("scale",), 1.0, False),
    "joint_spring": (("stiffness",), 0.0, False),
    "velocity_filter": (("time_constant",), 0.0, False),
    "torque_gain": (("gain",), 1.0, False),
    "viscous_friction": (("coefficient",), 0.0, False),
    "coulomb_friction": (("torque",), 0.0, False),
    "stiction": (("breakaway",), 0.0, False),
    "backlash": (("width",), 0.0, False),
    "armature": (("added",), 0.0, False),
    "battery_sag": (("loss_at_end",), 0.0, False),
    "encoder_bias": (("bias",), 0.0, False),
    "encoder_quantisation": (("step",), 0.0, False),
    "payload_mass": (("mass",), 0.0, False),
    "com_offset": (("x", "y", "z"), 0.0, False),
    "base_inertia": (("scale",), 1.0, False),
    "foot_friction": (("coefficient",), GROUND["friction"], False),
    "contact_compliance": (("time_constant",), GROUND["contact_time_constant"], False),
    "imu_bias": (("gyro_x", "gyro_y", "gyro_z", "roll", "pitch"), 0.0, False),
    "imu_latency": (("delay",), 0.0, True),
    "camera_latency": (("latency",), 0.0, True),
    "frame_drop": (("fraction",), 0.0, False),
    "temporal_smear": (("alpha",), 1.0, False),
    "camera_pitch": (("offset",), 0.0, False),
    "camera_height": (("offset",), 0.0, False),
    "camera_fov": (("scale",), 1.0, False),
    "depth_scale": (("scale",), 1.0, False),
    "depth_bias": (("bias",), 0.0, False),
    "depth_noise": (("subpixel_sigma",), 0.0, False),
    "edge_holes": (("width",), 0.0, False),
    "hole_fill": (("reach",), 0.0, False),
    "range_clip": (("max",), 0.0, False),
}
"""For each effect: the parameters that count, the value at which it is absent, whether the error is
a time."""


def _true(said: Any, effect: dict[str, Any], main: tuple[str, ...]) -> np.ndarray:
    """The parameters that count, the median over those joints a value was stated for,
    shape (parameters,).
    """
    each = effect.get("params_at") or {}
    stated = [params for joint, params in each.items() if said == "all" or joint in said] or [
        effect["params"]
    ]
    return np.median([[params[name] for name in main] for params in stated], axis=0)


def _size(true: np.ndarray, null: float) -> float:
    """Size of the deviation that is to be found."""
    return float(np.linalg.norm(true - null))


def _values(said: dict[str, Any], main: tuple[str, ...], true: dict[str, Any]) -> np.ndarray | None:
    """Value and interval of each parameter that counts, shape (parameters, 3)."""
    found = said.get("params", {})
    if said.get("name") is None or any(name not in found or name not in true for name in main):
        return None
    return np.array(
        [[found[name]["value"], *found[name].get("ci90", [np.nan, np.nan])] for name in main],
        dtype=float,
    )


def _overlap(said: Any, true: list[str]) -> bool:
    return said in ("all", "camera", "trunk", "feet", "imu") or bool(set(said) & set(true))
