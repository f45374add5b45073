"""Whether the conditions of a boundary-value problem close its solutions: x(end) = S x(start), but for a constant."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.stated_problem import BoundaryProblem
from casadi_skin.bvp.statement import Statement
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.stability.full_period import multipliers_of
from casadi_skin.stability.interval_maps import Parts, interval_maps, stage_jacobians
from casadi_skin.stability.result import FullPeriodFloquet
from casadi_skin.stability.trivial import Trivial, trivial_at

TRIALS, SAME = 3, 1e-12  # random points at which derivatives of conditions are compared, and their difference
KEPT = 1e-5  # relative: what closes as the solution does


@dataclass(frozen=True, eq=False)
class Closure:
    """The matrix S of a statement whose solutions come back to S times their start: 1 where they are periodic."""

    statement: Statement
    matrix: Array

    def multipliers(self, problem: BoundaryProblem, z: Array, tolerance: float) -> FullPeriodFloquet:
        """Multipliers of a solution: those of S^-1 times the flow over the interval."""
        jacobians, n = stage_jacobians(problem, z), self.matrix.shape[0]
        back = np.asarray(np.linalg.inv(self.matrix), dtype=float)
        maps = np.concatenate([interval_maps(problem, jacobians), back[None]])
        quadrature = np.outer(problem.constants, problem.table.extended[-1]).ravel()
        contraction = float(quadrature @ np.trace(jacobians, axis1=1, axis2=2))
        contraction += float(np.linalg.slogdet(back)[1])
        values = z[: problem.states].reshape(-1, n)
        trivial = self._trivial(values, problem.parameters(z))
        return multipliers_of(maps, trivial, tolerance, contraction, parts=Parts(problem, z, jacobians, back))

    def _trivial(self, values: Array, parameters: Array) -> Trivial:
        """Trivial multipliers: directions and gradients that S maps as it maps the solution."""
        model = self.statement.model
        first, last = (trivial_at(model, SymmetryClass.FULL, x, parameters) for x in (values[0], values[-1]))
        if first.count == 0 or len(first.right) != len(last.right) or len(first.left) != len(last.left):
            return Trivial(0, first.right[:0], first.left[:0])
        right = [a for a, b in zip(first.right, last.right, strict=True) if _same(self.matrix @ a, b)]
        left = [a for a, b in zip(first.left, last.left, strict=True) if _same(self.matrix.T @ b, a)]
        n = self.matrix.shape[0]
        return Trivial(len(right) + len(left), np.array(right).reshape(-1, n), np.array(left).reshape(-1, n))


def closure_of(statement: Statement) -> Closure | None:
    """How the conditions of a statement close its solutions; None where they do not.

    Those conditions that hold a start and an end linearly have to determine either from the other.
    """
    model, n = statement.model, statement.model.full_size
    if not statement.conditions:
        return None
    rows = ca.vertcat(*(ca.vec(condition) for condition in statement.conditions))
    start, end = model.ends
    slopes = ca.Function(
        "slopes", [start, end, model.parameters],
        [ca.densify(ca.jacobian(rows, start)), ca.densify(ca.jacobian(rows, end))],
    )  # fmt: skip
    generator, found = np.random.default_rng(0), []
    for _ in range(TRIALS):
        points = (np.abs(generator.normal(size=size)) for size in (n, n, model.parameters.numel()))
        found.append(np.hstack([np.array(slope) for slope in slopes(*points)]))
    first = found[0]
    linear = np.all([np.max(np.abs(other - first), axis=1) <= SAME for other in found[1:]], axis=0)
    both = linear & np.any(first[:, :n] != 0.0, axis=1) & np.any(first[:, n:] != 0.0, axis=1)
    A, B = first[both, :n], first[both, n:]
    if A.shape[0] != n or np.linalg.matrix_rank(A) < n or np.linalg.matrix_rank(B) < n:
        return None
    return Closure(statement, -np.linalg.solve(B, A))


def _same(one: Array, other: Array) -> bool:
    return bool(np.max(np.abs(one - other)) <= KEPT * np.max(np.abs(other)))
