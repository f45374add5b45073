"""`certify_stability`: a proof that an orbit is stable, or that it is not, from its linearised equations in balls.

The equations linearised about a proved orbit: an enclosure of their coefficients, symmetric where forces are.

lambda v'' = G(theta) v with G = Dphi(q) = sum over p of G_p exp(i p theta), p even where the orbit's harmonics are odd,
G_-p = G_p real. The orbit itself is known within a radius of the centre, which moves every G_p and lambda: `radius` and
`square` hold that too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.certify import balls
from casadi_skin.certify.balls import SUM_ROUNDING_FACTOR, Enclosed, above, acb, acb_poly, arb, ball, below, rounded_up
from casadi_skin.certify.bounds import Operator, curvature, proved_radius, series_norms
from casadi_skin.certify.certificate import STABLE, UNDECIDED, UNSTABLE, Constants, ProvedStability
from casadi_skin.certify.certify import HARMONIC_WEIGHT, best_attempt, reason_of
from casadi_skin.certify.system import CosineSeries, CosineSystem, potential, weights_of
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Orbit
from casadi_skin.model.result import in_turn
from casadi_skin.solve.watch import one_thread
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues.diagram import StabilityEdge
from casadi_skin.zero.problem import Array


@dataclass(frozen=True, eq=False)
class Linearised:
    """Enclosures of the coefficients about the true orbit.

    Attributes:
        blocks: doubles near G_0, G_step, ..., shape (number, positions, positions).
        radius: bound of the norm of the difference of G and the true one: largest sum over rows and p of moduli in a
            column; where symmetric, of the norm in the Euclidean sense at every theta as well.
        square: ball of lambda.
        symmetric: whether blocks and truth are symmetric matrices.
        step: of p and of the harmonics of solutions, 2 or 1.
        exact: by row and column balls of the entries of G_0, G_step, ... about the orbit's centre.
        moved: the part of `radius` that is the orbit's own.
    """

    blocks: Array
    radius: float
    square: arb
    symmetric: bool
    step: int = 2
    exact: Mapping[tuple[int, int], Sequence[arb]] | None = None
    moved: float = 0.0

    def harmonics(self, highest: int) -> Array:
        """m from -highest to highest, multiples of the step as `highest` is."""
        return np.arange(-highest, highest + 1, self.step, dtype=float)

    def grown(self, highest: int, factor: float) -> int:
        """A multiple of the step near `factor` times another."""
        return self.step * int(np.ceil(factor * highest / self.step))

    @property
    def positions(self) -> int:
        return int(self.blocks.shape[1])

    @property
    def sizes(self) -> Array:
        """Upper bounds of the norms of the G_p, both Euclidean and by columns, without `radius`."""
        return _norms(np.abs(self.blocks))


def linearised(series: CosineSeries, nu: arb, radius: float, reach: float) -> Linearised:
    """The coefficients at the true orbit, which lies within `radius` of a series.

    In positions in which the matrices are symmetric where the linear couplings have such; `reach` is at least `radius`.
    """
    n, scale = series.system.positions, _symmetric_scale(series.system)
    symmetric = scale is not None
    scale = [arb(1)] * n if scale is None else scale
    rows = [series.derivatives(m) for m in range(n)]
    count = max((len(g) for row in rows for g in row.values()), default=1)
    exact = dict[tuple[int, int], list[arb]]()
    blocks, radii = np.zeros((count, n, n)), np.zeros((count, n, n))
    for m, row in enumerate(rows):
        for k, g in row.items():
            exact[m, k] = [value * scale[m] / scale[k] for value in g]
            enclosed = Enclosed.of(exact[m, k])
            blocks[: len(g), m, k], radii[: len(g), m, k] = enclosed.middle, enclosed.radius
    if symmetric:  # the true matrices are, so that the other triangle encloses an entry as well
        lower = np.tril(blocks) + np.tril(blocks, -1).swapaxes(1, 2)
        radii, blocks = radii + 2.0 * np.abs(lower - blocks), lower
    own = rounded_up(np.concatenate([radii[:1], 2.0 * radii[1:]]).sum(axis=0), count + 2)
    moved = (
        curvature(series.system, series_norms(series, nu), reach)
        * arb(radius)
        * arb(max(map(above, scale)))
        / arb(min(map(below, scale)))
    )
    doubt = above(arb(float(_norms(own[None])[0])) + moved)
    square = series.square + arb(0, radius)
    return Linearised(blocks, doubt, square, symmetric, series.system.step, exact, above(moved))


def _symmetric_scale(system: CosineSystem) -> list[arb] | None:
    """Factors s_n with s_n phi_n(q) the negative gradient of a potential of s_n q_n; None where there is none."""
    weights = weights_of(system.forces, 0)
    if weights is None or potential(system.forces, 0) is None:
        return None
    factors = [ball(w).sqrt() * d for w, d in zip(weights, system.scale, strict=True)]
    return [factor / factors[0] for factor in factors]


def _norms(matrices: Array) -> Array:
    """Upper bounds of the norms of matrices of numbers >= 0, Euclidean and by columns, shape (matrices,)."""
    largest = np.maximum(matrices.sum(axis=1).max(axis=1), matrices.sum(axis=2).max(axis=1))
    return rounded_up(largest, matrices.shape[1])


# An approximate exponent with its vector in more digits than doubles have, and its residual in balls ------------------


@dataclass(frozen=True, eq=False)
class Eigenpair:
    """sigma and w_m of the harmonics m = -highest, ..., highest, exact numbers; `rows` are those of each position."""

    sigma: acb
    rows: Sequence[Sequence[acb]]

    @classmethod
    def of(cls, sigma: complex, w: ComplexArray) -> Eigenpair:
        """From doubles, w of shape (harmonics, positions)."""
        return cls(_balls(np.array(sigma))[0], [_balls(column) for column in w.T])

    def moved(self, step: NDArray[Any]) -> Eigenpair:
        """Less a change of sigma and of w, in the order of harmonics."""
        first, *changes = _balls(step)
        rows = [
            [(x - d).mid() for x, d in zip(row, changes[n :: len(self.rows)], strict=True)]
            for n, row in enumerate(self.rows)
        ]
        return Eigenpair((self.sigma - first).mid(), rows)

    def doubles(self) -> tuple[complex, ComplexArray]:
        """The nearest doubles, w of shape (harmonics, positions)."""
        return complex(self.sigma), np.array([[complex(x) for x in row] for row in self.rows]).T

    def rounding(self, sigma: complex) -> arb:
        """Distance of sigma from a double."""
        return abs(self.sigma - acb(sigma.real, sigma.imag))

    def residual(self, problem: Linearised, normal: ComplexArray) -> tuple[list[acb], list[acb]]:
        """c w - 1 and the rows of the pair's harmonics, in its order, and all further rows; c of shape of w."""
        n, count = problem.positions, len(self.rows[0])
        reach = max((len(g) for g in self._coefficients(problem).values()), default=1) - 1
        vectors = [acb_poly(list(row)) for row in self.rows]
        sums = [acb_poly() for _ in range(n)]
        for (m, k), g in self._coefficients(problem).items():
            both = [*reversed(g[1:]), *g] if len(g) > 1 else list(g)
            padding = [acb(0)] * (reach + 1 - len(g))
            sums[m] += acb_poly([*padding, *both]) * vectors[k]
        first = sum((c * x for c, x in zip(_balls(normal.T), chain(*self.rows), strict=True)), acb(-1))
        highest = problem.step * (count - 1) // 2
        squares = [problem.square * (self.sigma + h) ** 2 for h in range(-highest, highest + 1, problem.step)]
        finite, outside = [], list[acb]()
        for total, row in zip(sums, self.rows, strict=True):
            values = [total[i] for i in range(count + 2 * reach)]
            outside += values[:reach] + values[reach + count :]
            own = zip(values[reach : reach + count], squares, row, strict=True)
            finite.append([value + square * x for value, square, x in own])
        return [first, *chain(*zip(*finite, strict=True))], outside

    @staticmethod
    def _coefficients(problem: Linearised) -> Mapping[tuple[int, int], Sequence[arb]]:
        """The entries of G in balls: those about the orbit's centre, or the doubles where there is no orbit."""
        if problem.exact is not None:
            return problem.exact
        n = problem.positions
        return {(m, k): [arb(g) for g in problem.blocks[:, m, k].tolist()] for m in range(n) for k in range(n)}


# One Floquet exponent and its vector, enclosed by the theorem of the orbits: off the real axis there is no stability

MOST_EXPONENT_ROWS = 2500  # rows of the finite part
FIRST_EXPONENT_CUT = 8
RADIUS_GROWTH = 1.5
EXPONENT_STEPS = 8
LARGEST_RADIUS = 0.1  # largest radius that W is a bound for; 1 is the norm of w in the Euclidean sense


def enclosed_exponent(problem: Linearised, sigma: complex) -> tuple[complex, float] | None:
    """An exponent near `sigma` with a proved radius; None where no finite part proves one."""
    highest, last = FIRST_EXPONENT_CUT, Constants(np.inf, np.inf, np.inf, LARGEST_RADIUS)
    while problem.harmonics(highest).size * problem.positions <= MOST_EXPONENT_ROWS:
        pair = _Pair.near(problem, sigma, highest)
        if pair is not None:
            constants = pair.constants()
            radius = proved_radius(constants)
            if radius is not None:
                return pair.sigma, above(pair.exact.rounding(pair.sigma) + radius)
            small = constants.Z < 0.5
            if (0.5 * last.Y < constants.Y) if small else (0.8 * last.Z < constants.Z):
                return None  # it is rounding, or another exponent is too near
            last = constants if small else replace(constants, Y=np.inf)
        highest = problem.grown(highest, RADIUS_GROWTH)
    return None


@dataclass(frozen=True, eq=False)
class _Pair:
    """An approximate eigenpair with |m| <= highest, and the bounds of the theorem about it."""

    problem: Linearised
    highest: int
    exact: Eigenpair
    sigma: complex  # the double nearest
    w: ComplexArray  # doubles nearest, shape (harmonics, positions)
    inverse: NDArray[Any]

    @classmethod
    def near(cls, problem: Linearised, sigma: complex, highest: int) -> _Pair | None:
        """Newton's method from the null vector of the finite part; None where its matrices are singular."""
        G, square = _toeplitz(problem, highest, highest), float(problem.square.mid())
        m = problem.harmonics(highest)
        try:
            L = G + np.diag(np.repeat(square * (sigma + m) ** 2, problem.positions))
            w, last = np.linalg.svd(L)[2][-1].conj(), np.inf
            pair = Eigenpair.of(sigma, w.reshape(-1, problem.positions))
            for _ in range(EXPONENT_STEPS):
                sigma, w = pair.doubles()
                J, _ = _bordered(G, square, sigma, w.ravel(), m, w.ravel().conj())
                residual = np.array([complex(value.mid()) for value in pair.residual(problem, w.conj())[0]])
                step = np.linalg.solve(J, residual)
                size = float(np.sum(np.abs(step)))
                if not size < 0.5 * last:
                    break
                last, pair = size, pair.moved(step)
            inverse = np.linalg.inv(J)
        except np.linalg.LinAlgError:
            return None
        if not (np.isfinite(sigma) and np.all(np.isfinite(inverse))):
            return None
        return cls(problem, highest, pair, *pair.doubles(), inverse)

    @cached_property
    def shifts(self) -> ComplexArray:
        """sigma + m for each finite unknown of w."""
        return np.repeat(self.sigma + self.problem.harmonics(self.highest), self.problem.positions)

    @cached_property
    def operator(self) -> Operator:
        """A on the finite part."""
        return Operator(self.inverse, np.ones(len(self.inverse)))

    @cached_property
    def tail(self) -> float:
        """Upper bound of 1/|lambda (sigma + m)^2| beyond the finite part."""
        nearest = self.highest + self.problem.step - abs(self.sigma)
        return (
            float("inf")
            if nearest <= 0
            else (1.0 + 16 * SUM_ROUNDING_FACTOR) / (below(self.problem.square) * nearest**2)
        )

    @cached_property
    def size(self) -> float:
        """Upper bound of |A| on residuals but the first."""
        return max(float(np.max(self.operator.norms[1:])), self.tail)

    def finite_part(self, G: Array, square: float) -> tuple[ComplexArray, Array]:
        """The finite part of DF in doubles, and bounds of its rounding."""
        w = self.w.ravel()
        J, _ = _bordered(G, square, self.sigma, w, self.problem.harmonics(self.highest), w.conj())
        unsure = 16 * SUM_ROUNDING_FACTOR * np.abs(J)
        places = np.arange(1, len(J))  # of sums of G_0 and of what may be much larger than they are
        unsure[places, places] += 32 * SUM_ROUNDING_FACTOR * square * np.abs(self.shifts**2)
        return J, unsure

    def constants(self) -> Constants:
        """The three bounds about the true linearised equations."""
        if not np.isfinite(self.tail):
            return Constants(np.inf, np.inf, np.inf, LARGEST_RADIUS)
        return Constants(self._Y(), self._Z(), self._W(), LARGEST_RADIUS)

    def _Y(self) -> float:
        """Upper bound of |A F|."""
        problem, n, total = self.problem, self.problem.positions, len(self.inverse)
        finite, outside = self.exact.residual(problem, self.w.conj())
        middle = np.array([complex(value.mid()) for value in finite])
        radius = np.array([above(abs(value - m)) for value, m in zip(finite, _balls(middle), strict=True)])
        image = self.operator.image(slice(None), Enclosed(middle[:, None], radius[:, None]))[0]
        beyond = sum(above(abs(value)) for value in outside)
        length = float(rounded_up(np.abs(self.w).sum(), self.w.size + 4))
        return float(rounded_up(np.asarray(image + self.tail * beyond + self.size * problem.moved * length), total + n))

    @cached_property
    def _doubt(self) -> float:
        """Upper bound of the distance of lambda from the double in its middle."""
        return above(abs(self.problem.square - arb(float(self.problem.square.mid()))))

    def _Z(self) -> float:
        """Upper bound of |I - A DF|."""
        problem, w = self.problem, self.w.ravel()
        square = float(problem.square.mid())
        J, unsure = self.finite_part(_toeplitz(problem, self.highest, self.highest), square)
        inside = self.operator.image(slice(None), Enclosed(J, unsure), np.eye(len(J)))
        outer = _beyond(problem, self.highest)
        across = self.operator.image(slice(1, None), Enclosed(outer, np.zeros(outer.shape)))
        sizes = problem.sizes
        rows = self.tail * float(rounded_up(sizes[0] + 2.0 * sizes[1:].sum(), sizes.size))
        squares = max(float(np.max(self.operator.norms[1:] * np.abs(self.shifts) ** 2)), 1.0 / below(problem.square))
        along = self.size * float(rounded_up(2.0 * np.abs(self.shifts * w).sum(), w.size))
        moved = problem.radius * self.size + self._doubt * max(squares, along)
        return float(rounded_up(np.asarray(max(np.max(inside), np.max(across, initial=0.0)) + rows + moved), 32))

    def _W(self) -> float:
        """Lipschitz constant of A DF within REACH."""
        length = float(rounded_up(np.abs(self.w).sum(), self.w.size))
        beyond = np.sqrt(self.tail / below(self.problem.square)) * (1.0 + 8 * SUM_ROUNDING_FACTOR)
        linear = max(float(np.max(self.operator.norms[1:] * np.abs(self.shifts))), float(beyond))
        total = above(self.problem.square) * (
            2.0 * linear + self.size * (LARGEST_RADIUS + 2.0 * (length + LARGEST_RADIUS))
        )
        return float(rounded_up(np.asarray(total), 32))


def _balls(values: NDArray[Any]) -> list[acb]:
    return [acb(value.real, value.imag) for value in values.ravel().tolist()]


def _toeplitz(problem: Linearised, highest_row: int, highest_column: int) -> Array:
    """The blocks G_(m - j) for |m| and |j| up to two numbers."""
    blocks, n = problem.blocks, problem.positions
    rows, columns = problem.harmonics(highest_row), problem.harmonics(highest_column)
    distance = np.abs(rows[:, None] - columns).astype(int) // problem.step
    padded = np.concatenate([blocks, np.zeros((1, n, n))])
    matrix = padded[np.minimum(distance, len(blocks))]
    return np.asarray(matrix.transpose(0, 2, 1, 3).reshape(rows.size * n, columns.size * n))


def _beyond(problem: Linearised, highest: int) -> Array:
    """The columns of the next harmonics on either side that rows |m| <= highest have entries in."""
    edge = (len(problem.blocks) - 1) * problem.positions
    wide = _toeplitz(problem, highest, highest + problem.step * (len(problem.blocks) - 1))
    return np.delete(wide, slice(edge, wide.shape[1] - edge), axis=1)


def _bordered(
    G: Array, square: float, sigma: complex, w: ComplexArray, harmonics: Array, c: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """The finite part of DF and of F at (sigma, w)."""
    shifts = np.repeat(sigma + harmonics, w.size // harmonics.size)
    J = np.zeros((w.size + 1, w.size + 1), dtype=complex)
    J[0, 1:], J[1:, 0] = c, 2.0 * square * shifts * w
    J[1:, 1:] = G + np.diag(square * shifts**2)
    return J, np.concatenate([[c @ w - 1.0], J[1:, 1:] @ w])


# Numbers of negative eigenvalues of L(sigma), proved; each change of them between two sigma is an exponent ------------

MOST_INERTIA_ROWS = 4000  # rows of the finite part
FIRST_INERTIA_CUT = 4  # highest harmonic of the smallest finite part


def negative_eigenvalues(problem: Linearised, sigma: float) -> int | None:
    """Number of negative eigenvalues of L(sigma); None where no finite part of up to MOST_INERTIA_ROWS rows decides."""
    highest = FIRST_INERTIA_CUT
    while problem.harmonics(highest).size * problem.positions <= MOST_INERTIA_ROWS:
        found, helps = _count(problem, sigma, highest)
        if found is not None or not helps:
            return found
        highest = problem.grown(highest, RADIUS_GROWTH)
    return None


def _count(problem: Linearised, sigma: float, highest: int) -> tuple[int | None, bool]:
    """The same from the harmonics |m| <= highest, and whether more of them may help where it is None.

    By Schur's complement L has the inertia of M - B T^-1 B^T where the tail's T >= t > 0, and 0 <= B T^-1 B^T <=
    B B^T/t <= diag(beta)/t, beta being sums of norms along the rows of B B^T.
    """
    harmonics = problem.harmonics(highest)
    sizes, n = problem.sizes, problem.positions
    total = float(sizes[0] + 2.0 * sizes[1:].sum()) * (1.0 + sizes.size * SUM_ROUNDING_FACTOR)
    nearest = arb(highest + problem.step) - abs(arb(sigma))
    floor = below(problem.square * nearest**2 - arb(total) - arb(problem.radius))
    if not floor > 0.0:
        return None, True
    kinetic = Enclosed.of([problem.square * (arb(sigma) + int(m)) ** 2 for m in harmonics.tolist()])
    matrix = _toeplitz(problem, highest, highest)
    diagonal = np.einsum("ii->i", matrix)
    diagonal += np.repeat(kinetic.middle, n)
    norms = _beyond(replace(problem, blocks=sizes[:, None, None]), highest)
    coupling = rounded_up(norms @ rounded_up(norms.sum(axis=0), len(norms)), norms.shape[1])
    through_tail = np.repeat(coupling / floor, n)
    slack = np.repeat(kinetic.radius + problem.radius, n) + np.abs(diagonal) * SUM_ROUNDING_FACTOR
    return _inertia(matrix, slack, through_tail)


def _inertia(matrix: Array, slack: Array, through_tail: Array) -> tuple[int | None, bool]:
    """Negative eigenvalues of every symmetric matrix that differs by a diagonal of moduli <= slack + through_tail.

    With W = V |d|^-1/2 of computed eigenvectors W^T (matrix + change) W is within 1 of a diagonal of signs: Sylvester's
    law, and a perturbation of norm below 1 moves no eigenvalue through 0. The change is at most its trace. Without a
    number also whether a smaller `through_tail` would give one.
    """
    values, vectors = np.linalg.eigh(matrix)
    if not np.all(np.abs(values) > 0.0):
        return None, False
    W = vectors / np.sqrt(np.abs(values))
    error = np.abs(W.T @ (matrix @ W) - np.diag(np.sign(values)))
    n, moduli, squares = len(matrix), np.abs(W), (W**2).sum(axis=1)
    rounding = moduli.T @ (np.abs(matrix) @ moduli.sum(axis=1)) * (2 * n + 4) * SUM_ROUNDING_FACTOR
    own = max(float(np.max(error.sum(axis=0))), float(np.max(error.sum(axis=1)))) + 2.0 * float(np.max(rounding))
    fixed, tail = own + float(slack @ squares), float(through_tail @ squares)
    proved = float(rounded_up(np.array(fixed + tail), n + 4)) < 1.0
    return (int(np.sum(values < 0.0)) if proved else None), fixed < 0.9


# The proofs -----------------------------------------------------------------------------------------------------------

NEAREST_TO_CHANGE = 1e-8  # relative distance from a change at which proofs are tried first
DISTANCE_GROWTH = 10.0
TWO_PI = 2.0 * np.pi
EXPONENTS_TRIED = 3  # exponents farthest from the axis


@in_turn
def certify_stability(orbit: Orbit) -> ProvedStability:
    """Prove that an orbit is stable, or that it is unstable, to small disturbances of any symmetry.

    Arguments:
        orbit: an orbit that `certify` accepts.

    Returns:
        The verdict with what proves it; "not decided" where exponents are too near to each other or to those of q',
        as at the edges of tongues, or where the orbit itself is not proved.

    Raises:
        ValueError: the model has no such forces or the orbit no such symmetry, in one line.
        ImportError: python-flint (the extra "certify") is missing.
    """
    flint = balls.flint()
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS), one_thread():
        family, attempt = best_attempt(orbit)
        if not attempt.proved:
            return _undecided(orbit, f"the orbit is not proved: {reason_of(attempt)}")
        if attempt.series.system.tail is not None:
            return _undecided(orbit, "the multipliers of a chain with a tail that is no unknown are not enclosed")
        problem = linearised(attempt.series, flint.arb(HARMONIC_WEIGHT), attempt.radius, attempt.constants.reach)
        floquet = orbit.floquet()
        if family.coordinates.mode.size != floquet.mu.size + 1:
            return _undecided(orbit, "its multipliers were not computed from the whole lattice's reversal")
        if floquet.stable:
            angles = np.arccos(np.clip(1.0 + 2.0 * floquet.mu.real, -1.0, 1.0))
            return _stable(orbit, problem, np.sort(angles) * problem.step / TWO_PI)
        return _unstable(orbit, problem, floquet.mu)


@in_turn
def certify_change(branch: Branch, change: StabilityEdge) -> tuple[float, float] | None:
    """Prove that a family changes its stability between two values of S, as near to a change as proofs separate them.

    Arguments:
        branch: a family of a model that `certify` accepts.
        change: one of `branch.changes`.

    Returns:
        S on either side, in ascending order, proved stable at one and unstable at the other; None where no pair out to
        a quarter of the tongue's width is. That both lie on one curve of orbits is what `certify_branch` proves.

    Raises:
        ValueError, ImportError: as `certify`.
    """
    distance = max(NEAREST_TO_CHANGE * change.S, 2.0 * change.error)
    while distance <= max(0.25 * change.width, 2.0 * NEAREST_TO_CHANGE * change.S):
        ends = change.S - distance, change.S + distance
        verdicts = {branch.at(S=S).proved_stability.verdict for S in ends}
        if verdicts == {STABLE, UNSTABLE}:
            return ends
        distance *= DISTANCE_GROWTH
    return None


def _undecided(orbit: Orbit, reason: str) -> ProvedStability:
    nothing = complex(np.nan, np.nan)
    return ProvedStability(UNDECIDED, np.zeros((0, 2)), np.zeros(0, np.int64), nothing, np.nan, orbit.S, reason)


def _stable(orbit: Orbit, problem: Linearised, sigma: Array) -> ProvedStability:
    """Numbers of negative eigenvalues between exponents: as many changes as there are pairs leave none elsewhere."""
    if not problem.symmetric:
        return _undecided(orbit, "the equations are reversible only: no signatures hold multipliers on the circle")
    ends = np.concatenate([[0.0], sigma, [0.5 * problem.step]])
    between = 0.5 * (ends[:-1] + ends[1:])
    counts = []
    for place, low, high in zip(between.tolist(), ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        count = negative_eigenvalues(problem, place)
        if count is None:
            return _undecided(orbit, f"exponents at sigma = {low:.9g} and {high:.9g} are too near to be separated")
        counts.append(count)
    changes = np.diff(counts)
    if not np.all(changes % 2):
        low, high = between[np.flatnonzero(changes % 2 == 0)[0] :][:2].tolist()
        return _undecided(orbit, f"no exponent is proved between sigma = {low:.9g} and {high:.9g}")
    brackets = np.stack([between[:-1], between[1:]], axis=1)
    signatures = -np.sign(changes).astype(np.int64)
    stable = replace(_undecided(orbit, ""), verdict=STABLE, step=problem.step)
    return replace(stable, brackets=brackets, signatures=signatures)


def _unstable(orbit: Orbit, problem: Linearised, mu: ComplexArray) -> ProvedStability:
    """An enclosure off the real axis of one of the exponents that are farthest from it."""
    root = np.sqrt(mu) + np.sqrt(1.0 + mu)  # sigma of exp(i sigma theta) over theta = 2 pi/step, one of each pair
    sigma = np.log(np.where(np.abs(root) < 1.0, 1.0 / root, root) ** 2) * problem.step / (1j * TWO_PI)
    order = np.argsort(-np.abs(sigma.imag))[:EXPONENTS_TRIED]
    for start in sigma[order].tolist():
        found = enclosed_exponent(problem, start)
        if found is not None and abs(found[0].imag) > found[1]:
            unstable = replace(_undecided(orbit, ""), verdict=UNSTABLE, step=problem.step)
            return replace(unstable, exponent=found[0], radius=found[1])
    farthest = complex(sigma[order[0]])
    return _undecided(orbit, f"no enclosure of the exponent near sigma = {farthest:.6g} is off the real axis")
