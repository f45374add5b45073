"""Boundary-value problems whose regular solutions are special orbits.

The orbit's own problem on the unit interval is joined by its linearisation. Of a fold along a null vector (v, w), in
which w changes the free parameters; of a period doubling along v with v(1) = -v(0); of a torus over two turns, along v1
and v2 with v2(0) = v1(1) and v2(1) - 2 kappa v2(0) + v1(0) = 0, where kappa is the cosine of the angle of the
multipliers. The last stays real, and regular where kappa goes through 1 and -1 (Doedel, Keller and Kernevez 1991;
Govaerts 2000, chapter 8); of an autonomous orbit up to a multiple of the velocity, across which v1 starts, as the
trivial multiplier is 1 as well.

Of a branch point along a null vector v1, and v2 by which the orbits of the branch change with the parameter, orthogonal
to it; the field is pushed by a multiple of a constant matrix times v1 that comes back as zero (after Moore 1980;
regular where exactly two branches cross transversally, whether a symmetry is lost there or not). The matrix is that for
which the left null vector sees the push: in mechanics it may be orthogonal to v1 itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from casadi_skin.follow.special_points import BRANCH_POINT, DOUBLING, FOLD, TORUS
from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import BoundaryProblem
from casadi_skin.zero.statement import Statement

LINEARISED = 0.1  # weight of linearised states beside those of the orbit in the length of a step
KAPPA, SHIFT, PUSH = "cosine of the angle", "shift along the orbit", "push along the null vector"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class _Joined(OdeModel):
    """A model with its linearisation; its values are as good as those of the one that it is made of."""

    inner: OdeModel

    @property
    def rounding(self) -> float:
        return self.inner.rounding


class CriticalProblem(BoundaryProblem):
    """An extended problem along a curve: its steps are long where the orbit changes little and its linearisation does.

    As where the plane of a torus's functions turns, whose phase is held against a vector that does not.
    """

    def metric(self, z: Array, parameter_scale: float) -> Array:
        weights, model = super().metric(z, parameter_scale), self.statement.model
        assert isinstance(model, _Joined)
        weights[: self.states].reshape(self.columns, -1)[:, model.inner.full_size :] *= LINEARISED**2
        return weights


@dataclass(frozen=True, eq=False)
class Critical:
    """Data of the extended statement of critical orbits.

    Attributes:
        kind: "fold", "period doubling", "torus" or "branch point".
        orbit: the statement of the orbits themselves.
        first: name of the parameter that is found with the orbit.
        sizes: units of the components of v, shape (components of the state,).
        normal: of a torus, shape (components,): v1 is orthogonal to it at the start.
        turn: the matrix S of solutions that close as x(1) = S x(0), where it is not 1.
        autonomous: of a torus, whether the velocity is a Floquet function with the multiplier 1.
        push: of a branch point, shape (components, components): the field is pushed along this times v1, or v1 itself.
        push_ends: likewise, what the conditions are pushed by where they alone decide, shape (conditions,), or empty.
    """

    kind: str
    orbit: Statement
    first: str
    sizes: Array
    normal: Array
    turn: Array = field(default_factory=lambda: np.zeros((0, 0)))
    autonomous: bool = False
    push: Array = field(default_factory=lambda: np.zeros((0, 0)))
    push_ends: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def changes(self) -> tuple[str, ...]:
        """Names of the changes of the free parameters along the null vector, of a branch point along v2 too."""
        along = [f"change of {name}" for name in self.orbit.free] if self.kind in (FOLD, BRANCH_POINT) else []
        return (*along, *(f"{name} with {self.first}" for name in along if self.kind == BRANCH_POINT))

    @property
    def added(self) -> tuple[str, ...]:
        """Names of parameters that the model of the orbit does not have."""
        if self.kind == BRANCH_POINT:
            return (*self.changes, PUSH)
        if self.kind != TORUS:
            return self.changes
        return (KAPPA, SHIFT) if self.autonomous else (KAPPA,)

    @property
    def copies(self) -> int:
        """Number of linearised states."""
        return 2 if self.kind in (TORUS, BRANCH_POINT) else 1

    @property
    def states(self) -> int:
        """Number of components of the orbit's state."""
        return self.orbit.model.full_size

    def statement(self) -> Statement:
        """The extended problem on the unit interval."""
        model = self._model()
        conditions, integrals = self._conditions(model)
        free = (*self.orbit.free, self.first, *self.added)
        values = {**self.orbit.values, **dict.fromkeys(self.added, 0.0)}
        return Statement(model, conditions, integrals, (0.0, 1.0), values, free)

    def _model(self) -> OdeModel:
        inner = self.orbit.model
        kind, n, count = type(inner.state), self.states, len(inner.parameter_names)
        copies = self.copies
        s, x, p = kind.sym("s"), kind.sym("x", n * (1 + copies)), kind.sym("p", count + len(self.added))
        field = self._field(s, x[:n], p[:count])
        rows = [field, *(ca.jtimes(field, x, self._direction(x, k)) for k in range(1, 1 + copies))]
        for row in range(1, 1 + copies if self.kind in (FOLD, BRANCH_POINT) else 1):
            rows[row] = rows[row] + ca.jtimes(field, p, self._change(p, row))
        if self.kind == BRANCH_POINT:
            v1 = x[n : 2 * n]
            rows[0] = rows[0] + p[-1] * (ca.DM(self.push) @ v1 if self.push.size else v1)
        names = [*inner.state_names, *(f"v{k} of {name}" for k in range(1, 1 + copies) for name in inner.state_names)]
        return _Joined(
            inner.name, x, ca.vertcat(*rows), p, time=s, forcing_period=1.0, checked=False,
            state_labels=tuple(names), parameter_labels=(*inner.parameter_names, *self.added), inner=inner,
        )  # fmt: skip

    def _field(self, s: Expression, x: Expression, p: Expression) -> Expression:
        """The derivative of the orbit on the unit interval."""
        start, end = self.orbit.ends_at(p)
        return (end - start) * self.orbit.model.vector_field(start + s * (end - start), x, p)

    def _direction(self, x: Expression, copy: int) -> Expression:
        """The direction in all states that changes the orbit's by a copy of the linearised state."""
        n = self.states
        return ca.vertcat(x[copy * n : (copy + 1) * n], type(x).zeros(int(x.numel()) - n))

    def _change(self, p: Expression, copy: int = 1) -> Expression:
        """The direction in all parameters that belongs to a copy: along v2 the one that is found changes too."""
        names = self.orbit.model.parameter_names
        entries = {name: type(p)(0) for name in names} | dict(zip(self.orbit.free, self._changed(p, copy), strict=True))
        if copy == 2:
            entries[self.first] = type(p)(self.size_of(self.first))
        return ca.vertcat(*(entries[name] for name in names), type(p).zeros(len(self.added)))

    def _changed(self, p: Expression, copy: int) -> list[Expression]:
        """The changes of the free parameters that belong to a copy."""
        first = len(self.orbit.model.parameter_names) + (copy - 1) * len(self.orbit.free)
        return [p[first + k] for k in range(len(self.orbit.free))]

    def _conditions(self, model: OdeModel) -> tuple[list[Expression], list[Expression]]:
        """Conditions: expressions that vanish at the ends, and in the mean."""
        orbit, n, count = self.orbit, self.states, len(self.orbit.model.parameter_names)
        first, last, p = *model.ends, model.parameters
        stacked = ca.vertcat(*(ca.vec(c) for c in orbit.conditions))
        border = ca.Function("border", [*orbit.model.ends, orbit.model.parameters], [stacked])
        rows = border(first[:n], last[:n], p[:count])
        pushed = rows - p[-1] * ca.DM(self.push_ends) if self.push_ends.size else rows
        conditions, integrals = [pushed], self._means(model)
        v0, v1 = first[n : 2 * n], last[n : 2 * n]
        if self.kind in (FOLD, BRANCH_POINT):
            for copy in range(1, 1 + self.copies):
                at_ends = [ca.jtimes(rows, end, self._direction(end, copy)) for end in (first, last)]
                conditions.append(sum(at_ends) + ca.jtimes(rows, p, self._change(p, copy)))
        elif self.kind == DOUBLING:
            conditions.append(v1 + (ca.DM(self.turn) @ v0 if self.turn.size else v0))
        else:
            w0, w1, kappa = first[2 * n :], last[2 * n :], p[count]
            if self.turn.size:
                back = ca.DM(np.linalg.inv(self.turn))
                v1, w1 = back @ v1, back @ w1
            closing = w1 - 2 * kappa * w0 + v0
            if self.autonomous:
                closing = closing - p[count + 1] * self._field(0.0, first[:n], p[:count])
                conditions.append(self._along(first, p, v0))
            conditions += [w0 - v1, closing, ca.dot(ca.DM(self.normal), v0)]
        return conditions, integrals

    def _along(self, start: Expression, p: Expression, v: Expression) -> Expression:
        """The part of a direction at the start that is along the velocity there."""
        count = len(self.orbit.model.parameter_names)
        velocity = self._field(0.0, start[: self.states], p[:count])
        return ca.dot(velocity / ca.DM(self.sizes), v / ca.DM(self.sizes))

    def _means(self, model: OdeModel) -> list[Expression]:
        orbit, n, count = self.orbit, self.states, len(self.orbit.model.parameter_names)
        x, p, s = model.state, model.parameters, model.time
        means: list[Expression] = []
        if orbit.integrals:
            start, end = orbit.ends_at(p[:count])
            stacked = ca.vertcat(*(ca.vec(e) for e in orbit.integrals))
            along = orbit.along("means", stacked)(start + s * (end - start), x[:n], p[:count])
            means.append((end - start) * along)
        whole = means[0] if means else None
        for copy in range(1, 1 + self.copies if self.changes and whole is not None else 1):
            means.append(ca.jtimes(whole, x, self._direction(x, copy)) + ca.jtimes(whole, p, self._change(p, copy)))
        products = [self._product(x, p, 1) - 1]
        if self.kind == BRANCH_POINT:
            products.append(self._product(x, p, 2))
        return [*means, *products]

    def _product(self, x: Expression, p: Expression, copy: int) -> Expression:
        """The product of v1 and a copy, by the sizes of components, with the changes of free parameters."""
        n, sizes = self.states, ca.DM(self.sizes)
        found = ca.dot(x[n : 2 * n] / sizes, x[copy * n : (copy + 1) * n] / sizes) / n
        if self.changes:
            for name, a, b in zip(self.orbit.free, self._changed(p, 1), self._changed(p, copy), strict=True):
                found = found + a * b / self.size_of(name) ** 2
        return found

    def size_of(self, name: str) -> float:
        """Scale of the change of a free parameter."""
        value = abs(self.orbit.values[name])
        return value if value > 0.0 else 1.0
