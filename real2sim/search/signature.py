"""Signatures: the changes that effects make in the residuals of a log,
and which of them are alike.
"""

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.search.findings import EffectConfusion
from saltus.real2sim.search.quadratic import QuadraticCost
from saltus.real2sim.search.unknowns_layout import ModelEffects, UnknownsLayout

TRACE = 1e-9
"""Smallest share of a signature's power after projection; less is rounding."""


def confusion(
    layout: UnknownsLayout, library: QuadraticCost, named: ModelEffects
) -> EffectConfusion:
    """Cosines of all pairs of effects.

    The signature of an effect at a place is the change that its unknowns make in the residuals (at
    the fitted values if it is `named`), with nuisances and the other named effects projected out.
    Places count by the power of the signature. `library` holds the derivatives by the unknowns of
    all effects.
    """
    effects, signatures = layout.effects, _Signatures(layout, library, named)
    cosine = np.eye(len(effects))
    for i, a in enumerate(effects):
        for j, b in enumerate(effects[:i]):
            forth, back = signatures.alignment(a, b), signatures.alignment(b, a)
            cosine[i, j] = cosine[j, i] = min(1.0, float(np.sqrt(max(0.0, 0.5 * (forth + back)))))
    return EffectConfusion(effects=effects, cosine=cosine)


class _Signatures:
    """Signatures of effects; matrices that many pairs of effects share are computed once."""

    def __init__(self, layout: UnknownsLayout, library: QuadraticCost, named: ModelEffects) -> None:
        self._layout, self._library, self._named = layout, library, named
        scale = layout.scale[library.columns]
        self._points = library.point / scale
        self._hessians = [
            library.information(block) * np.outer(scale, scale)
            for block in range(len(library.cost))
        ]
        self._columns = [
            np.flatnonzero(layout.candidate[library.columns] == k)
            for k in range(len(layout.candidates))
        ]
        self._inverses: dict[tuple[int, bytes], Floats] = {}

    def alignment(self, a: str, b: str) -> float:
        """Squared cosine of the signature of `a` with the span of `b`, averaged over places."""
        others = self._layout.of_effects(set(self._named) - {a, b})
        removed = np.flatnonzero(
            self._library.where(np.concatenate([self._layout.nuisances, others]))
        )
        is_shape = self._layout.is_shape[self._library.columns]
        power = shared = 0.0
        for block, hessian in enumerate(self._hessians):
            inverse = self._inverse(block, removed)
            for candidate, own in zip(self._layout.candidates, self._columns, strict=True):
                if candidate.effect != a:
                    continue
                places = [
                    columns
                    for other, columns in zip(self._layout.candidates, self._columns, strict=True)
                    if other.effect == b and other.where == candidate.where
                ]
                theirs = np.sort(np.concatenate([np.zeros(0, dtype=np.intp), *places]))
                mine = own[~is_shape[own]]
                here, both = _project(hessian, mine, theirs, removed, inverse, self._points[block])
                power, shared = power + here, shared + both
        return shared / power if power > 0.0 else 0.0

    def _inverse(self, block: int, removed: Indices) -> Floats:
        """Inverse of the information on the removed columns, which are the same for most pairs."""
        key = block, removed.tobytes()
        if key not in self._inverses:
            part = self._hessians[block][np.ix_(removed, removed)]
            self._inverses[key] = np.asarray(np.linalg.pinv(part, rcond=1e-10, hermitian=True))
        return self._inverses[key]


def _project(
    hessian: Floats,
    mine: Indices,
    theirs: Indices,
    removed: Indices,
    inverse: Floats,
    point: Floats,
) -> tuple[float, float]:
    """Power of a signature and of its projection on a span, with the removed columns projected out.

    `inverse` is that of the information on the removed columns.
    """
    keep = np.concatenate([mine, theirs])
    gram = hessian[np.ix_(keep, keep)]
    if len(removed):
        cross = hessian[np.ix_(keep, removed)]
        gram = gram - cross @ inverse @ cross.T
    k = len(mine)
    own, span, cross = gram[:k, :k], gram[k:, k:], gram[:k, k:]
    original = float(np.trace(hessian[np.ix_(mine, mine)]))
    shadow = (
        cross @ np.linalg.pinv(span, rcond=1e-10, hermitian=True) @ cross.T
        if len(theirs)
        else np.zeros((k, k))
    )
    value = point[mine]
    if np.any(value != 0.0):
        here, both = float(value @ own @ value), float(value @ shadow @ value)
    else:
        here, both = float(np.trace(own)), float(np.trace(shadow))
    return (here, both) if np.trace(own) > TRACE * original else (0.0, 0.0)
