"""A problem whose residuals are linear in its unknowns:
sines in two signals, seen in six segments.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import Candidate, LogSegment, Problem, Unknown

WHERES = ("hip", "thigh")
SEGMENTS, ROWS, ROW_S = 6, 200, 0.01


def _candidate(effect: str, where: str, low: float, high: float, start: float) -> Candidate:
    return Candidate(
        effect=effect,
        where=where,
        unknowns=(Unknown(name="size", low=low, high=high, scale=0.5),),
        starts=((start,),),
        is_nuisance=effect == "clock",
    )


class LinearProblem(Problem):
    """`hidden` maps (effect, where, block) to a size; `alike` gives e1 and e2 this cosine."""

    def __init__(
        self,
        hidden: dict[tuple[str, str, str], float],
        *,
        seed: int = 0,
        colour: float = 0.0,
        alike: float | None = None,
        effects: int = 6,
        blocks: tuple[str, ...] = ("FR", "FL"),
    ) -> None:
        self.name = "joints"
        self.blocks = blocks
        self.places = tuple({where: f"{block}_{where}" for where in WHERES} for block in blocks)
        self.candidates = (
            *(
                _candidate(f"e{i}", where, 0.0, 50.0, 0.5)
                for i in range(effects)
                for where in WHERES
            ),
            _candidate("clock", "hip", -5.0, 5.0, 0.0),
        )
        length = ROWS * ROW_S
        self.segments = tuple(
            LogSegment(
                name=f"s{i}", start_s=i * length, end_s=(i + 1) * length, condition=f"c{i // 2}"
            )
            for i in range(SEGMENTS)
        )
        rows = SEGMENTS * ROWS
        self.segment = np.tile(np.repeat(np.arange(SEGMENTS), ROWS), 2)
        self.signals = ("q_hip", "q_thigh")
        self.signal = np.repeat(np.arange(2), rows)
        self.time_s = np.tile(np.arange(rows) * ROW_S, 2)
        self.untestable = {}
        self._signatures = _signatures(effects, alike)
        truth = np.zeros((len(blocks), len(self.candidates)))
        for (effect, where, block), size in hidden.items():
            column = [(c.effect, c.where) for c in self.candidates].index((effect, where))
            truth[blocks.index(block), column] = size
        rng = np.random.default_rng(seed)
        noise = rng.normal(size=(len(blocks), 2, rows))
        for k in range(1, rows):
            noise[..., k] = colour * noise[..., k - 1] + np.sqrt(1.0 - colour**2) * noise[..., k]
        self.measured = noise.reshape(len(blocks), -1) + truth @ self._signatures

    def residuals(self, unknowns: Floats) -> Floats:
        return np.asarray(self.measured - unknowns @ self._signatures)

    def keep_rows(self, rows: Any) -> None:
        """Forgets the other residuals."""
        self.time_s, self.segment, self.signal = (
            self.time_s[rows],
            self.segment[rows],
            self.signal[rows],
        )
        self.measured, self._signatures = self.measured[:, rows], self._signatures[:, rows]

    def part_signals(self) -> None:
        """Has an effect at a place change the signal of that place alone,
        and the clock that of hips.
        """
        of_thigh = np.array([candidate.where == "thigh" for candidate in self.candidates])
        self._signatures = self._signatures * (of_thigh[:, None] == (self.signal == 1))

    def keep_unknowns(self, unknowns: slice) -> None:
        """Forgets what the other unknowns do."""
        self._signatures = self._signatures[unknowns]


class ChoiceProblem(LinearProblem):
    """The effect e1 has a choice, `side`: at 1 its signature is that of e6,
    which is no effect here.
    """

    def __init__(self, hidden: dict[tuple[str, str, str], float], *, alike: float) -> None:
        super().__init__(hidden, alike=alike, effects=7)
        side = Unknown(name="side", low=0.0, high=1.0, scale=0.5, is_shape=True, is_choice=True)
        self.candidates = tuple(
            replace(c, unknowns=(*c.unknowns, side), starts=((0.5, 0.0), (0.5, 1.0)))
            if c.effect == "e1"
            else c
            for c in self.candidates
            if c.effect != "e6"
        )

    def residuals(self, unknowns: Floats) -> Floats:
        names = np.array(self.names)
        size, side = unknowns[..., names == "e1.size"], np.round(unknowns[..., names == "e1.side"])
        plain = unknowns[..., names != "e1.side"].copy()
        plain[..., 2:4] = size * (1.0 - side)  # e1 comes after the two places of e0
        return super().residuals(
            np.concatenate([plain[..., :-1], size * side, plain[..., -1:]], axis=-1)
        )


def _signatures(effects: int, alike: float | None) -> Floats:
    rng = np.random.default_rng(1)
    t = np.tile(np.arange(ROWS) * ROW_S, SEGMENTS)
    waves = []
    for _ in range(effects):
        strength = np.repeat(np.repeat(rng.uniform(0.3, 1.5, SEGMENTS // 2), 2), ROWS)
        waves.append(
            strength * np.sin(2.0 * np.pi * rng.uniform(0.5, 4.0) * t + rng.uniform(0.0, 6.3))
        )
    if alike is not None:
        a, b = waves[1], waves[2]
        b = b - a * (a @ b) / (a @ a)
        waves[2] = alike * a + np.sqrt(1.0 - alike**2) * b * np.linalg.norm(a) / np.linalg.norm(b)
    rows = [
        np.concatenate([wave, 0.1 * wave] if where == 0 else [0.1 * wave, wave])
        for wave in waves
        for where in (0, 1)
    ]
    return np.array([*rows, np.tile(0.3 * np.cos(2.0 * np.pi * 1.3 * t), 2)])
