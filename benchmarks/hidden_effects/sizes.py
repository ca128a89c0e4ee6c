"""How large is one sigma, and which effects look alike: both by simulating with and without."""

import numpy as np
from scipy.optimize import lsq_linear

from benchmarks.hidden_effects.robot import Floats
from benchmarks.hidden_effects.scene import Scene, Setting

ROUNDS = 9
CLOSE, ROUGH = 0.04, 0.35
"""Part by which the residual at a found size may miss one sigma: of an effect that is hidden, of
its rivals."""
FAINT = 0.02
"""Residual below which nothing is known but that it is small [sigma]."""


def one_sigma(
    scene: Scene, settings: list[Setting], close: float = CLOSE, rounds: int = ROUNDS
) -> list[float]:
    """Sizes at which the residual has an RMS of one sigma
    in the segment and signal that show it best.

    All settings are searched at once: by the chord where a bracket is missing, then by the secant
    in logarithms.

    Returns:
        A size for each setting; infinity where not even the largest that a robot could have shows a
        sigma.
    """
    searches = [_Search(setting.size, scene.largest(setting), close) for setting in settings]
    base = scene.respond([()])[0]
    for _ in range(rounds):
        open_ = [i for i, search in enumerate(searches) if not search.done]
        if not open_:
            break
        responses = scene.respond([(settings[i].sized(searches[i].size),) for i in open_])
        for i, response in zip(open_, responses, strict=True):
            searches[i].tell(best_rms(scene, visible(scene, response - base), settings[i].where))
    return [search.size for search in searches]


class _Search:
    """Search for the size of one effect.

    Args:
        start: Size to begin with.
        largest: Size that is not exceeded.
        close: Part by which the residual may miss one sigma.
    """

    def __init__(self, start: float, largest: float, close: float) -> None:
        self.size = min(start, largest)
        self.done = False
        self._largest, self._close = largest, close
        self._low, self._high = (0.0, FAINT), (np.inf, np.inf)
        self._sides: list[bool] = []

    def tell(self, shown: float) -> None:
        """Goes on from the residual that the present size shows."""
        shown = max(shown, FAINT)
        if abs(shown - 1) < self._close:
            self.done = True
            return
        self._sides.append(shown < 1)
        if shown < 1:
            self._low = (self.size, shown)
        else:
            self._high = (self.size, shown)
        if self._low[0] >= 0.999 * self._largest:
            self.size, self.done = np.inf, True
            return
        self.size = min(self._next(shown), self._largest)

    def _next(self, shown: float) -> float:
        (low, below), (high, above) = self._low, self._high
        if not np.isfinite(high):
            return self.size / max(shown, 0.1)
        if low == 0.0:
            return self.size / min(shown, 50.0)
        if self._sides[-3:] in ([True] * 3, [False] * 3):  # the secant keeps to one side of a bend
            return float(np.sqrt(low * high))
        part = np.clip(-np.log(below) / np.log(above / below), 0.1, 0.9)
        return float(low * (high / low) ** part)


def visible(scene: Scene, residual: Floats) -> Floats:
    """Returns what of a residual no amount of the nuisances takes away that they can have."""
    if len(scene.nuisances) == 0:
        return residual
    finite = np.clip(np.nan_to_num(residual), -1e4, 1e4)
    basis, mixing = np.linalg.qr(scene.nuisances.T)
    amounts = lsq_linear(mixing, basis.T @ finite, bounds=(-1, 1)).x
    return np.asarray(residual - amounts @ scene.nuisances)


def best_rms(scene: Scene, residual: Floats, where: tuple[str, ...]) -> float:
    """RMS of a residual in the segment and signal in which it is largest,
    over the places that have the effect.
    """
    there = np.isin(scene.places, where)
    count = np.bincount(scene.group[there])
    power = np.bincount(
        scene.group[there], weights=np.minimum(np.nan_to_num(residual[there], nan=1e6), 1e6) ** 2
    )
    return float(np.sqrt((power[count > 0] / count[count > 0]).max()))


def signatures(scene: Scene, settings: list[Setting]) -> Floats:
    """Unit vectors along which the visible residual moves when an effect sets in.

    Shape (settings, m).
    """
    base = scene.respond([()])[0]
    responses = scene.respond([(setting,) for setting in settings])
    moved = np.nan_to_num(
        np.clip([visible(scene, response - base) for response in responses], -1e4, 1e4)
    )
    length = np.linalg.norm(moved, axis=1, keepdims=True)
    return np.asarray(moved / np.where(length > 0, length, 1.0))


def nearest(own: Floats, rivals: Floats, beside: Floats | None = None) -> Floats:
    """|cos| between a signature and each rival's,
    with the span of `beside`, shape (k, m), projected out.
    """
    if beside is not None and len(beside):
        basis, _ = np.linalg.qr(beside.T)
        own = own - basis @ (basis.T @ own)
        rivals = rivals - (rivals @ basis) @ basis.T
    norms = np.linalg.norm(rivals, axis=-1) * np.linalg.norm(own)
    return np.asarray(np.abs(rivals @ own) / np.where(norms > 1e-9, norms, np.inf))


def outside_of(own: Floats, library: Floats) -> float:
    """Part of a signature's energy that no mixture of the library's signatures explains."""
    basis, _ = np.linalg.qr(library.T)
    rest = own - basis @ (basis.T @ own)
    return float(rest @ rest) / max(float(own @ own), 1e-12)
