"""The ledger of a branch of equilibria: how many eigenvalues are unstable along it, and whether events account for it.

The search between two points (see `search`) sees a branch at a few places, and what is smooth between them. Here the
number of unstable eigenvalues is counted at many: 1024 over the range of the parameter, and as many on a part of the
branch where the state changes in place of the parameter. A Hopf point changes it by two, a fold by one, a branch point
by one or, on the branch that leaves to one side, by none.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.equilibrium_equations import EquilibriumEquations
from casadi_skin.follow.polynomials import LocalCurve
from casadi_skin.follow.rest_location import BRANCH_POINT, FOLD, HOPF
from casadi_skin.follow.stretch import Stretch
from casadi_skin.zero.problem import EPSILON, Array, Indices, SingularError
from casadi_skin.zero.rest_problem import AlgebraicProblem
from casadi_skin.zero.settings import Point
from casadi_skin.zero.statics import Linearised

PLACES = 1024  # over the range of the parameter
OF_PROGRAMS = 128  # of a program, whose derivatives are differences and cost as much
LENGTH = 6.0  # of a branch, in units of its states, that has as many places as the range of the parameter
MOST = 8192  # places between two points
NEWTON = 4  # steps
SETTLED = 1e-7  # of a stretch: a step that is none
SMALL = 16  # states: eigenvalues of more are computed only where derivatives are not what is between two points
SURE = 10.0  # times the change of an eigenvalue, to first order, that leaves it on its side
CHANGES = {FOLD: (1,), BRANCH_POINT: (0, 1), HOPF: (2,)}  # of the number of unstable eigenvalues
Flags = NDArray[np.bool_]
AT = 1e-9  # of a stretch: a place at an event itself


@dataclass(frozen=True, eq=False)
class Counts:
    """Numbers of unstable eigenvalues on the stretch between two points.

    Attributes:
        before, after: the points.
        row: the metric times the tangent of the first.
        sigma: places by row . (z - z of the first), both ends among them.
        least, most: bounds of the numbers there: eigenvalues on the axis but for errors are on either side.
        unknowns: the equilibria, shape (place, unknowns).
    """

    before: Point
    after: Point
    row: Array
    sigma: Array
    least: Indices
    most: Indices
    unknowns: Array

    def place(self, point: Point) -> float:
        """Where a point is."""
        return float(self.row @ (point.z - self.before.z))

    @cached_property
    def cuts(self) -> list[int]:
        """Places between which the number changes, where it does so more often than the ends show."""
        sure = np.flatnonzero(self.least == self.most)
        changes = np.flatnonzero(np.diff(self.least[sure]))
        if changes.size < 2:
            return []
        return sorted({*map(int, sure[changes]), *map(int, sure[changes + 1])})

    def points(self, equations: EquilibriumEquations, places: Sequence[int]) -> list[Point]:
        """Points of the branch at places within the stretch, at which equations are regular."""
        solver, problem, found = equations.point_solver, self.before.problem, list[Point]()
        for k in places:
            if 0 < k < self.sigma.size - 1:
                z = self.unknowns[k]
                with suppress(SingularError):
                    tangent = solver.tangent(problem, z, solver.factor(problem, z, self.row))
                    found.append(replace(self.before, z=z, tangent=tangent, walked=False, requested=False, special=""))
        return [point for point in found if not equations.sample(point).blurred]

    def violation(self, events: Sequence[Point]) -> tuple[int, int] | None:
        """Neighbouring places between which events do not account for the numbers; None where they do throughout."""
        placed = sorted((self.place(event), CHANGES.get(event.special, (0,))) for event in events)
        possible = set(range(int(self.least[0]), int(self.most[0]) + 1))
        last, length = 0, float(self.sigma[-1])
        for k in range(1, self.sigma.size):
            end = k == self.sigma.size - 1
            while placed and (placed[0][0] <= self.sigma[k] or end):
                changes = placed.pop(0)[1]
                possible = {n + sign * change for n in possible for change in changes for sign in (-1, 1)}
            known = {n for n in possible if self.least[k] <= n <= self.most[k]}
            if not known:
                beside = [abs(self.place(event) - self.sigma[k]) <= AT * length for event in events]
                if not any(beside):
                    return last, k
                continue
            if self.least[k] == self.most[k]:
                possible, last = known, k
        return None


def counted(equations: EquilibriumEquations, before: Point, after: Point) -> Counts | None:
    """The numbers of unstable eigenvalues between two points; None where the branch is not found there."""
    problem, first = cast(AlgebraicProblem, before.problem), equations.sample(before)
    row = first.row
    curve = LocalCurve.through(before.z, before.tangent, after.z, after.tangent, row)
    length = float(row @ (after.z - before.z))
    weights = equations.point_solver.metric(problem, before.z)
    over = PLACES if equations.statics.exact else OF_PROGRAMS
    many = max(abs(after.parameter - before.parameter), length / LENGTH)
    sigma = length * np.linspace(0.0, 1.0, int(np.clip(np.ceil(over * many), 3, MOST)) + 1)
    guesses = np.array([curve.at(float(place)) for place in sigma])
    guesses[[0, -1]] = before.z, after.z
    unknowns, settled = _solved(problem, guesses, row, SETTLED * length, weights)
    for k in np.flatnonzero(~settled):
        point = equations.point_solver.along(before, after, float(sigma[k] / length))
        if point is None:
            return None
        unknowns[k] = point.z
    stack = problem.equations_at_all(unknowns)[1][:, :, : problem.statics.size]
    stretch = Stretch.of((first, equations.sample(after)), "real parts")
    seen = np.ones(sigma.size, dtype=bool) if problem.statics.size <= SMALL else _unlike(stretch, stack, sigma / length)
    least, most = _numbers(problem.statics.model.rounding, stack, seen)
    return Counts(before, after, row, sigma[seen], least, most, unknowns[seen])


def _solved(problem: AlgebraicProblem, z: Array, row: Array, still: float, weights: Array) -> tuple[Array, Flags]:
    """Equilibria near states, each at its place along, by Newton's method; and whether the steps settled."""
    z, left, settled = z.copy(), np.arange(len(z)), np.zeros(len(z), dtype=bool)
    for _ in range(NEWTON):
        residuals, matrices = problem.equations_at_all(z[left])
        closed = np.concatenate([matrices, np.tile(row, (left.size, 1, 1))], axis=1)
        regular = np.linalg.cond(closed) < 1.0 / EPSILON
        left, closed, residuals = left[regular], closed[regular], residuals[regular]
        right = np.concatenate([residuals, np.zeros((left.size, 1))], axis=1)
        steps = np.linalg.solve(closed, right[..., None])[..., 0]
        z[left] -= steps
        small = np.sqrt(np.sum(weights * steps**2, axis=1)) <= still
        settled[left[small]] = True
        left = left[~small]
        if not left.size:
            break
    return z, settled


def _unlike(stretch: Stretch, matrices: Array, fractions: Array) -> np.ndarray:
    """Places at which a matrix is not what is between a few of them, by as much as may take an eigenvalue across."""
    from casadi_skin.follow.stretch import _cubic

    nodes = np.unique(np.linspace(0, len(matrices) - 1, 4).astype(int))
    weights = np.array([[np.prod([(t - fractions[j]) / (fractions[i] - fractions[j]) for j in nodes if j != i])
                         for i in nodes] for t in fractions])  # fmt: skip
    linear = Linearised(matrices[0])
    d = linear.balanced[1]
    off = matrices - np.tensordot(weights, matrices[nodes], axes=1)
    size = np.linalg.norm(off / d[:, None] * d, axis=(1, 2))
    g, slopes = stretch.quantities
    values, _ = _cubic(g, slopes * stretch.length, np.repeat(fractions[:, None], g.shape[1], axis=1))
    conditions = np.maximum(linear.conditions, Linearised(matrices[-1]).conditions[stretch.order])
    near = np.any(SURE * size[:, None] * conditions >= np.abs(values[:, stretch.leading :]), axis=1)
    near[[0, -1]] = True
    return np.asarray(near)


def _numbers(rounding: float, matrices: Array, seen: np.ndarray) -> tuple[Indices, Indices]:
    """Bounds of the numbers of eigenvalues with a positive real part."""
    stack = matrices[seen]
    real = np.linalg.eigvals(stack).real
    least, most = np.sum(real > 0.0, axis=1), np.sum(real > 0.0, axis=1)
    near = np.min(np.abs(real), axis=1) <= 1e-6 * np.max(np.abs(real), axis=1)
    near |= np.max(np.abs(stack), axis=(1, 2)) * 1e-9 > np.min(np.abs(real), axis=1)
    for k in np.flatnonzero(near):
        linear = Linearised(stack[k], rounding)
        values, errors = linear.eigensystem[0].real, linear.errors()
        least[k], most[k] = np.sum(values > errors), np.sum(values > -errors)
    return least, most
