"""The derivatives of located values and of quantities of solutions by all other parameters, with their errors.

A special point is a regular solution of its augmented problem (see `zero.augmented`), of which the parameter that it
was found in is one unknown, and an orbit of its own equations: by one adjoint solve each, see `zero.adjoint`. The error
is the distance from the derivatives on a coarser mesh, and what rounding of the solution and of the linear equations
changes, drawn at random.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.follow.find import restated, with_amplitude
from casadi_skin.follow.follow import held_space
from casadi_skin.follow.normal_forms import critical_angle
from casadi_skin.follow.rest_space import EquilibriumSpace
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import FAMILY, ORBITS
from casadi_skin.follow.special_points import ROUNDING_DEVIATIONS, Located, SpecialPoint, locate, locate_rest
from casadi_skin.model.arguments import accepted_names, short_repr, state_by_name, truth, with_error
from casadi_skin.model.expressions import real_array
from casadi_skin.model.result import Result, in_turn
from casadi_skin.points.edges import edge_problem, parameters_of
from casadi_skin.points.targets import AtStart, Flow, Slopes, Target, target_of, unknown
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.zero.adjoint import Equations, derivatives
from casadi_skin.zero.kinds import BRANCH_POINT, EDGE, FOLD, HETEROCLINIC, HOMOCLINIC, HOPF
from casadi_skin.zero.problem import EPSILON, Array, Problem, SingularError
from casadi_skin.zero.rest import AlgebraicProblem, Course, Statics, sizes_of
from casadi_skin.zero.stated_problem import PERIOD

OFFSET_FROM_FOLD = 0.01  # along a family: from where its fold is located in another formulation
SHORTER_PERIOD = 0.85  # of the period of an orbit beside a connecting one: what it changes by is the error
ROUNDING_PROBES = 6  # solutions and linear equations off by rounding, of signs drawn at random
WIDER_DIFFERENCES = 2.0  # times the steps of differences of a program's derivatives, for their error
# Deviations of rounding beyond which a push of the equations makes a branch point none: those of 24 random symmetric
# models, whose coefficients are rounded, were up to 400, pushes that do are some 1e13.
UNFOLDING_DEVIATIONS = 1e8
NEGATIVE_VARIANCE = 1e-12  # of correlations: eigenvalues that are negative by rounding
# Beside an edge at which another branch crosses, of S: weights of the places, of orders four and two.
CROSSING_SIDES = -1e-3, -5e-4, 5e-4, 1e-3
CROSSING_WEIGHTS = np.array([[-1.0, 4.0, 4.0, -1.0], [0.0, 3.0, 3.0, 0.0]]) / 6.0


class NoGradientError(ValueError):
    """Points of this kind have no derivatives."""


@dataclass(frozen=True, eq=False)
class Gradient(Result, Mapping[str, float]):
    """Derivatives of a value by parameters, by their names: a mapping.

    Attributes:
        of: what the value is, in words.
        value: the value.
        slopes: the derivatives by name; NaN where the point is none at other values of the parameter.
        errors: their estimated absolute errors by name.
        held: what keeps its value, in words.
    """

    of: str
    value: float
    slopes: Mapping[str, float]
    errors: Mapping[str, float]
    held: str

    def __repr__(self) -> str:
        words = ", ".join(f"{name} {with_error(value, self.errors[name])}" for name, value in self.slopes.items())
        return f"<Gradient of {self.of}: {words or 'no other parameters'}>"

    def __getitem__(self, name: str) -> float:
        """The derivative by a parameter; raises KeyError for other names."""
        if name not in self.slopes:
            raise KeyError(accepted_names(name, self.slopes))
        return self.slopes[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.slopes)

    def __len__(self) -> int:
        return len(self.slopes)

    def spread(self, covariance: Mapping[str, float] | ArrayLike) -> float:
        """The standard deviation of the value to first order in that of the parameters.

        Arguments:
            covariance: standard deviations of independent parameters by name, others are exact; or the covariance
                matrix of all parameters in the order of this mapping, shape (parameters, parameters).

        Returns:
            sqrt(g^T C g), in units of the value.

        Raises:
            ValueError, TypeError: the argument is neither.
        """
        g = np.array(list(self.slopes.values()))
        if isinstance(covariance, Mapping):
            deviations = np.array(state_by_name("covariance", covariance, list(self.slopes)))
            C = np.diag(np.sign(deviations) * deviations**2)
        else:
            C = real_array("covariance", covariance)
        accepted = f"a symmetric matrix of shape ({g.size}, {g.size}), or standard deviations by name"
        if C.shape != (g.size, g.size):
            raise ValueError(f"covariance: given shape {C.shape}; accepted: {accepted}")
        units = np.sqrt(np.where(np.diag(C) > 0.0, np.diag(C), 1.0))
        R = C / np.outer(units, units)  # correlations
        if not np.allclose(R, R.T) or np.any(np.linalg.eigvalsh(R) < -NEGATIVE_VARIANCE):
            raise ValueError(f"covariance: given {short_repr(covariance)}, which is none; accepted: {accepted}")
        varies = np.any(C != 0.0, axis=0)  # derivatives by others may be none
        return float(np.sqrt(g[varies] @ C[np.ix_(varies, varies)] @ g[varies]))


@in_turn
def gradient(point: SpecialPoint, *, errors: bool = True) -> Gradient:
    """The derivatives of the located value of a special point by all other parameters, the point staying one.

    Arguments:
        point: a fold, a Hopf point or a branch point of equilibria; of orbits and boundary-value problems a fold, a
            period doubling, a torus or a branch point, and the Hopf point or the homoclinic or heteroclinic orbit at
            which a branch ends; of a family a fold, or the edge of a tongue (`Branch.edge`).
        errors: whether errors are estimated, which takes most of the time; they are infinite without.

    Returns:
        {parameter: derivative} with `errors`; NaN by a parameter that makes a branch point none.

    Raises:
        ValueError: the point is of another kind.
        ArithmeticError: its equations are not solved again, or singular.
    """
    truth("errors", errors)
    solution, name, value = point.solution, point.parameter, point.parameters[point.parameter]
    if solution.space.connects == FAMILY and (point.kind == EDGE or point.mu is not None):
        return _of_edge(point, errors)
    space, held = solution.space, f"all parameters but {name}, and the kind of the point"
    if point.kind in (HOMOCLINIC, HETEROCLINIC) and PERIOD in space.free:
        return _of_connection(point, held)
    located, extent = _located(point)
    if located is None:
        raise ArithmeticError(f"{space.model.name}: the {point.kind} is not found again: its equations are not solved")

    def target(problem: Any, z: Array) -> Slopes:
        pushed = [problem.added_index] if point.kind == BRANCH_POINT else []
        rows = np.array([unknown(problem, z, index, extent)[1] for index in (problem.first_index, *pushed)])
        return value, rows, np.zeros((len(rows), len(Equations.of(problem).names)))

    at, better = located.point, located.point.better
    finer = (better.problem, better.z) if better is not None and better.problem is not at.problem else None
    equations = Equations.of(at.problem)
    names = [known for known in equations.names if known in point.parameters and known not in equations.unknowns()]
    found = _with_errors(target, (at.problem, at.z), finer, names, errors)
    return _gradient(f"{name} at the {point.kind}", value, names, found, held)


def _located(point: SpecialPoint) -> tuple[Located | None, float]:
    """A special point as a solution of its augmented problem; and what its first parameter is multiplied by."""
    solution, name, kind = point.solution, point.parameter, point.kind
    space: Any = solution.space
    if kind == HOPF and space.connects == ORBITS and not space.kind:  # at which orbits shrink to an equilibrium
        values = {known: point.parameters[known] for known in space.model.parameter_names}
        statics, x = Statics(space.model, values), solution.evaluate(0.0)
        sizes, to = sizes_of(statics, [x]), values[name] + abs(space.to - space.begins)
        rest = EquilibriumSpace(statics, space.tolerance, "newton", sizes, parameter=name, to=to)
        return locate_rest(rest, HOPF, np.append(x / sizes, 0.0), 2j * np.pi / solution.period), to - values[name]
    if kind == FOLD and space.connects == FAMILY:
        amplitude = with_amplitude(space.coordinates.model)[1]
        solution = restated(_aside(solution), amplitude)
        space = replace(solution.space, parameter=amplitude, to=2.0 * point.parameters[name])
    elif space.connects == FAMILY or space.kind or not point.has_curve:
        accepted = "a fold, Hopf point, branch point, doubling or torus of a branch in a parameter, an edge of a tongue"
        raise NoGradientError(f"gradient: given a {kind}; accepted: {accepted}")
    if solution.is_equilibrium:
        near = 1j * point.frequency if kind == HOPF else None
        return locate_rest(space, kind, solution.point.z, near), space.course.extent
    return locate(space, kind, solution.point, critical_angle(kind, solution)), 1.0


def _aside(orbit: Solution) -> Solution:
    """An orbit of a family beside a fold, where it is regular at its S; raises ArithmeticError without one."""
    solver, point = orbit.space.point_solver, orbit.point
    row = solver.metric(point.problem, point.z) * point.tangent
    guess = point.z + OFFSET_FROM_FOLD * point.tangent
    correction = solver.correct(point.problem, guess, row, float(row @ guess), 1.0)
    found = None if correction is None else solver.refined(point.problem, correction, row)
    if found is None:
        raise ArithmeticError(f"no orbit is found beside the fold: {solver.failure}")
    return replace(orbit, point=found, exact={})


def _of_connection(point: SpecialPoint, held: str) -> Gradient:
    """Of a homoclinic or heteroclinic orbit: of an orbit of a long period that is held, with the parameter free.

    Both differ by what falls exponentially with the period, which shows in an orbit whose period is shorter.
    """
    solution, name = point.solution, point.parameter
    period, values = solution.period, {**solution.parameters, name: point.parameters[name]}
    free = [name if known == PERIOD else known for known in solution.statement.free]
    statement = replace(solution.statement, free=free, parameters=values)
    slowest = solution.t[np.argmin(np.linalg.norm(np.gradient(solution.states, solution.t, axis=0), axis=1))]
    found = list[Gradient]()
    for share in (1.0, SHORTER_PERIOD):
        cut = (1.0 - share) * period

        def guess(t: float, cut: float = cut) -> Array:
            return np.asarray(solution.evaluate((t if t < slowest - cut / 2 else t + cut) % period))

        stated = statement.with_parameters(**{PERIOD: share * period})
        found.append(gradient_of(stated.solve(guess, tolerance=solution.space.tolerance), name))
    one, other = found
    slopes = {known: value for known, value in one.items() if known in solution.space.model.parameter_names}
    errors = {known: one.errors[known] + abs(value - other[known]) for known, value in slopes.items()}
    return Gradient(f"{name} at the {point.kind}", values[name], slopes, errors, held)


def _of_edge(point: SpecialPoint, errors: bool) -> Gradient:
    """S of an edge of a tongue, where a function f(S, p) of the orbits of a family vanishes: dS/dp = -f_p/f_S.

    Orbits are those of boundary-value problems at their S, each with its own flow that f is of: see `Condition`. The
    finer mesh is at the zero of f. Where a branch of the same class crosses, an orbit is singular, and what orbits on
    both sides have is interpolated.
    """
    orbit, of, held = point.solution, f"S at the {point.kind}", "all parameters but S, and the kind of the point"
    family, amplitude = orbit.space.whole, with_amplitude(orbit.space.coordinates.model)[1]
    names = [name for name in parameters_of(orbit.space) if name != amplitude]
    S = point.parameters[point.parameter]
    if not names:
        return _gradient(of, S, names, np.empty((2, 0)), held)
    start, scale, frame = float(orbit.parameters[names[0]]), family.coordinates.scale, family.frame
    edge = edge_problem(orbit, S, Course(names[0], start, start + 1.0), (start,))
    frame = np.eye(scale.size) if frame is None else frame
    to_scaled, of_scaled = np.kron(np.eye(2), frame.T / scale), np.kron(np.eye(2), scale[:, None] * frame)

    def target(problem: Any, z: Array) -> Slopes:
        flow, x = Flow(problem, z), z[: problem.formulation.states]
        field = problem.formulation.field_function(0.0, x, *problem.repeated(z, 1))[0]
        direction = np.split(to_scaled @ np.array(field).ravel(), 2)[1]
        here = edge.condition(to_scaled @ flow.matrix @ of_scaled, direction, edge.edge.mu)
        by_z, by_c = flow.slopes(to_scaled.T @ here.a, of_scaled @ here.b)
        return here.value, by_z.real, by_c.real

    def at(side: float) -> Array:
        """Derivatives at an S beside that of the edge, or at the edge, and their errors, (2, names)."""
        solution = restated(edge.orbit(edge.begin + side * np.eye(3)[0]), "")
        space, problem = solution.space, solution.point.problem
        z = _polished(problem, solution.point.z, 1)
        if not side:
            value, by_z, by_c = target(problem, z)
            by_S = derivatives(Equations.of(problem), z, by_z[None], by_c[None])[0]
            ahead = value / by_S[list(problem.statement.values).index(amplitude)]
            values = {amplitude: solution.parameters[amplitude] - ahead}
            space = replace(space, statement=space.statement.with_parameters(**values))
        base = space.levels.problem(problem.resolution).with_constants(problem.constants)
        return _with_errors(target, (problem, z), _finer(space, base, z), names, errors, amplitude)

    sides, weights = (CROSSING_SIDES, CROSSING_WEIGHTS) if edge.crossed else ((0.0,), np.ones((2, 1)))
    slopes, off = np.array([at(side) for side in sides]).swapaxes(0, 1)
    best, other = weights @ slopes
    return _gradient(of, S, names, (best, np.abs(best - other) + np.abs(weights[0]) @ off), held)


def _gradient(of: str, value: float, names: Sequence[str], found: Iterable[Array], held: str) -> Gradient:
    """From derivatives and errors in the order of the names."""
    slopes, errors = (dict(zip(names, part.tolist(), strict=True)) for part in found)
    return Gradient(of, value, slopes, errors, held)


def _finer(space: Any, problem: Any, z: Array) -> tuple[Any, Array] | None:
    """A guess of a solution on a finer mesh, where there is one."""
    above = None if isinstance(problem, AlgebraicProblem) else space.levels.finer(problem)
    return None if above is None else (above, problem.prolong(z, above))


@in_turn
def gradient_of(solution: Solution, quantity: Any, *, fixed: str | None = None, errors: bool = True) -> Gradient:
    """The derivatives of a quantity of a solution by all parameters that it was solved at.

    Arguments:
        solution: an equilibrium, an orbit, or a solution of a boundary-value problem, also one of a curve of special
            points; an orbit of a family is first solved again as a boundary-value problem at its S.
        quantity: the name of a free parameter, "period" and "Omega" among them; of a state, at the start or at phase
            zero; of a state with "_min" or "_max" after it; "energy", "S" and "max_abs_multiplier" of an
            orbit, "max_growth" of an equilibrium; or an expression in states and parameters, at the
            start, as `monitors` of `follow` are.
        fixed: "period" or "frequency", as in `follow`: what keeps its value in place of what picks the orbit from
            its family.
        errors: as in `gradient`.

    Returns:
        {parameter: derivative} with `errors`: each with all other parameters held.

    Raises:
        ValueError: the solution has no such quantity, is at a kink of it, or has an objective.
        ArithmeticError: the solution is not regular, as at a fold.
    """
    truth("errors", errors)
    space: Any = solution.space
    family: Any = solution
    if space.connects == FAMILY:
        solution = restated(solution, "")
        space = solution.space
    if space.optimises:
        raise ValueError("gradient: given a solution with an objective; accepted: one without")
    problem, z = solution.point.problem, solution.point.z.copy()
    if fixed is not None:
        z[-1] = 0.0  # the branch begins at the solution then
        if solution.is_orbit:  # others are refused
            space = replace(space, statement=space.statement.with_parameters(**solution.parameters))
        space = held_space(space, fixed)
        problem = space.levels.problem(problem.resolution).with_constants(problem.constants)
    target, words = target_of(space, solution, quantity)
    if family.point.special in (BRANCH_POINT, FOLD) and not space.kind:
        raise SingularError(f"gradient: given the solution at a {family.point.special}, which is not regular")
    if solution.is_orbit and not np.any(np.ptp(solution.states, axis=0)):
        raise SingularError("gradient: given an orbit at rest, which is not regular; accepted: one beside it")
    names = [name for name in space.model.parameter_names if name not in space.free]
    at = problem, _polished(problem, z, 1)
    value = target(*at)[0]
    if not np.isfinite(value):
        raise ValueError(f"quantity: given {words}, which is {value:g} there; accepted: one that is finite")
    if isinstance(target, AtStart):
        target.check_smooth(*at, solution.error)
    if words == "energy" and not np.isclose(value, family.energy, rtol=1e-6):
        raise ValueError("quantity: given energy in a gauge, which parameters change; accepted: that of a model")
    found = _with_errors(target, at, _finer(space, problem, z), names, errors)
    picked = "" if fixed is None else f", and the {fixed}"
    return _gradient(words, value, names, found, f"all other parameters{picked}")


@in_turn
def spread(point: SpecialPoint, covariance: Mapping[str, float] | ArrayLike) -> float:
    """The standard deviation of the located value to first order; see `Gradient.spread`."""
    return gradient(point).spread(covariance)


def _polished(problem: Problem, z: Array, steps: int) -> Array:
    """A solution after Newton steps with u held."""
    for _ in range(steps):
        solve = BorderedSolver.of(problem).factor(z, problem.evaluate(z)[1], problem.parameter_row())
        z = z - solve(np.append(problem.evaluate(z)[0], 0.0))
    return z


def _with_errors(
    target: Target, at: tuple[Any, Array], finer: tuple[Any, Array] | None, names: Sequence[str], errors: bool,
    over: str = "",
) -> Array:  # fmt: skip
    """Derivatives of a target by the named parameters, of the finer mesh where there is one, and errors, (2, names).

    A second row of a target is what moves where a parameter unfolds the point; `over` names a parameter that moves so
    that the target keeps its value: its derivatives are those found.
    """

    def found(problem: Any, z: Array, widening: float = 1.0, noise: np.random.Generator | None = None) -> Array:
        equations = Equations.of(problem, widening)
        by_z, by_c = map(np.atleast_2d, target(problem, z)[1:])
        slopes = derivatives(equations, z, by_z, by_c, noise)
        chosen = slopes[:, [equations.names.index(name) for name in names]]
        return chosen / -slopes[:, [equations.names.index(over)]] if over else chosen

    own = best = found(*at)
    problem, z = at
    if not errors and len(own) == 1:  # what unfolds a branch point is seen by errors alone
        return np.vstack([own, np.full(own.shape, np.inf)])
    if finer is not None:
        problem, z = finer[0], _polished(*finer, 2)
        best = found(problem, z)
    alone = finer is None and not isinstance(problem, AlgebraicProblem)  # on the finest mesh that there is
    off, generator = np.abs(best - own) + (np.inf if alone else 0.0), np.random.default_rng(0)
    if Equations.of(problem).differs:
        off = off + np.abs(found(problem, z, WIDER_DIFFERENCES) - best)
    solve = BorderedSolver.of(problem).factor(z, problem.evaluate(z)[1], problem.parameter_row())
    rounding, probes = np.broadcast_to(problem.rounding(z), problem.size - 1), []
    for _ in range(ROUNDING_PROBES):
        signs = generator.choice([-1.0, 1.0], problem.size - 1)
        moved = z - solve(np.append(signs * rounding, 0.0))
        probes.append(found(problem, moved, noise=generator) - best)
    spread = np.sqrt(np.mean(np.array(probes) ** 2, axis=0))
    off = off + ROUNDING_DEVIATIONS * spread + EPSILON * np.abs(best)
    unfolds = np.any(np.abs(best[1:]) > UNFOLDING_DEVIATIONS * spread[1:], axis=0)
    return np.array([np.where(unfolds, np.nan, best[0]), off[0]])
