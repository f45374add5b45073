"""Periodic orbits of a program that answers with states alone: fixed points of its map, with errors and multipliers.

P(y) = y of the states y, (n,), each in units of its range along the orbit; P is known with a noise nu, as that of the
solver in the program. Newton's method has J = dP/dy by central differences with the step nu^(1/3), where their
truncation and their noise are alike; of many states J is applied along directions alone (GMRES, Arnoldi's method).
A `Returns` gives P(y) and the time that it takes, (n + 1,), and NaN where the program fails.

The orbit is solved for once more by one Newton step in each of the `others`, where the program computes the same in
another way (in shorter steps, to a smaller tolerance), and from residuals of the size of the noise: errors are twice
the largest changes. Those of multipliers are differences with twice the step, in each other way too, times the
condition of the multiplier, and what they change by within the error of the orbit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs, gmres

from casadi_skin.fmu.description import Array
from casadi_skin.follow.space import BoundaryError
from casadi_skin.model.arguments import with_error
from casadi_skin.model.result import Result

Returns = Callable[[Array], Array]
Complexes = NDArray[np.complex128]

EPSILON = float(np.finfo(float).eps)
# Places beside y where noise is measured: the seventh differences of smooth values are far below solvers' noise there.
NOISE_SPACINGS, NOISE_PLACES, NOISE_LEVELS = (1e-3, 1e-4, 1e-5), 8, (5, 6, 7)
# Tenfold nearer places make differences of a smooth map 1e5 to 1e7 times smaller.
SMOOTH_FALL, LITTLE_NOISE = (1e4, 1e8), 1e-10
SMALLEST_STEP, LARGEST_STEP = 1e-5, 0.03  # of differences
DENSE_STATES = 40  # up to which J is a matrix
LEADING_MULTIPLIERS = 8  # of many, in the order of their moduli
SOLUTION_RTOL = 1e-3  # of GMRES: what differences of noisy values are worth
VECTOR_RTOL, MOST_RESTARTS = 1e-5, 30  # of Arnoldi's method, whose vectors give multipliers by differences along them
MOST_ITERATIONS, SHORTEST_FRACTION, SLOW_CONTRACTION = 40, 1 / 128, 0.2
CONVERGED_NOISES = 30.0  # times the noise and the differences to other ways, that a residual may be
# An error of first order is twice the difference to half the step, and has further orders.
SAFETY, NOISE_SAFETY, NOISE_DIRECTIONS = 3.0, 3.0, 3
LARGEST_HIDDEN = 1e-2  # of the states' ranges, between going on from a return and starting anew from it


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """y = P(y) with its errors, in units of the ranges, and its leading multipliers; `noise` is that of P."""

    y: Array
    errors: Array
    period: float
    period_error: float
    multipliers: Complexes
    multiplier_errors: Array
    noise: float


def measured_noise(at: Returns, y: Array) -> float:
    """Standard deviation of what is not smooth in P beside y, by high differences (More and Wild, ECnoise, 2011).

    Places come nearer where P has no value, and where differences fall as those of a smooth map that bends much: jumps
    that lie between nearer places would let them fall further.
    """
    found = math.nan
    for spacing in NOISE_SPACINGS:
        squares = []
        for direction in np.random.default_rng(2).choice((-1.0, 1.0), (2, y.size)):
            offsets = spacing * (np.arange(NOISE_PLACES) - NOISE_PLACES // 2)
            values = np.array([at(y + offset * direction) for offset in offsets])
            for level in NOISE_LEVELS:
                weight = math.factorial(level) ** 2 / math.factorial(2 * level)
                squares.append(weight * np.diff(values, level, axis=0) ** 2)
        nearer = float(np.sqrt(np.max(np.mean(np.concatenate(squares), axis=0))))
        if math.isfinite(found) and not SMOOTH_FALL[0] < found / max(nearer, EPSILON) < SMOOTH_FALL[1]:
            break
        found = nearer
        if found < LITTLE_NOISE:
            break
    return max(found, EPSILON * max(1.0, float(np.max(np.abs(y)))))


def central(at: Returns, y: Array, along: Array, step: float) -> Array:
    """The derivative of P along a direction by central differences, (n,)."""
    return np.asarray((at(y + step * along) - at(y - step * along))[:-1] / (2.0 * step))


def best_step(at: Returns, y: Array, along: Array, noise: float) -> float:
    """The step of central differences where truncation by P''' along a direction and noise are alike, at most."""
    step = min(max(math.cbrt(noise), SMALLEST_STEP), LARGEST_STEP)
    while step > SMALLEST_STEP:
        third = float(np.linalg.norm(central(at, y, along, 2.0 * step) - central(at, y, along, step))) * 2.0 / step**2
        best = math.cbrt(3.0 * noise / max(third, 3.0)) if math.isfinite(third) else 0.25 * step
        if best > 0.7 * step:
            break
        step = max(best, 0.1 * step, SMALLEST_STEP)
    return step


class Slope:
    """J at y by differences: a matrix, or of many states an operator."""

    def __init__(self, at: Returns, y: Array, step: float) -> None:
        def along(direction: Array) -> Array:
            size = float(np.linalg.norm(direction)) or 1.0
            unit = direction.ravel() / size
            return size * central(at, y, unit, step)

        self.n, self._along, self.matrix = y.size, along, np.zeros((0, 0))
        if self.n <= DENSE_STATES:
            self.matrix = np.stack([along(unit) for unit in np.eye(self.n)], axis=1)

    def solve(self, b: Array) -> Array:
        """The solution of (1 - J) x = b; NaN where there is none."""
        if not self.matrix.size:
            operator = LinearOperator((self.n, self.n), matvec=lambda v: v.ravel() - self._along(v), dtype=float)
            return np.asarray(gmres(operator, b, rtol=SOLUTION_RTOL)[0])
        try:
            return np.asarray(np.linalg.solve(np.eye(self.n) - self.matrix, b))
        except np.linalg.LinAlgError:
            return np.full(self.n, np.nan)

    def leading(self) -> tuple[Complexes, Complexes, Complexes]:
        """Eigenvalues of J, the largest first, their vectors as columns, and those of the inverse as rows."""
        if self.matrix.size:
            values, vectors = np.linalg.eig(self.matrix)
        else:
            operator = LinearOperator((self.n, self.n), matvec=self._along, dtype=float)
            try:
                values, vectors = eigs(operator, k=LEADING_MULTIPLIERS, tol=VECTOR_RTOL, maxiter=MOST_RESTARTS)
            except ArpackNoConvergence as error:
                values, vectors = error.eigenvalues, error.eigenvectors
                if not values.size:
                    raise BoundaryError(
                        "an orbit is found, but Arnoldi's method does not find its multipliers"
                    ) from error
        order = np.argsort(-np.abs(values), kind="stable")[:LEADING_MULTIPLIERS]
        left = np.linalg.pinv(vectors)[order]
        return values[order].astype(complex), vectors[:, order].astype(complex), left.astype(complex)


def fixed_point(at: Returns, y: Array, others: Sequence[Returns], again: Returns, trivial: bool) -> FixedPoint:
    """The fixed point near y, by Newton's method with steps that are shortened where P would not come nearer.

    `others` compute P in other ways, `again` goes on to the second return from a start; `trivial` is whether a
    multiplier is 0 for every orbit, which is left out. Raises BoundaryError where there is none, or P is no map of y.
    """
    noise, slope, before, value = measured_noise(at, y), None, math.inf, at(y)
    for _ in range(MOST_ITERATIONS):
        residual = value[:-1] - y
        size = float(np.max(np.abs(residual)))
        if not size > noise:
            break
        if slope is None or not size < SLOW_CONTRACTION * before:
            step = best_step(at, y, residual / np.linalg.norm(residual), noise)
            slope, before = Slope(at, y, step), math.inf
        change, fraction, nearer = slope.solve(residual), 1.0, False
        while not nearer and fraction >= SHORTEST_FRACTION:
            trial = y + fraction * change
            reached = at(trial)
            nearer = float(np.max(np.abs(reached[:-1] - trial))) < (1.0 - 0.1 * fraction) * size
            fraction *= 0.5
        if nearer:
            y, value, before = trial, reached, size
        elif before == math.inf:  # with differences that were taken here
            break
        else:
            before = 0.0
    noise = max(noise, measured_noise(at, y))
    blur = max([noise, *(float(np.max(np.abs(other(y) - value))) for other in others)])
    if not size <= CONVERGED_NOISES * blur:
        raise BoundaryError(
            f"no orbit is found: the nearest motion comes back to {size:.1e} of the ranges of its states,"
            f" where values have an error of {blur:.1e}; accepted: a nearer guess"
        )
    return _judged(at, y, others, again, noise, trivial)


def _judged(
    at: Returns, y: Array, others: Sequence[Returns], again: Returns, noise: float, trivial: bool
) -> FixedPoint:  # fmt: skip
    """A fixed point with its errors and multipliers."""
    before, along = math.inf, np.full(y.size, y.size**-0.5)
    while (step := best_step(at, y, along, noise)) < 0.7 * before:  # along what grows most it is the shortest
        slope, before = Slope(at, y, step), step
        if not np.all(np.isfinite(slope.matrix)):
            raise BoundaryError("an orbit is found, but motions beside it do not return: it has no multipliers")
        found = slope.leading()
        along = found[1][:, 0].real / np.linalg.norm(found[1][:, 0].real)
    residuals = [(other, other(y)[:-1] - y) for other in (at, *others)]
    for signs in np.random.default_rng(3).choice((-1.0, 1.0), (NOISE_DIRECTIONS, y.size)):
        residuals.append((at, NOISE_SAFETY * noise * signs))
    residuals.append((at, _hidden(at, y, again, residuals, float(np.max(np.abs(found[0]))))))
    changes = [(other, slope.solve(residual)) for other, residual in residuals]
    errors = SAFETY * np.max([np.abs(change) for _, change in changes], axis=0) + noise
    period = float(at(y)[-1])
    period_error = noise + SAFETY * float(np.max([abs(other(y + change)[-1] - period) for other, change in changes]))
    values, wrong, bent = _multipliers([(way, way(y)[:-1]) for way in (at, *others)], y, found, before, noise)
    off = float(np.linalg.norm(errors))
    # Where 1 is within the error of a multiplier, there may be no orbit, or several.
    near = float(np.max((wrong + bent * off) / np.maximum(np.abs(1.0 - values), EPSILON)))
    known = near < 1.0 and bool(np.all(np.isfinite([off, period_error])))
    wider = 1.0 / (1.0 - near) if known else math.inf
    wrong[bent > 0.0] += wider * off * bent[bent > 0.0]
    errors, period_error = (wider * errors, wider * period_error) if known else (np.full(y.size, math.inf), math.inf)
    kept = slice(0, values.size - (1 if trivial and values.size == y.size else 0))
    return FixedPoint(y, errors, period, period_error, values[kept], wrong[kept], noise)


def _hidden(
    at: Returns, y: Array, again: Returns, residuals: Sequence[tuple[Returns, Array]], largest: float
) -> Array:  # fmt: skip
    """How far going on from a return leads elsewhere than starting anew from it, which a map of y alone does not.

    Times of returns tell, too: the states at a crossing may all be held by the section.
    """
    first = at(y)
    hidden = np.asarray(again(y) - at(first[:-1]))
    hidden[-1] -= first[-1]
    size, seen = float(np.max(np.abs(hidden))), max(float(np.max(np.abs(residual))) for _, residual in residuals)
    if not size <= LARGEST_HIDDEN + 100.0 * seen * (1.0 + largest):
        raise BoundaryError(
            f"after a return it goes on elsewhere than it starts anew from there, by {size:.1e} of the states' ranges;"
            " accepted: states= with all of them, and forcing_period= where it depends on time"
        )
    return hidden[:-1]


def _multipliers(
    ways: Sequence[tuple[Returns, Array]], y: Array, found: tuple[Complexes, Complexes, Complexes], step: float,
    noise: float,
) -> tuple[Complexes, Array, Array]:  # fmt: skip
    """Multipliers with their errors, and how much they change with y; each way comes with its P(y).

    Those of J are w J v with J v by differences along v, as those along other directions bend otherwise.
    """
    values, wrong, bent = found[0].copy(), np.zeros(found[0].size), np.zeros(found[0].size)
    for k, (_, vector, left) in enumerate(zip(found[0], found[1].T, found[2], strict=True)):
        if k and found[0][k] == np.conj(found[0][k - 1]) != found[0][k - 1]:
            values[k], wrong[k], bent[k] = np.conj(values[k - 1]), wrong[k - 1], bent[k - 1]
            continue
        value = left @ _along(ways[0], y, vector, step)[0]
        values[k] = value if found[0][k].imag else value.real
        others = [_along(way, y, vector, 2.0 * step) for way in ways]
        condition = float(np.linalg.norm(left))
        off = np.max([np.linalg.norm(v - values[k] * vector) for v, _ in others])
        wrong[k] = condition * SAFETY * (off + noise / step)
        bent[k] = condition * np.max([bend for _, bend in others])
    failed = ~np.isfinite(wrong + bent + values)
    wrong[failed] = bent[failed] = math.inf
    return np.where(failed, found[0], values), wrong, bent


def _along(way: tuple[Returns, Array], y: Array, vector: Complexes, step: float) -> tuple[Complexes, float]:
    """J v of a way with its P(y), and the size of its second derivative along v."""
    at, value = way
    first, bends = np.zeros(y.size, dtype=complex), [0.0]
    for factor, part in ((1.0, vector.real), (1.0j, vector.imag)):
        if np.any(part):
            after, before = at(y + step * part)[:-1], at(y - step * part)[:-1]
            first += factor * (after - before) / (2.0 * step)
            bends.append(float(np.linalg.norm(after + before - 2.0 * value)) / step**2)
    return first, float(np.max(bends))


# The orbit as a result ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class MapOrbit(Result):
    """A periodic orbit of an FMU for Co-Simulation: of its map, which is that of the solver in it.

    Attributes:
        name: of the FMU's model.
        parameters: by name.
        state: where the orbit starts, and its estimated absolute errors `state_error`, shape (states,).
        period: with its error; of a forced model exact.
        cycles: periods of the forcing, or crossings of the section, after which it closes.
        multipliers: the leading ones of the map, the largest first, and their absolute errors; without the trivial one
            of an autonomous model.
        t, states: the orbit at communication points from its start to its end, (times,) and (times, states).
        noise: of the map, relative to the ranges of the states.
        solver_seen: whether another step or a smaller tolerance changes the motion. Where neither does, errors are
            those of the FMU's own map alone: what its solver makes of its equations cannot be seen from outside.
    """

    name: str
    state_names: tuple[str, ...]
    parameters: Mapping[str, float]
    state: Array
    state_error: Array
    period: float
    period_error: float
    cycles: int
    multipliers: Complexes
    multiplier_errors: Array
    t: Array
    states: Array
    noise: float
    solver_seen: bool

    def __repr__(self) -> str:
        words = {True: "stable", False: "unstable", None: "stability unresolved"}[self.stable]
        return f"<MapOrbit of {self.name}: period {with_error(self.period, self.period_error)}; {words}>"

    @property
    def stable(self) -> bool | None:
        """Whether all multipliers are inside the unit circle by more than their errors; None where one is undecided."""
        moduli = np.abs(self.multipliers)
        if np.any(moduli - self.multiplier_errors > 1.0):
            return False
        return True if np.all(moduli + self.multiplier_errors < 1.0) else None

    @property
    def undecided(self) -> Complexes:
        """The multipliers within whose errors the unit circle is."""
        return self.multipliers[np.abs(np.abs(self.multipliers) - 1.0) <= self.multiplier_errors]
