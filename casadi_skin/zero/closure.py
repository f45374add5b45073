"""Whether the conditions of a boundary-value problem close its solutions: x(end) = S x(start), but for a constant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from casadi_skin.model.expressions import Expression
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import BoundaryProblem
from casadi_skin.zero.statement import Statement

CONDITION_TRIALS, SAME_DERIVATIVE_ATOL = (
    3,
    1e-12,
)  # random points at which derivatives of conditions are compared, and their difference
TURNED_FIELD_RTOL = 1e-9  # relative: a field that is the same after a turn


@dataclass(frozen=True, eq=False)
class Closure:
    """How solutions of a statement come back to S times their start: S is 1 where they are periodic.

    Attributes:
        statement: the problem.
        matrix: S, shape (n, n).
        closing: the numbers of the n conditions that close them, all conditions counted one by one.
        end: the derivative of these by the state at the end, shape (n, n).
    """

    statement: Statement
    matrix: Array
    closing: tuple[int, ...]
    end: Array

    def shift(self, parameters: Array) -> Array:
        """The vector added to S times the start, shape (n,)."""
        model, n = self.statement.model, self.matrix.shape[0]
        rows = ca.Function("rows", [*model.ends, model.parameters], [_rows(self.statement)])
        at_rest = np.array(rows(np.zeros(n), np.zeros(n), parameters)).ravel()[list(self.closing)]
        return np.asarray(-np.linalg.solve(self.end, at_rest))

    def twice(self) -> Statement:
        """The problem of solutions that close after two turns; its other conditions are those of the first one."""
        model, n = self.statement.model, self.matrix.shape[0]
        rows, (start, end) = _rows(self.statement), model.ends
        known = ca.Function("rows", [start, end, model.parameters], [rows])
        zeros = type(start).zeros(n)
        middle = ca.DM(self.matrix) @ start - ca.solve(
            ca.DM(self.end), known(zeros, zeros, model.parameters)[list(self.closing)]
        )
        closed = known(middle, end, model.parameters)[list(self.closing)]
        others = [rows[k] for k in range(int(rows.numel())) if k not in self.closing]
        first, last = self.statement.interval
        return replace(self.statement, conditions=[closed, *others], interval=(first, 2 * last - first))

    def goes_on(self, problem: BoundaryProblem, z: Array) -> bool:
        """Whether the field is the same after a turn, f(t + T, S x + c) = S f(t, x), at places near a solution."""
        model, p = self.statement.model, problem.parameters(z)
        start, end = self.statement.span(p)
        generator, places = np.random.default_rng(0), np.linspace(0.0, 1.0, CONDITION_TRIALS + 1)[:-1]
        field = model.function("field", ca.densify(model.full_rhs))
        for t, x in zip(start + places * (end - start), problem.sample(z, places), strict=True):
            near = x + 0.1 * (1.0 + np.abs(x)) * generator.normal(size=x.size)
            here = self.matrix @ np.array(field(t, near, p)).ravel()
            after = np.array(field(t + end - start, self.matrix @ near + self.shift(p), p)).ravel()
            if not np.max(np.abs(after - here)) <= TURNED_FIELD_RTOL * (1.0 + np.max(np.abs(here))):
                return False
        return True


def closure_of(statement: Statement) -> Closure | None:
    """How the conditions of a statement close its solutions; None where they do not.

    Those conditions that hold a start and an end linearly have to determine either from the other.
    """
    model, n = statement.model, statement.model.full_size
    if not statement.conditions:
        return None
    rows, (start, end) = _rows(statement), model.ends
    slopes = ca.Function(
        "slopes", [start, end, model.parameters],
        [ca.densify(ca.jacobian(rows, start)), ca.densify(ca.jacobian(rows, end))],
    )  # fmt: skip
    generator, found = np.random.default_rng(0), []
    for _ in range(CONDITION_TRIALS):
        points = (np.abs(generator.normal(size=size)) for size in (n, n, model.parameters.numel()))
        found.append(np.hstack([np.array(slope) for slope in slopes(*points)]))
    first = found[0]
    linear = np.all([np.max(np.abs(other - first), axis=1) <= SAME_DERIVATIVE_ATOL for other in found[1:]], axis=0)
    both = linear & np.any(first[:, :n] != 0.0, axis=1) & np.any(first[:, n:] != 0.0, axis=1)
    A, B = first[both, :n], first[both, n:]
    if A.shape[0] != n or np.linalg.matrix_rank(A) < n or np.linalg.matrix_rank(B) < n:
        return None
    return Closure(statement, -np.linalg.solve(B, A), tuple(np.flatnonzero(both).tolist()), B)


def _rows(statement: Statement) -> Expression:
    """The conditions at the ends, one below the other."""
    return ca.vertcat(*(ca.vec(condition) for condition in statement.conditions))
