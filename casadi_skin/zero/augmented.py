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

Extended systems whose regular solutions are folds, Hopf points and branch points of equilibria.

Fold: F = 0, F_y v = 0, v W v = 1 (Moore and Spence 1980). Hopf point: F = 0, F_y v = w, F_y w + kappa v = 0, v W v = 1,
d v = 0, with kappa = omega^2 (Roose and Hlavacek 1985), which stays regular where kappa goes through zero. Branch
point: F + beta c = 0, psi F_y = 0, psi F_p = 0, c psi = 1 with beta = 0 (Griewank and Reddien 1984). W, c and d are
constants that measure null vectors by the units of the state where the system is started.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.kinds import BRANCH_POINT, DOUBLING, FOLD, TORUS
from casadi_skin.zero.linearised import Linearised, Vector, null_vectors, velocities
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest_problem import AlgebraicProblem, Course
from casadi_skin.zero.stated_problem import ZERO_SOLUTION_SIZE, BoundaryProblem
from casadi_skin.zero.statement import Statement
from casadi_skin.zero.statics import BalancedMatrix, ComplexArray, NullSpace, Statics, upper_pair

# Extended systems whose regular solutions are folds, Hopf points and branch points of equilibria ----------------------


class ExtendedSystem(AlgebraicProblem):
    """Base of extended systems: their unknowns start from an approximate point, which sets their constants."""

    def __init__(
        self, statics: Statics, sizes: Array, free: Sequence[Course], walking: Course | None = None, rate: float = 1.0
    ) -> None:
        super().__init__(statics, sizes, free, walking)
        n = statics.size
        self.rate = float(2.0 ** np.round(np.log2(rate)))  # of time: the scale of omega
        self.others, self.added = self.shape(n)
        self.states = n + self.others
        self.constants = np.zeros(self.constant_count(n))

    @staticmethod
    def shape(n: int) -> tuple[int, int]:
        """Unknowns beside the state, and added scalars."""
        raise NotImplementedError

    @staticmethod
    def constant_count(n: int) -> int:
        """Number of constants."""
        return n

    def started(
        self, matrix: Array, y: Array, scalars: Array, near: complex | None = None
    ) -> tuple[AlgebraicProblem, Array]:
        """The system with its constants, and its unknowns, from dF/dy at an approximate point; u is 0.

        `near` selects the pair of eigenvalues, by default that nearest to the imaginary axis.
        """
        raise NotImplementedError

    def _units_near(self, y: Array, scalars: Array) -> Array:
        """Units of the state at an approximate point."""
        return self.units(
            np.concatenate([y, np.zeros(self.others), scalars, np.zeros(self.size - self.states - scalars.size)])
        )

    def units_beside(self, units: Array) -> Array:
        return np.tile(units, self.others // units.size)


class FoldSystem(ExtendedSystem):
    """Folds, with the null vector v of F_y."""

    @staticmethod
    def shape(n: int) -> tuple[int, int]:
        return n, 0

    def _residual(self, y: Expression, others: Expression, scalars: Expression, c: Expression) -> Expression:
        F = self.force(y, self.parameters_at(scalars))
        return ca.vertcat(F, ca.jtimes(F, y, others), ca.dot(others, c * others) - 1)

    def started(
        self, matrix: Array, y: Array, scalars: Array, near: complex | None = None
    ) -> tuple[AlgebraicProblem, Array]:
        units = self._units_near(y, scalars)
        v = NullSpace.of_rates(matrix, units).right[:, -1]
        return self.with_constants(units**-2.0), np.concatenate([y, v, scalars, [0.0]])


class BranchSystem(ExtendedSystem):
    """Branch points, with the left null vector psi of (F_y, F_p) and the imperfection beta, which is zero."""

    @staticmethod
    def shape(n: int) -> tuple[int, int]:
        return n, 1

    def _residual(self, y: Expression, others: Expression, scalars: Expression, c: Expression) -> Expression:
        F, beta = self.force(y, self.parameters_at(scalars)), scalars[1]
        by_y, by_p = ca.jtimes(F, y, others, True), ca.dot(ca.jacobian(F, scalars)[:, 0], others)
        return ca.vertcat(F + beta * c, by_y, by_p, ca.dot(c, others) - 1)

    def started(
        self, matrix: Array, y: Array, scalars: Array, near: complex | None = None
    ) -> tuple[AlgebraicProblem, Array]:
        units = self._units_near(y, scalars)
        psi = NullSpace.of_rates(matrix, units).left[:, -1]
        c = psi * units**2 / np.linalg.norm(psi * units)
        return self.with_constants(c), np.concatenate([y, psi / (c @ psi), scalars, [0.0, 0.0]])

    def units_beside(self, units: Array) -> Array:
        return np.asarray(1.0 / units)


class HopfSystem(ExtendedSystem):
    """Hopf points, with v and w = F_y v / rate in the critical plane, and kappa = (omega/rate)^2."""

    @staticmethod
    def shape(n: int) -> tuple[int, int]:
        return 2 * n, 1

    def _residual(self, y: Expression, others: Expression, scalars: Expression, c: Expression) -> Expression:
        n, rate, kappa = self.statics.size, self.rate, scalars[len(self.free)]
        F = self.force(y, self.parameters_at(scalars))
        v, w = others[:n], others[n:]
        turned, back = ca.jtimes(F, y, v) / rate - w, ca.jtimes(F, y, w) / rate + kappa * v
        return ca.vertcat(F, turned, back, ca.dot(v, c[n:] * v) - 1, ca.dot(c[:n], v))

    @staticmethod
    def constant_count(n: int) -> int:
        return 2 * n

    def started(
        self, matrix: Array, y: Array, scalars: Array, near: complex | None = None
    ) -> tuple[AlgebraicProblem, Array]:
        linear, units = BalancedMatrix(matrix), self._units_near(y, scalars)
        values = linear.eigensystem[0]
        k = upper_pair(values, near)
        v, d = plane(linear.vectors(k)[0] / units)
        v, constants = v * units, np.concatenate([d / units, units**-2.0])
        w = matrix @ v / self.rate
        kappa = (values[k].imag / self.rate) ** 2
        return self.with_constants(constants), np.concatenate([y, v, w, scalars, [kappa, 0.0]])

    def kappa(self, z: Array) -> float:
        """(omega/rate)^2 of a solution; negative where the eigenvalues are real with sum zero."""
        return float(z[self.states + len(self.free)])


def plane(q: ComplexArray) -> tuple[Array, Array]:
    """An orthonormal basis of the plane of the real and imaginary parts of a vector, which may be turned freely."""
    turned = q * np.exp(-0.5j * np.angle(np.sum(q * q)))  # real and imaginary parts are orthogonal now
    v = turned.real / np.linalg.norm(turned.real)
    size = np.linalg.norm(turned.imag)
    if size > 1e-12:
        return v, turned.imag / size
    d = np.zeros_like(v)
    d[np.argmin(np.abs(v))] = 1.0
    d -= v * (v @ d)
    return v, d / np.linalg.norm(d)


LINEARISED_WEIGHT = 0.1  # weight of linearised states beside those of the orbit in the length of a step
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
        weights[: self.states].reshape(self.columns, -1)[:, model.inner.full_size :] *= LINEARISED_WEIGHT**2
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


# Start of Newton's method on the extended problem of a special orbit: an orbit near it, and its null vectors ----------

UNSEEN_FIELD_RATIO = 1e-9  # of what a left null vector sees of the conditions: less of the field is rounding
RESTING_COMPONENT_RATIO = 1e-5  # of the largest component: what a smaller one changes by is not known from its size


def started(critical: Critical, problem: BoundaryProblem, z: Array, value: float, angle: float = np.pi) -> Array:
    """Unknowns of the extended problem, on the mesh of an orbit, from the orbit's and the parameter's value."""
    n, count = critical.states, len(critical.orbit.free)
    linear = Linearised(problem, z, critical.orbit)
    if critical.kind == FOLD:
        v, added, size = _of_fold(critical, problem, null_vectors(linear.jacobian)[0])
    elif critical.kind == BRANCH_POINT:
        v, added, size = _of_branch_point(critical, linear)
    elif critical.kind == DOUBLING:
        v, added = null_vectors(linear.twisted(-1.0 + 0.0j, critical.turn))[0].reshape(-1, n), np.zeros(0)
        size = np.sqrt(_mean(problem, v / critical.sizes))
    else:
        v, added, size = _of_torus(critical, problem, z, angle)
    added = np.append(np.cos(angle), added[1:] / size) if critical.kind == TORUS else added / size
    states = np.hstack([z[: problem.states].reshape(-1, n), v / size])
    return np.concatenate([states.ravel(), z[problem.states : problem.states + count], [value], added, [0.0]])


def _of_fold(critical: Critical, problem: BoundaryProblem, null: Array) -> tuple[Array, Array, float]:
    """A null vector in states, in changes of the free parameters, and its size."""
    v, added = null[: problem.states].reshape(-1, critical.states), null[problem.states :]
    changes = np.sum((added / [critical.size_of(name) for name in critical.orbit.free]) ** 2)
    return v, added, float(np.sqrt(_mean(problem, v / critical.sizes) + changes))


def _of_branch_point(critical: Critical, linear: Linearised) -> tuple[Array, Array, float]:
    """v1 and v2 side by side, their changes of free parameters and the push; the size of v1."""
    from scipy.sparse import bmat, csc_matrix
    from scipy.sparse.linalg import splu

    problem, matrix = linear.problem, linear.jacobian
    right, left = null_vectors(matrix)
    v, added, size = _of_fold(critical, problem, right)
    closed = bmat([[matrix, csc_matrix(left[:, None])], [csc_matrix(right[None, :]), None]]).tocsc()
    slope = linear.slope * critical.size_of(critical.first)
    second = np.asarray(splu(closed).solve(np.append(-slope, 0.0))[:-1])
    w, changes = second[: problem.states].reshape(v.shape), second[problem.states :]
    return np.hstack([v, size * w]), np.concatenate([added, size * changes, [0.0]]), size


def _of_torus(critical: Critical, problem: BoundaryProblem, z: Array, angle: float) -> tuple[Array, Array, float]:
    """v1 and v2 side by side; the cosine and the shift; the size of v1."""
    q, shift, start = critical_plane(problem, z, angle, critical.sizes, critical.turn, critical.autonomous)
    turn = np.exp(0.5j * np.pi - 1j * np.angle(critical.normal @ start))  # v1 is orthogonal to the normal
    along = np.real(turn * shift) * velocities(problem, z) if critical.autonomous else 0.0
    v1, v2 = (turn * q).real - along, (turn * q * np.exp(1j * angle)).real - along
    added = [np.cos(angle)]
    if critical.autonomous:
        added.append(float(np.real(turn * shift)) * 2.0 * (np.cos(angle) - 1.0))
    return np.hstack([v1, v2]), np.array(added), float(np.sqrt(_mean(problem, v1 / critical.sizes)))


def component_sizes(values: Array) -> Array:
    """Scale of each component of a Floquet function: the orbit's largest, or a usual one where it rests; 1 of zeros."""
    largest = np.max(np.abs(values), axis=0)
    moves = largest > RESTING_COMPONENT_RATIO * np.max(largest)
    if np.max(largest) <= ZERO_SOLUTION_SIZE:
        return np.ones(largest.size)
    return np.asarray(np.where(moves, largest, np.median(largest[moves])))


def critical_plane(
    problem: BoundaryProblem, z: Array, angle: float, sizes: Array, turn: Array, autonomous: bool
) -> tuple[Vector, complex, Vector]:
    """The function q with q(1) = exp(i angle) turn q(0), shape (columns, components), and how it starts.

    Its start is a multiple of the velocity of an autonomous orbit, which is second; the part across it is third.
    """
    twisted = Linearised(problem, z, problem.statement).twisted(complex(np.exp(1j * angle)), turn)
    q = null_vectors(twisted)[0].reshape(problem.columns, -1)
    if not autonomous:
        return q, 0.0, q[0]
    velocity = velocities(problem, z)[0]
    shift = complex((velocity / sizes) @ (q[0] / sizes) / np.sum((velocity / sizes) ** 2))
    return q, shift, q[0] - shift * velocity


def normal_of(start: Vector, sizes: Array) -> Array:
    """A vector between the axes of the ellipse on which real parts of multiples of a complex one are.

    What is orthogonal to it is no eigenvector where the ellipse becomes a line, as at the resonances 1:1 and 1:2.
    """
    scaled = start / sizes
    turned = scaled * np.exp(-0.5j * np.angle(np.sum(scaled * scaled)))
    longer, shorter = (part / np.linalg.norm(part) for part in (turned.real, turned.imag))
    return np.asarray((longer - shorter) / np.sqrt(2.0) / sizes)


def seen_push(problem: BoundaryProblem, z: Array, statement: Statement, sizes: Array) -> tuple[Array, Array]:
    """The matrix of norm 1 that turns the null vector at a branch point to the largest product with its left one.

    Where conditions alone decide, which that vector sees and not the field, the changes of these instead, of norm 1.
    """
    linear = Linearised(problem, z, statement)
    v, psi = null_vectors(linear.jacobian)
    seen = linear.products(psi, v) * np.outer(sizes, 1.0 / sizes)
    conditions = psi[linear.inner :][: problem.formulation.conditions.numel()]
    if np.linalg.norm(seen) > UNSEEN_FIELD_RATIO * np.linalg.norm(conditions):
        return np.asarray(seen / np.linalg.norm(seen) * np.outer(sizes, 1.0 / sizes)), np.zeros(0)
    return np.zeros_like(seen), np.asarray(conditions / np.linalg.norm(conditions))


def _mean(problem: BoundaryProblem, v: Array) -> float:
    """The mean over the interval, and over the components, of the squares of v, shape (columns, components)."""
    weights = np.outer(problem.constants, problem.table.extended[-1]).ravel()
    return float(weights @ np.mean(v[problem.stages] ** 2, axis=1))
