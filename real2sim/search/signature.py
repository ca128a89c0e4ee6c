"""Signatures: the changes that effects make in the residuals of a log, and which of them are alike."""

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.search.findings import Confusion
from saltus.real2sim.search.layout import Layout, Model
from saltus.real2sim.search.quadratic import Quadratic

TRACE = 1e-9
"""Smallest share of a signature's power after projection; less is rounding."""


def confusion(layout: Layout, library: Quadratic, named: Model) -> Confusion:
    """Cosines of all pairs of effects.

    The signature of an effect at a place is the change that its unknowns make in the residuals (at the fitted values if
    it is `named`), with nuisances and the other named effects projected out. Places count by the power of the
    signature. `library` holds the derivatives by the unknowns of all effects.
    """
    effects = layout.effects
    cosine = np.eye(len(effects))
    for i, a in enumerate(effects):
        for j, b in enumerate(effects[:i]):
            forth, back = _alignment(layout, library, named, a, b), _alignment(layout, library, named, b, a)
            cosine[i, j] = cosine[j, i] = min(1.0, float(np.sqrt(max(0.0, 0.5 * (forth + back)))))
    return Confusion(effects=effects, cosine=cosine)


def _alignment(layout: Layout, library: Quadratic, named: Model, a: str, b: str) -> float:
    """Squared cosine of the signature of `a` with the span of `b`, averaged over places."""
    others = layout.of_effects(set(named) - {a, b})
    removed = np.flatnonzero(library.where(np.concatenate([layout.nuisances, others])))
    scale = layout.scale[library.columns]
    power = shared = 0.0
    for block in range(len(library.cost)):
        hessian = library.information(block) * np.outer(scale, scale)
        for index, candidate in enumerate(layout.candidates):
            if candidate.effect != a:
                continue
            mine = _columns(layout, library, [index])
            mine = mine[~layout.is_shape[library.columns[mine]]]
            place = [k for k, c in enumerate(layout.candidates) if c.effect == b and c.where == candidate.where]
            theirs = _columns(layout, library, place)
            here, both = _project(hessian, mine, theirs, removed, library.point[block] / scale)
            power, shared = power + here, shared + both
    return shared / power if power > 0.0 else 0.0


def _columns(layout: Layout, library: Quadratic, candidates: list[int]) -> Indices:
    return np.flatnonzero(np.isin(layout.candidate[library.columns], candidates))


def _project(hessian: Floats, mine: Indices, theirs: Indices, removed: Indices, point: Floats) -> tuple[float, float]:
    """Power of a signature and of its projection on a span, with the removed columns projected out."""
    keep = np.concatenate([mine, theirs])
    gram = hessian[np.ix_(keep, keep)]
    if len(removed):
        cross = hessian[np.ix_(keep, removed)]
        gram = gram - cross @ np.linalg.pinv(hessian[np.ix_(removed, removed)], rcond=1e-10, hermitian=True) @ cross.T
    k = len(mine)
    own, span, cross = gram[:k, :k], gram[k:, k:], gram[:k, k:]
    original = float(np.trace(hessian[np.ix_(mine, mine)]))
    shadow = cross @ np.linalg.pinv(span, rcond=1e-10, hermitian=True) @ cross.T if len(theirs) else np.zeros((k, k))
    value = point[mine]
    if np.any(value != 0.0):
        here, both = float(value @ own @ value), float(value @ shadow @ value)
    else:
        here, both = float(np.trace(own)), float(np.trace(shadow))
    return (here, both) if np.trace(own) > TRACE * original else (0.0, 0.0)
