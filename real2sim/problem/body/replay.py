"""Replays windows of a log through the simulator, for many sets of effects at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar

from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT
from saltus.effects.body import LEAST_TURNING_M, BodyModel
from saltus.effects.delay_line import held_late
from saltus.effects.effect import map_arrays
from saltus.effects.joint_loads import EndStop, JointSpring
from saltus.effects.motors import TorqueSaturation, TorqueSpeedLimit
from saltus.effects.signals import DriveTorque
from saltus.real2sim.problem.body.windows import (
    BLOCK_STEPS,
    BLOCKS,
    HISTORY_STEPS,
    WINDOW_STEPS,
    BodyWindows,
)
from saltus.robots.robot import Robot
from saltus.sim.free_robots import OWN_SOLVER, ContactSolver, FreeRobots
from saltus.terrain.boxes import Boxes

SOFTER = (0.9, 0.95)
"""Impedance of contacts that engines have by default; the scene's own are stiffer, so that feet do
not creep."""
GROUNDS = (
    OWN_SOLVER,
    ContactSolver(impedance=SOFTER),
    ContactSolver(impratio=1.0),
    ContactSolver(impratio=1.0, impedance=SOFTER),
    ContactSolver(impratio=1.0, impedance=SOFTER, is_pyramidal=True),
)
FINE = 2
"""Steps of the engine in one of `PHYSICS_DT` for a log that agrees better with a finer step: real
contacts have none, and what is left of two steps is a quarter of a small effect."""
CLEAR = 0.1
"""Share of the mean square that another way than the scene's own must explain: a wrong impedance
that wins by 0.3 %, by chance, makes the ground seem harder than claimed."""
OTHERWISE = ((1.0, 2.0, 5.0), (1.0, 0.5, 0.15), (0.0, 0.003, 0.012, 0.05))
"""Time constant and friction, times the claimed ones, and friction against rolling [m]: one of them
may be otherwise than claimed, which comes first. Soft or slippery ground, and feet that resist
rolling, must not be taken for another way to compute contacts. Friction against rolling ends at
five times that of a Go1's feet in MuJoCo Menagerie."""
TRIES = 8
"""Tries between the neighbours of the best of `OTHERWISE`: a ground that is off by a tenth of its
time constant looks worse than another way to compute contacts."""


def likeliest_solver(squares: Callable[[ContactSolver, Floats], Floats]) -> ContactSolver:
    """The way to compute contacts with which a log agrees best, whatever else its robot has.

    It is the scene's own where no other is clearly better. The step of time is judged last.

    Args:
        squares: Mean square of what is left in each window under a solver, for n robots and grounds
            together, shape (n, w): multiples of the claimed time constant and friction, and
            friction against rolling [m], shape (n, 3). Their logarithms are compared: windows with
            much to explain otherwise do not decide alone.
    """

    def left(ground: ContactSolver, *others: tuple[float, float, float]) -> Floats:
        return np.asarray(np.mean(np.log(squares(ground, np.array(others))), axis=1))

    def least(ground: ContactSolver) -> float:
        return min(_least(partial(left, ground), which) for which in range(len(OTHERWISE)))

    costs = [least(ground) for ground in GROUNDS]
    best = int(np.argmin(costs))
    ground = GROUNDS[best] if costs[best] < costs[0] - CLEAR else GROUNDS[0]
    return min(ground, replace(ground, substeps=FINE), key=least)


def _least(left: Callable[..., Floats], which: int) -> float:
    """The least of `left` where one of `OTHERWISE`, counted from 0, is otherwise than claimed."""

    def ground(value: float) -> tuple[float, ...]:
        return tuple(value if i == which else tries[0] for i, tries in enumerate(OTHERWISE))

    tries = OTHERWISE[which]
    scanned = left(*(ground(value) for value in tries))
    best = int(np.argmin(scanned))
    one, other = tries[max(best - 1, 0)], tries[min(best + 1, len(tries) - 1)]
    found = minimize_scalar(
        lambda value: float(left(ground(value))[0]),
        bounds=(min(one, other), max(one, other)),
        method="bounded",
        options={"maxiter": TRIES},
    )
    return min(float(scanned[best]), float(found.fun))


def finer_solvers(ground: ContactSolver) -> Sequence[ContactSolver]:
    """Copies of a solver of contacts with half and with a quarter of its step."""
    return replace(ground, substeps=2 * ground.substeps), replace(
        ground, substeps=4 * ground.substeps
    )


TorqueLimit = TorqueSpeedLimit | TorqueSaturation
PassiveTorque = JointSpring | EndStop
CHUNK = 512
"""Simulations that run together: enough to hide the cost of a call, few enough to stay in the
cache."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BodySimulation:
    """Simulated robots that replay a log's windows, for n sets of unknowns.

    Attributes:
        body: Trunk, payload, ground; shapes (n, ...).
        gain: Delivered over commanded torque, shape (n,).
        sag: Fraction of the torque that is lost by the end of the log, shape (n,).
        delay_s: Age of the command that a drive uses, shape (n,).
        loss: Share of the torque that is lost beyond a corner, shape (n,).
        corner: Torque at the calf beyond which it is [Nm], shape (n,).
        viscous: Friction of each joint [Nm s/rad], shape (n,).
        coulomb: [Nm], shape (n,).
        continuous: How the drives' loop runs: 0 at the physics' 500 Hz, 1 without pause, shape
            (n,).
    """

    body: BodyModel
    gain: Floats
    sag: Floats
    delay_s: Floats
    loss: Floats
    corner: Floats
    viscous: Floats
    coulomb: Floats
    continuous: Floats
    creep: Floats
    """Logarithm of how much more feet creep along the ground than with the solver's contacts, shape
    (n,)."""


class BodyReplay:
    """Replays the windows of one log with simulated robots.

    Args:
        robot: Of the log.
        windows: Of it.
        boxes: Its terrain.
        span_s: Start and end of the log, over which a battery empties.
        solver: Of contacts.
        payload_position: Of what is on top of the trunk [m], base frame, shape (3,); None for the
            simulator's own.
        held: What the drives have that no unknown says; a fitted saturation adds to theirs.
    """

    def __init__(
        self,
        robot: Robot,
        windows: BodyWindows,
        boxes: Boxes,
        span_s: tuple[float, float],
        solver: ContactSolver = OWN_SOLVER,
        payload_position: Sequence[float] | None = None,
        held: Sequence[TorqueLimit | PassiveTorque] = (),
    ) -> None:
        self._windows, self._held = (
            windows,
            sorted(held, key=lambda effect: isinstance(effect, TorqueSaturation)),
        )
        self._made: dict[bool, FreeRobots] = {}
        self._count = len(windows.start_s)
        self._sets = max(1, CHUNK // max(1, self._count))
        self._solver, self._robot, self._boxes, self._payload_position = (
            solver,
            robot,
            boxes,
            payload_position,
        )
        middle = windows.start_s + 0.5 * WINDOW_STEPS * PHYSICS_DT
        # a motor's torque reaches each joint through its reduction: limits of torque scale with it
        self._per_calf = robot.reduction / robot.reduction[2]
        self._age = (middle - span_s[0]) / max(span_s[1] - span_s[0], 1e-9)

    def states(
        self, rig: BodySimulation, qpos: Floats | None = None, qvel: Floats | None = None
    ) -> Floats:
        """Means over blocks, columns as the windows' `measured`, shape (n, w, BLOCKS, 34).

        Args:
            rig: n sets of effects.
            qpos: Other states at the start than the windows', shape (n, w, 19).
            qvel: Likewise, shape (n, w, 18).
        """
        n = len(rig.gain)
        now = self._windows
        qpos = np.broadcast_to(now.qpos, (n, *now.qpos.shape)) if qpos is None else qpos
        qvel = np.broadcast_to(now.qvel, (n, *now.qvel.shape)) if qvel is None else qvel
        out = np.empty((n, self._count, BLOCKS, 34))
        resists = np.maximum(rig.body.torsion, rig.body.rolling) > LEAST_TURNING_M
        for own in (np.flatnonzero(~resists), np.flatnonzero(resists)):
            for i in range(0, len(own), self._sets):
                part = own[i : i + self._sets]
                own_rig = map_arrays(lambda values, part=part: values[part], rig)
                out[part] = self._run(own_rig, qpos[part], qvel[part])
        return out

    def foot_forces(self, rig: BodySimulation) -> tuple[Floats, Floats]:
        """Force of the ground on each foot under one rig:
        tangential and normal [N], shape (w, steps, 4).
        """
        forces = np.empty((WINDOW_STEPS, self._count, 4, 3))
        self._run(rig, self._windows.qpos[None], self._windows.qvel[None], forces)
        along = forces.transpose(1, 0, 2, 3)
        return np.hypot(along[..., 0], along[..., 1]), along[..., 2]

    def _robots(self, *, turns: bool) -> FreeRobots:
        """Robots whose feet slide, or resist turning and rolling, too:
        twice the rows for a contact.
        """
        if turns not in self._made:
            solver = replace(self._solver, dimensions=6) if turns else self._solver
            self._made[turns] = FreeRobots(
                self._robot, self._sets * self._count, self._boxes, solver=solver
            )
            if self._payload_position is not None:
                self._made[turns].set_payload_position(np.asarray(self._payload_position))
        return self._made[turns]

    def _run(
        self, rig: BodySimulation, qpos: Floats, qvel: Floats, forces: Floats | None = None
    ) -> Floats:
        sets, windows = len(rig.gain), self._windows
        robots = self._robots(
            turns=max(rig.body.torsion.max(), rig.body.rolling.max()) > LEAST_TURNING_M
        )
        sims = sets * self._count
        bodies = map_arrays(lambda values: np.repeat(values, self._count, axis=0), rig.body)
        robots.set_bodies(bodies, slice(sims))
        impratio = self._solver.impratio * np.exp(-np.repeat(rig.creep, self._count))
        robots.set_contacts(impratio, np.tile(self._solver.impedance, (sims, 1)))
        robots.derive(np.arange(sims))
        drives = _Drives(rig, windows, self._age, self._per_calf, self._held)
        coulomb = np.repeat(rig.coulomb, self._count)[:, None]
        damping = np.repeat(rig.viscous, self._count)[:, None] + drives.damping
        robots.set_joints(coulomb, damping, 0.0, slice(sims))
        robots.place(qpos.reshape(sims, 19), qvel.reshape(sims, 18))
        q, dq = robots.qpos[:sims], robots.qvel[:sims]
        total = np.zeros((sims, BLOCKS, 34))
        for step in range(WINDOW_STEPS):
            block = total[:, step // BLOCK_STEPS]
            block[:, :19] += q
            block[:, 19:22] += dq[:, :3]
            block[:, 22:] += dq[:, 6:]
            robots.step(drives.torque(step, q[:, 7:], dq[:, 6:]))
            if forces is not None:
                forces[step] = robots.foot_force[:sims]
        return total.reshape(sets, self._count, BLOCKS, 34) / BLOCK_STEPS


class _Drives:
    """Torques of all simulations of a batch."""

    def __init__(
        self,
        rig: BodySimulation,
        windows: BodyWindows,
        age: Floats,
        per_calf: Floats,
        held: Sequence[TorqueLimit | PassiveTorque],
    ) -> None:
        self._limits = [effect for effect in held if isinstance(effect, TorqueLimit)]
        self._pulls = [effect for effect in held if isinstance(effect, PassiveTorque)]
        self._told, self._kp, self._kd = windows.drive, windows.kp, windows.kd
        self._sets, self._count = len(rig.gain), len(windows.start_s)
        self._late = np.clip(rig.delay_s / PHYSICS_DT, 0.0, HISTORY_STEPS - 1.0)[:, None, None]
        strength = rig.gain[:, None] * (1.0 - rig.sag[:, None] * age)
        self._strength = strength.reshape(-1, 1)
        self._loss = np.repeat(rig.loss, self._count)[:, None]
        self._corner = np.repeat(rig.corner, self._count)[:, None] * per_calf
        self._is_late, self._saturates = (
            bool(np.any(self._late > 0.0)),
            bool(np.any(rig.loss != 0.0)),
        )
        # Over a step in which its torque were not held, a drive would see its own mean velocity:
        # half of the damping is the engine's, which is implicit, and the angle is half a step
        # ahead.
        half = 0.5 * np.repeat(rig.continuous, self._count)[:, None]
        self.damping = half * windows.kd * self._strength
        self._kd = self._kd - half * self._kd + half * PHYSICS_DT * self._kp
        self._is_even = bool(np.all(strength == 1.0))

    def torque(self, step: int, position: Floats, velocity: Floats) -> Floats:
        """At the joints over the coming step [Nm], shape (sims, 12)."""
        torque = self._command(step) - self._kp * position - self._kd * velocity
        asked = torque
        for limit in self._limits:  # that of speed before saturation, as in a drive
            torque = _after(limit, position, velocity, torque)
            asked = torque if isinstance(limit, TorqueSpeedLimit) else asked
        if self._saturates:
            torque = torque - np.sign(asked) * self._loss * np.maximum(
                np.abs(asked) - self._corner, 0.0
            )
        torque = torque if self._is_even else self._strength * torque
        for pull in self._pulls:  # at the joint, whatever the drive gives
            torque = _after(pull, position, velocity, torque)
        return torque

    def _command(self, step: int) -> Floats:
        now = HISTORY_STEPS + step
        if not self._is_late:
            return np.tile(self._told[:, now], (self._sets, 1))
        told = held_late(
            lambda ago: self._told[:, now - ago[:, 0, 0]].transpose(1, 0, 2), self._late
        )
        return told.reshape(-1, 12)


def _after(
    effect: TorqueLimit | PassiveTorque, position: Floats, velocity: Floats, torque: Floats
) -> Floats:
    now = DriveTorque(position=position, velocity=velocity, torque=torque)
    return np.asarray(effect.apply(now, np.zeros(()), None)[0].torque, dtype=np.float64)
