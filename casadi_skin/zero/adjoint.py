"""Derivatives of what is made of a solution by all parameters of its model, by one adjoint solve.

The solution is that of F(z, c) = 0 with z of shape (size,), whose last entry u is held, and the model's parameters c.
A number J(z, c) of it has the derivatives

    dJ/dc = J_c - l^T F_c,        F_z^T l = J_z,

for all c with one factorisation. F_c is never formed: l^T F_c is the gradient of the scalar l^T F, a sum over the
stages of collocation. Of special solutions F ends with the entries of G (see `augmented`), whose derivatives

    dG = -Psi^T dB V,        the gradient of Psi^T F_z V by z and c,

are exact, forward over reverse, where the model is symbolic; those of a program, as an FMU, are differences of its
first derivatives. A simple eigenvalue or multiplier of the linearisation has the same form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.pickled import programs_in
from casadi_skin.model.result import kept_by_first
from casadi_skin.zero.augmented import Augmented
from casadi_skin.zero.discretisation import Formulation
from casadi_skin.zero.linearised import Linearised, by_parts
from casadi_skin.zero.problem import EPSILON, Array, Problem, SingularError
from casadi_skin.zero.rest import AlgebraicProblem
from casadi_skin.zero.stated_problem import BoundaryProblem, stated

# Of the sizes of unknowns: that of differences of a program's derivatives, with steps h and 2 h; rounding and h^4 meet.
DIFFERENCE_STEP = EPSILON**0.2
SWITCHING_STEP = 1e-4  # of a parameter that moves the times at which the field switches, likewise
Pulled = tuple[Array, Array]  # derivatives of a scalar by the unknowns, shape (size,), and by the parameters


def central(function: Callable[[float], Array], h: float) -> Array:
    """The derivative at 0, by the central difference of fourth order with steps h and 2 h."""
    a, b, c, d = (function(k * h) for k in (1.0, -1.0, 2.0, -2.0))
    return np.asarray((8.0 * (a - b) - (c - d)) / (12.0 * h))


def _pull(values: Expression, before: Sequence[Expression], moving: Sequence[Expression], last: Expression,
          second: bool) -> ca.Function:  # fmt: skip
    """Function (before, moving, last, left, ways) -> the gradient of left^T values by `moving` and by `last`.

    With `second` that of the derivative of left^T values in the ways of `moving`.
    """
    left, ways = type(values).sym("left", values.numel()), list[Expression]()
    total = ca.dot(ca.densify(values), left)
    if second:
        ways = [type(values).sym(f"way{k}", symbol.numel()) for k, symbol in enumerate(moving)]
        total = sum(ca.jtimes(total, symbol, way) for symbol, way in zip(moving, ways, strict=True))
    results = [ca.densify(ca.gradient(total, symbol)) for symbol in (*moving, last)]
    return ca.Function("pull", [*before, *moving, last, left, *ways], results)


@kept_by_first
def _of_formulation(f: Formulation, name: str, second: bool, count: int) -> ca.Function:
    before, moving = ([], [*f.ends, f.scalars]) if name == "conditions" else ([f.s], [f.x, f.scalars])
    return _pull(getattr(f, name), before, moving, f.constants, second).map(count)


@kept_by_first
def _of_rest(model: OdeModel, second: bool) -> ca.Function:
    kind = type(model.state)
    return _pull(ca.densify(model.rhs), [], [model.state, model.parameters], kind.sym("none", 0), second)


@dataclass(frozen=True, eq=False)
class Equations:
    """The own equations of a problem, those of a special solution without G, by the unknowns and the parameters.

    Attributes:
        problem: an `AlgebraicProblem` or a `BoundaryProblem`.
        widening: of the steps of differences, for their errors.
        names: of the parameters.
        exact: whether second derivatives are no differences.
        unknowns: parameters by name that are found with the solution: their places among the unknowns, and how fast
            they change with these.
        lengths: function of z: scales of the unknowns.
        matrix: likewise, F_z, sparse, shape (equations, size).
        at_start: function of z and weights: derivatives of weights^T x' at the start by the parameters.
    """

    problem: Any
    widening: float = 1.0

    @staticmethod
    def of(problem: Problem, widening: float = 1.0) -> Equations:
        """Those of equilibria or of collocation; raises NoQuantityError for others."""
        if isinstance(problem, AlgebraicProblem):
            return OfRest(problem, widening)
        return OfCollocation(stated(problem), widening)

    if TYPE_CHECKING:  # of each kind

        def __getattr__(self, name: str) -> Any: ...

    def moves(self) -> Array:
        """How the parameters change with the unknowns, shape (parameters, size)."""
        found = np.zeros((len(self.names), self.problem.size))
        for name, (index, rate) in self.unknowns().items():
            found[self.names.index(name), index] = rate
        return found

    def pulled(self, z: Array, left: Any, way: Any = None) -> Any:
        """The gradient of left^T F, of the terms that are not linear alone; or of left^T F_z way, of all.

        By the unknowns and by the parameters; both vectors may be complex.
        """
        if way is None:
            return self._pulled(z, left, None)

        def of(left: Array, way: Array) -> Array:
            if self.exact:
                return np.concatenate(self._pulled(z, left, way))
            h = self.widening * DIFFERENCE_STEP / max(float(np.max(np.abs(way) / self.lengths(z))), 1e-300)
            return central(lambda k: np.concatenate(self._pulled(z + k * way, left, None)), h)

        by_z, by_c = np.split(by_parts(of, z.size + len(self.names), left, way), [z.size])
        for place, rate in self.by_switching(lambda moved: left @ (moved.matrix(z) @ way)).items():
            by_c[place] = rate
        return by_z, by_c

    @property
    def differs(self) -> bool:
        """Whether some derivatives are differences."""
        return not self.exact

    def by_switching(self, value: Callable[[Any], Array]) -> dict[int, Array]:
        """Derivatives of a value of equations by parameters, by place, that move the times where the field switches."""
        return {}


class OfRest(Equations):
    """Of equilibria: f(x, p) over the sizes of x."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.problem.statics.values)

    @property
    def exact(self) -> bool:
        return bool(self.problem.statics.exact)

    def unknowns(self) -> dict[str, tuple[int, float]]:
        n = self.problem.statics.size
        return {course.name: (n + k, course.extent) for k, course in enumerate(self.problem.free)}

    def lengths(self, z: Array) -> Array:
        return np.maximum(np.abs(z), 1.0)

    def matrix(self, z: Array) -> Any:
        from scipy.sparse import csc_matrix

        problem = self.problem
        if isinstance(problem, Augmented):
            return csc_matrix((problem.own(z)[1], problem.own_places), shape=(problem.equations, z.size))
        return csc_matrix((problem.entries(z), problem.pattern), shape=(problem.size - 1, z.size))

    def _pulled(self, z: Array, left: Array, way: Array | None) -> Pulled:
        problem, n, moves = self.problem, self.problem.statics.size, self.moves()
        ways = [] if way is None else [problem.scale * way[:n], moves @ way]
        given: list[Any] = [problem.state(z), problem.parameters(z), [], left[:n] / problem.scale]
        found = _of_rest(problem.statics.model, way is not None)(*given, *ways)
        by_x, by_p, _ = (np.array(part).ravel() for part in found)
        by_z = by_p @ moves
        by_z[:n] += by_x * problem.scale
        return by_z, by_p


class OfCollocation(Equations):
    """Of orbits and solutions of boundary-value problems: increments, conditions, integrals (see `discretisation`)."""

    problem: BoundaryProblem

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.problem.statement.values)

    @property
    def exact(self) -> bool:
        formulation = self.problem.formulation
        return not any(map(programs_in, (formulation.field_function, formulation.condition_function)))

    def unknowns(self) -> dict[str, tuple[int, float]]:
        return {name: (self.problem.states + k, 1.0) for k, name in enumerate(self.problem.statement.free)}

    def lengths(self, z: Array) -> Array:
        return self.problem.sizes(z)

    def matrix(self, z: Array) -> Any:
        return Linearised(self.problem, z, self.problem.statement).matrix

    @property
    def differs(self) -> bool:
        return not self.exact or bool(self.problem.statement.switching.size)

    def by_switching(self, value: Callable[[Any], Array]) -> dict[int, Array]:
        """By differences on meshes whose edges move along: at a held mesh such a parameter does nothing."""
        p, statement, found = self.problem, self.problem.statement, dict[int, Array]()

        def at(step: float, name: str) -> Array:
            moved = statement.with_parameters(**{name: statement.values[name] + step})
            given = p.formulation, p.resolution, p.table, p.floors, p.scalar_floors, p.walking, p.end
            return value(OfCollocation(BoundaryProblem(moved, *given).with_constants(p.constants)))

        for place, name in enumerate(self.names if statement.switching.size else ()):
            h = self.widening * SWITCHING_STEP * (abs(statement.values[name]) or 1.0)
            moved = statement.with_parameters(**{name: statement.values[name] + h}).switching
            if not np.array_equal(moved, statement.switching):
                found[place] = central(partial(at, name=name), h)
        return found

    def at_start(self, z: Array, weights: Array) -> Array:
        f, n = self.problem.formulation, self.problem.formulation.states
        found = _of_formulation(f, "field", False, 1)(0.0, z[:n], *self.problem.repeated(z, 1), weights)
        return np.array(found[2]).ravel()[: len(self.names)]

    def _pulled(self, z: Array, left: Array, way: Array | None) -> Pulled:
        p, f = self.problem, self.problem.formulation
        n, lengths, stages, second = f.states, p.constants, p.stages, way is not None
        inner, count, conditions = p.states - n, stages.size, int(f.conditions.numel())
        by_z, by_c = np.zeros(z.size), np.zeros(p.values.size)
        by_states = by_z[: p.states].reshape(p.columns, n)

        def part(name: str, before: list[Array], columns: Any, weights: Array, times: int) -> None:
            """Add the gradient by the states at `columns`, by the scalars and by the constants."""
            x = z[: p.states].reshape(p.columns, n)[columns].T
            x, ways = [x] if name != "conditions" else list(x.T), list[Array]()
            if way is not None:
                along = way[: p.states].reshape(p.columns, n)[columns].T
                ways = [along] if name != "conditions" else list(along.T)
                ways.append(np.tile(way[p.states :, None], times))
            scalars, values = p.repeated(z, times)
            function = _of_formulation(f, name, second, times)
            *by_x, by_scalars, by_values = map(np.array, function(*before, *x, scalars, values, weights, *ways))
            np.add.at(by_states, columns, np.hstack(by_x).T)
            by_z[p.states :] += by_scalars.sum(axis=1)
            by_c[:] += by_values.sum(axis=1)

        rows = left[:inner].reshape(p.resolution, -1, n)
        at_stages = np.einsum("k,ij,kin->kjn", lengths, p.table.extended, rows).reshape(-1, n).T
        starts = np.cumsum(lengths) - lengths
        places = (starts[:, None] + lengths[:, None] * p.table.nodes).ravel()[None]
        part("field", [places], stages, -at_stages, count)
        own = left[inner:]
        if conditions and np.any(own[:conditions]):
            part("conditions", [], [0, p.columns - 1], own[:conditions], 1)
        if f.integrals and np.any(own[conditions:]):
            weights = np.outer(own[conditions:], np.outer(lengths, p.table.extended[-1]).ravel())
            part("integrands", [places], stages, weights, count)
        return by_z, by_c[: len(self.names)]


def _conditions(equations: Equations, z: Array) -> tuple[list[Array], list[Array], Array]:
    """The derivatives of the entries of G by the unknowns and the parameters, and the push of the own equations."""
    problem: Any = equations.problem
    border = problem.border(z)
    (copies, rows, width), rate = problem.copies, problem.singularity.rate
    by_z, by_c = [], []
    for psi in border.left.T:
        for v in border.right.T:
            slopes, more = problem.further_slopes(z, psi[:, None], v)[0], np.zeros(len(equations.names))
            if problem.singularity.autonomous:
                more = equations.at_start(z, problem.velocity_weights(psi[:, None], v)[0])
            for k in range(copies):
                left, way = np.zeros(problem.equations), np.zeros(z.size)
                left[:rows] = psi[k * rows :][:rows]
                way[:width] = v[k * width :][:width]
                own, others = equations.pulled(z, left, way)
                slopes, more = slopes - own / rate, more - others / rate
            by_z.append(slopes)
            by_c.append(more)
    return by_z, by_c, border.push


def derivatives(
    equations: Equations, z: Array, by_z: Array, by_c: Array, noise: np.random.Generator | None = None
) -> Array:
    """Derivatives of numbers of a solution by all parameters, in the order of `names`, shape (numbers, parameters).

    Arguments:
        equations, z: the solution; u is held.
        by_z, by_c: derivatives of the numbers where z, or the parameters, alone change, (numbers, size) and (numbers,
            parameters).
        noise: draws relative changes of the entries of the linear equations by their rounding, for its effect.

    Raises SingularError where the solution is not regular.
    """
    from scipy.sparse import coo_matrix, csc_matrix, diags, vstack
    from scipy.sparse.linalg import splu

    problem, more = equations.problem, list[Array]()
    matrix = equations.matrix(z)
    if isinstance(problem, Augmented):
        slopes, more, push = _conditions(equations, z)
        if problem.singularity.pushes:
            places = np.arange(push.size), np.full(push.size, problem.added_index)
            matrix = matrix + coo_matrix((push, places), shape=matrix.shape)
        matrix = vstack([matrix, csc_matrix(np.array(slopes))])
    columns = equations.lengths(z)[:-1]
    scaled = (matrix.tocsc()[:, :-1] @ diags(columns)).tocsc()
    if noise is not None:
        scaled.data *= 1.0 + _rounding(problem) * noise.normal(size=scaled.data.size)
    rows = np.asarray(abs(scaled).max(axis=1).todense()).ravel()
    scaled = (diags(1.0 / np.where(rows > 0.0, rows, 1.0)) @ scaled).tocsc()
    try:
        factors = splu(scaled.T.tocsc())
    except RuntimeError as error:
        raise SingularError(f"the solution is not regular: {error}") from error
    right = (by_z[:, :-1] * columns).T
    left: Any = factors.solve(right)
    left = left + factors.solve(right - scaled.T @ left)
    left = left / np.where(rows > 0.0, rows, 1.0)[:, None]
    if noise is not None:  # of F_c
        left = left * (1.0 + _rounding(problem) * noise.normal(size=left.shape))
    if not np.all(np.isfinite(left)):
        raise SingularError("the solution is not regular")
    own = scaled.shape[0] - len(more)
    found = np.array([equations.pulled(z, one[:own])[1] for one in left.T])
    for place, column in equations.by_switching(lambda moved: moved.problem.evaluate(z)[0].copy()).items():
        found[:, place] = left[:own].T @ column
    found = found + (left[own:].T @ np.array(more) if more else 0.0)
    return np.asarray(by_c - found)


def _rounding(problem: Any) -> float:
    model = problem.statics.model if isinstance(problem, AlgebraicProblem) else problem.statement.model
    return float(max(EPSILON, model.rounding))
