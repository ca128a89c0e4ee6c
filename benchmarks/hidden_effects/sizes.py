"""How large is one sigma, and which effects look alike: both by simulating with and without."""

import numpy as np

from benchmarks.hidden_effects.robot import Floats
from benchmarks.hidden_effects.scene import Scene, Setting

ROUNDS = 6
CLOSE, ROUGH = 0.04, 0.25
"""Part by which the residual at a found size may miss one sigma: of an effect that is hidden, of its rivals."""


def one_sigma(scene: Scene, settings: list[Setting], close: float = CLOSE) -> list[float]:
    """Sizes at which the residual has an RMS of one sigma in the segment and signal that show it best.

    All settings are searched at once: by the chord in logarithms where a bracket is missing, then by halving.

    Returns:
        A size for each setting; infinity where not even the largest that a robot could have shows a sigma.
    """
    sizes = np.array([min(s.size, scene.largest(s)) for s in settings])
    largest = np.array([scene.largest(s) for s in settings])
    low, high = np.zeros(len(settings)), np.full(len(settings), np.inf)
    done = np.zeros(len(settings), dtype=bool)
    base = scene.respond([()])[0]
    for _ in range(ROUNDS):
        open_ = np.flatnonzero(~done)
        if len(open_) == 0:
            break
        responses = scene.respond([(settings[i].sized(sizes[i]),) for i in open_])
        for i, response in zip(open_, responses, strict=True):
            shown = best_rms(scene, response - base, settings[i].where)
            if abs(shown - 1) < close:
                done[i] = True
                continue
            low[i], high[i] = (sizes[i], high[i]) if shown < 1 else (low[i], sizes[i])
            if low[i] >= 0.999 * largest[i]:
                sizes[i], done[i] = np.inf, True
                continue
            chord = sizes[i] / np.clip(shown, 0.02, 50.0)
            inside = low[i] * 1.02 < chord < high[i] * 0.98
            halved = np.sqrt(max(low[i], 1e-3 * high[i]) * high[i]) if np.isfinite(high[i]) else 4 * sizes[i]
            sizes[i] = min(chord if inside else halved, largest[i])
    return [float(size) for size in sizes]


def best_rms(scene: Scene, residual: Floats, where: tuple[str, ...]) -> float:
    """RMS of a residual in the segment and signal in which it is largest, over the places that have the effect."""
    there = np.isin(scene.places, where)
    count = np.bincount(scene.group[there])
    power = np.bincount(scene.group[there], weights=np.minimum(np.nan_to_num(residual[there], nan=1e6), 1e6) ** 2)
    return float(np.sqrt((power[count > 0] / count[count > 0]).max()))


def signatures(scene: Scene, settings: list[Setting]) -> Floats:
    """Unit vectors along which the residual moves when an effect sets in; shape (settings, m)."""
    base = scene.respond([()])[0]
    responses = scene.respond([(setting,) for setting in settings])
    moved = np.nan_to_num(np.clip(responses - base, -1e4, 1e4))
    length = np.linalg.norm(moved, axis=1, keepdims=True)
    return np.asarray(moved / np.where(length > 0, length, 1.0))


def nearest(own: Floats, rivals: Floats, beside: Floats | None = None) -> Floats:
    """|cos| between a signature and each rival's, with the span of `beside`, shape (k, m), projected out."""
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
