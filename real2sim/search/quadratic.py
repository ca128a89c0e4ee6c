"""A quadratic approximation of the cost around a point,
for each short chunk of the log, and its scatter.

With residuals r and Jacobian J at a point, |r + J d|^2 is the cost of the unknowns at the point
plus d. Sums over chunks say without simulation which other models would fit, and their gain on
held-out data with its scatter, also where residuals are not perfectly white.
"""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.search.residual_split import TEST, Mask, ResidualSplit
from saltus.real2sim.search.unknowns_layout import UnknownsLayout


@dataclass(frozen=True, kw_only=True, eq=False)
class QuadraticCost:
    """Quadratic approximation of a problem's cost around a point, chunk by chunk of the log.

    Attributes:
        columns: Unknowns with known derivatives, ascending, shape (k,).
        point: Point of the approximation, shape (blocks, k).
        low: Bounds of the unknowns, shape (k,).
        high: Bounds of the unknowns, shape (k,).
        hessian: J^T J, shape (blocks, chunks, k, k).
        gradient: J^T r, shape (blocks, chunks, k).
        cost: |r|^2, shape (blocks, chunks).
        split: Chunks and folds.
    """

    columns: Indices
    point: Floats
    low: Floats
    high: Floats
    hessian: Floats
    gradient: Floats
    cost: Floats
    split: ResidualSplit

    @classmethod
    def of(
        cls,
        layout: UnknownsLayout,
        split: ResidualSplit,
        columns: Indices,
        point: Floats,
        residuals: Floats,
        jacobian: Floats,
    ) -> "QuadraticCost":
        """The quadratic approximation from residuals and their Jacobian.

        Args:
            layout: Bounds.
            split: Chunks.
            columns: Unknowns with derivatives, shape (k,).
            point: All unknowns, shape (blocks, unknowns).
            residuals: At the point, shape (blocks, m).
            jacobian: Shape (blocks, k, m).
        """
        blocks, k, _ = jacobian.shape
        chunks = len(split.fold)
        hessian, gradient = np.zeros((blocks, chunks, k, k)), np.zeros((blocks, chunks, k))
        cost = np.zeros((blocks, chunks))
        for chunk in range(chunks):
            rows = np.flatnonzero(split.chunk == chunk)
            part, r = jacobian[:, :, rows], residuals[:, rows]
            hessian[:, chunk] = part @ part.transpose(0, 2, 1)
            gradient[:, chunk] = np.einsum("bkm,bm->bk", part, r)
            cost[:, chunk] = np.sum(r**2, axis=1)
        return cls(
            columns=columns,
            point=point[:, columns],
            low=layout.low[columns],
            high=layout.high[columns],
            hessian=hessian,
            gradient=gradient,
            cost=cost,
            split=split,
        )

    def where(self, columns: Indices) -> Mask:
        """Mask of its columns that are among these, shape (k,)."""
        return np.isin(self.columns, columns)

    def solve(self, block: int, free: Mask, held_out: int | None = None) -> Floats:
        """Best change of a block's unknowns in the mask `free`,
        shape (k,), within their bounds; the others go to 0.

        The fit does not see the fold `held_out`, nor the test.
        """
        seen = (self.split.fold != TEST) & (
            self.split.fold != (TEST if held_out is None else held_out)
        )
        hessian, gradient = (
            self.hessian[block, seen].sum(axis=0),
            self.gradient[block, seen].sum(axis=0),
        )
        if held_out is not None:
            hessian = hessian + LEAN * np.diag(np.diag(self.information(block)))
        change = np.where(free, 0.0, -self.point[block])
        active = np.flatnonzero(free)
        change[active] = bounded_minimum(
            hessian[np.ix_(active, active)],
            (gradient + hessian @ change)[active],
            (self.low - self.point[block])[active],
            (self.high - self.point[block])[active],
        )
        return change

    def cost_after(self, block: int, change: Floats) -> Floats:
        """Cost in each chunk after a change of the unknowns, shape (chunks,)."""
        linear = 2.0 * self.gradient[block] @ change
        return (
            self.cost[block] + linear + np.einsum("i,cij,j->c", change, self.hessian[block], change)
        )

    def held_out_cost(self, free: Mask) -> Floats:
        """Cost of every chunk in a fit without its fold, shape (blocks, chunks);
        no fit sees test chunks.
        """
        cost = np.zeros_like(self.cost)
        for block in range(len(self.cost)):
            unseen = self.split.fold == TEST
            cost[block, unseen] = self.cost_after(block, self.solve(block, free))[unseen]
            for fold in self.split.folds:
                rows = self.split.fold == fold
                cost[block, rows] = self.cost_after(block, self.solve(block, free, fold))[rows]
        return cost

    def fit_cost(self, free: Mask) -> float:
        """Cost of all blocks outside the test after a fit of the free unknowns."""
        seen = self.split.fold != TEST
        blocks = range(len(self.cost))
        return float(
            sum(self.cost_after(block, self.solve(block, free))[seen].sum() for block in blocks)
        )

    def information(self, block: int) -> Floats:
        """Sum of the Hessians outside the test, shape (k, k)."""
        seen = self.split.fold != TEST
        return np.asarray(self.hessian[block, seen].sum(axis=0))


LEAN = 0.05
"""Share of the whole fit's information that is added in fits without one fold. Unknowns that only
that fold shows then stay where they are, instead of moving to where the quadratic is
meaningless."""
RIDGE = 1e-9
"""Ridge relative to the diagonal: keeps unknowns without influence where they are."""


def bounded_minimum(hessian: Floats, gradient: Floats, low: Floats, high: Floats) -> Floats:
    """Minimum of g.d + d.H d / 2 with low <= d <= high.

    Unknowns that would leave their bounds are fixed there one by one, the worst first. This finds
    the minimum unless unknowns are nearly collinear, where any point near it is as good.
    """
    k = len(gradient)
    size = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    dead = np.diag(hessian) <= 1e-12 * max(float(np.diag(hessian).max(initial=0.0)), 1e-300)
    scaled = hessian / np.outer(size, size) + RIDGE * np.eye(k)
    slope, lower, upper = gradient / size, low * size, high * size
    fixed = dead.copy()
    value = np.zeros(k)
    for _ in range(2 * k + 1):
        free = ~fixed
        if not free.any():
            break
        right = -(slope + scaled[:, fixed] @ value[fixed])[free]
        value[free] = np.linalg.solve(scaled[np.ix_(free, free)], right)
        excess = np.where(free, np.maximum(lower - value, value - upper), 0.0)
        worst = int(np.argmax(excess))
        if excess[worst] <= 1e-12 * max(1.0, abs(value[worst])):
            break
        value[worst] = np.clip(value[worst], lower[worst], upper[worst])
        fixed[worst] = True
    return value / size


RESAMPLES = 400
"""With this number the 5 and 95 % quantiles scatter by about a tenth of the standard deviation."""


def held_out_gains(before: Floats, after: Floats, split: ResidualSplit) -> Floats:
    """Gain [nats] of each chunk outside the test, from costs of shape (blocks, chunks)."""
    return np.asarray(0.5 * (before - after).sum(axis=0)[split.fold != TEST])


def gains_spread(gains: Floats, rng: np.random.Generator) -> tuple[float, tuple[float, float]]:
    """Standard deviation and 90 % interval of the sum of gains,
    from chunks drawn with replacement.
    """
    draws = rng.integers(len(gains), size=(RESAMPLES, len(gains)))
    totals = gains[draws].sum(axis=1)
    low, high = np.quantile(totals, (0.05, 0.95))
    return float(totals.std()), (float(low), float(high))


def gains_downside(gains: Floats) -> float:
    """Standard deviation of the sum of gains, estimated from the losses.

    A true effect may show in a few chunks only: gains then scatter although their sum is certain. A
    sum is uncertain if many chunks contribute losses; if everything were chance, losses would make
    half of the scatter.
    """
    return float(np.sqrt(2.0 * np.sum(np.minimum(gains, 0.0) ** 2)))


def unknowns_covariance(quadratic: QuadraticCost, block: int, free: Mask) -> Floats:
    """Covariance of the fitted unknowns for residuals of any colour,
    shape (k, k); 0 where not free.

    The sandwich estimate H^-1 (sum of g g^T over chunks) H^-1, nowhere smaller than that of white
    noise.
    """
    seen = quadratic.split.fold != TEST
    active = _known(quadratic.information(block), free)
    scores = quadratic.gradient[block][seen][:, active]
    scores = scores - scores.mean(axis=0)
    full = white_covariance(quadratic, block, free)
    own = np.ix_(active, active)
    inverse = full[own]
    sandwich = (
        inverse @ (scores.T @ scores) @ inverse * len(scores) / max(1, len(scores) - len(active))
    )
    missing = np.maximum(0.0, np.diag(inverse) - np.diag(sandwich))
    full[own] = sandwich + np.diag(missing)
    return full


def white_covariance(quadratic: QuadraticCost, block: int, free: Mask) -> Floats:
    """Covariance of the fitted unknowns for white residuals of one sigma,
    shape (k, k); 0 where not free.
    """
    hessian = quadratic.information(block)
    active = _known(hessian, free)
    own = np.ix_(active, active)
    full = np.zeros_like(hessian)
    full[own] = np.linalg.pinv(hessian[own], hermitian=True)
    return full


def score_dispersion(quadratic: QuadraticCost, free: Mask) -> float:
    """Ratio of the variance of scores to that of white noise of unit variance, at least 1.

    Gains divided by it are as those of independent samples.
    """
    seen = quadratic.split.fold != TEST
    total, count = 0.0, 0
    for block in range(len(quadratic.cost)):
        hessian = quadratic.information(block)
        active = _known(hessian, free)
        scores = quadratic.gradient[block][seen][:, active]
        scores = scores - scores.mean(axis=0)
        power = np.sum(scores**2, axis=0) / np.diag(hessian)[active]
        total, count = total + float(power.sum()), count + len(active)
    return max(1.0, total / count) if count else 1.0


def _known(hessian: Floats, free: Mask) -> Indices:
    """Free unknowns that some residual depends on."""
    diagonal = np.diag(hessian)
    return np.flatnonzero(free & (diagonal > 1e-12 * max(float(diagonal.max(initial=0.0)), 1e-300)))
