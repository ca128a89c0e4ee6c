"""Faults that are planted in simulated robots:
whether a preflight finds them, and how a run with them ends.

Messages of both sides go by hand, in the simulated time. Drives are those that a trial draws.
"""

import json
from typing import Any

import numpy as np

from benchmarks._command import progress, tell
from benchmarks.unitree_link.in_memory import Bounding, Wire, checks, simulated
from saltus.constants import PHYSICS_DT
from saltus.controller.rising import RISE_S
from saltus.controller.robot.unitree.faults import AT_A_JOINT, KINDS
from saltus.controller.robot.unitree.link import COMMANDS
from saltus.controller.robot.unitree.messages import LOW_COMMAND, MOTORS
from saltus.controller.robot.unitree.truth import read_truth
from saltus.errors import StackError
from saltus.robots.robot import JOINTS
from saltus.rotations import rotation_matrix
from saltus.wire.messages import ControllerMode

NO_FAULTS = ("button", "mode")
"""Kinds that are none: a person ends the run, or the robot is released."""
ONLY_STANDING = ("offset",)
"""Faults that do not show while the robot hangs."""
BEGINS_S = (RISE_S + 1.2, RISE_S + 2.2)
"""Between these a fault begins, while the robot bounds, since the start [s]."""
DAMPED_S = 0.110
"""A fault may take so long until the robot is damped."""
LASTS_S = 2.0
"""A run goes on for so long after its fault has begun [s]."""
UPRIGHT = 0.5
"""Cosine of the tilt, 60 degrees, beyond which a robot has fallen."""


def preflights(seeds: int, planted: int) -> dict[str, Any]:
    """Healthy robots that pass, hanging and standing, and the checks that find each kind of fault.

    Args:
        seeds: Number of healthy robots.
        planted: Number of robots with each fault.
    """
    healthy = {
        name: sum(not _refused(stands=stands, seed=seed) for seed in range(seeds))
        for name, stands in (("hangs", False), ("stands", True))
    }
    kinds = [kind for kind in KINDS if kind not in NO_FAULTS]
    found = {kind: [_found(kind, seed) for seed in range(planted)] for kind in kinds}
    return {
        "healthy": seeds,
        "passed": healthy,
        "planted of each kind": planted,
        "found": {kind: sum(bool(names) for names in rows) for kind, rows in found.items()},
        "by": {kind: sorted({name for names in rows for name in names})
               for kind, rows in found.items()},
    }  # fmt: skip


def _found(kind: str, seed: int) -> list[str]:
    joint = JOINTS[int(np.random.default_rng([seed, 7]).integers(MOTORS))]
    fault = f"{kind}:{joint}" if kind in AT_A_JOINT else kind
    return _refused(fault, stands=kind in ONLY_STANDING, seed=seed)


def _refused(*faults: str, stands: bool, seed: int) -> list[str]:
    wire = Wire(simulated(*faults, seed=seed, held=not stands))
    if "foreign" in faults:
        wire.strangers = ("another",)
    return [check.name for check in checks(wire, stands=stands) if not check.passed]


def runs(seeds: int) -> list[dict[str, Any]]:
    """A row for each kind of fault that begins while the robot bounds: how its runs went on."""
    rows = []
    for kind in progress(KINDS):
        rows.append(_row(kind, [run_with(kind, seed) for seed in range(seeds)]))
        tell(json.dumps(rows[-1]))
    return rows


def _row(kind: str, ran: list[dict[str, Any]]) -> dict[str, Any]:
    took = [each["took_s"] for each in ran if each["took_s"] is not None]
    return {
        "kind": kind, "runs": len(ran), "upright": sum(each["upright"] for each in ran),
        "damped": sum(each["how"] == "damped" for each in ran),
        "landed": sum(each["how"] == "landed" for each in ran),
        "within 110 ms": sum(each <= DAMPED_S for each in took),
        "slowest_ms": round(1000 * max(took), 1) if took else None,
        "sent beside others": sum(each["sent_beside_others"] for each in ran),
        "said": sorted({each["said"] for each in ran if each["said"]})[:3],
    }  # fmt: skip


def run_with(kind: str, seed: int) -> dict[str, Any]:
    """A run with a fault from a random moment on: what ended it and why, and after how long [s].

    `joint` is where a fault at a joint was. `how` is "damped", "landed" (it begins to), or empty,
    and then `took_s` is None. `upright` tells how it lay or stood in the end, `sent_beside_others`
    how many commands it was sent while another program commanded it.
    """
    rng = np.random.default_rng([seed, 5])
    start_s, joint = float(rng.uniform(*BEGINS_S)), JOINTS[int(rng.integers(MOTORS))]
    at = f":{joint}" if kind in AT_A_JOINT else ""
    bounding = Bounding(f"{kind}{at}@{start_s:.3f}", seed=seed)
    bounding.until(start_s - 2.0 * PHYSICS_DT)  # the robot's time is ahead by a tick
    if kind == "foreign":
        bounding.wire.strangers = ("another",)
    beside, said, how, took_s = 0, "", "", None
    while bounding.run.time_s < start_s + LASTS_S:
        are_others, before = bool(bounding.wire.others(COMMANDS)), len(bounding.wire.sent)
        try:
            bounding.run.step()
        except StackError as error:
            said = str(error)
            break
        beside += are_others * (len(bounding.wire.sent) - before)
        bounding.wire.tick()
        if took_s is None and (how := _how(bounding)):
            took_s, said = bounding.run.time_s - start_s, bounding.robot.fault
        said = said or bounding.robot.concern
    truth = read_truth(bounding.wire.robot.truth()).motion
    up = rotation_matrix(truth["quaternion_base_in_world"])[2, 2]
    return {
        "joint": joint, "how": how, "took_s": took_s, "said": "".join(c for c in said if not c.isdigit()),
        "upright": bool(up > UPRIGHT), "sent_beside_others": beside,
    }  # fmt: skip


def _how(bounding: Bounding) -> str:
    """Damped or landed, as a robot is brought to rest; empty while it bounds."""
    if _is_damping(bounding.wire.sent[-1]):
        return "damped"
    return "landed" if bounding.run.mode == ControllerMode.LANDING else ""


def _is_damping(payload: bytes) -> bool:
    motors = LOW_COMMAND.read([payload])[0]["motor_cmd"][:MOTORS]
    return not motors["kp"].any() and bool(motors["kd"].all())
