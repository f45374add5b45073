"""Parameters from a measured bifurcation diagram: least squares on gradients of located solutions.

    minimise |r(p)|^2/2 over p within bounds,   r_i = (x_i(p) - m_i)/s_i,

where x_i(p) is the place of a special point, or another quantity of a solution, m_i what was measured and s_i its
standard deviation. Everything is located again at every p as designs are (`designs.Search`). With J = dr/dp at the
least, shape (measured, over), the covariance of p is (J^T J)^-1 to first order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.follow.solution import Solution
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.model.arguments import check_name, number, short_repr, with_error
from casadi_skin.model.result import Result, in_turn
from casadi_skin.search.design_problem import DesignProblem
from casadi_skin.search.designs import Search
from casadi_skin.solve.processes import Report
from casadi_skin.zero.problem import Array

LEAST_SQUARES_RTOL = 1e-10  # of the sum of squares, of parameters and of gradients, at which the least is reached
SMALLEST_SINGULAR_RATIO = 1e-9  # of J over ranges, below which its error decides: derivatives have some ten digits
LARGEST_STEP_LEFT = 1e-3  # of the deviations: the next step of Gauss and Newton's method from a least sum of squares
ITEM_WORDS = "(special point, value, standard deviation), or (solution, quantity, value, standard deviation)"


@dataclass(frozen=True, eq=False)
class Fit(Result):
    """Parameters that fit measured quantities best, with what is located there.

    Attributes:
        values: of the parameters, by name, with standard `deviations`, to first order and as if without bounds.
        correlation: of the parameters, in this order, shape (over, over).
        measured: what was measured: quantity, value and standard deviation.
        residuals: what is located minus what is measured, over its deviation, shape (measured,).
        located: the special points and solutions at the fit, in the order of what was measured.
        found: whether the sum of squares is least there, by the next step, a small part of the deviations; how the
            search ended in `reason`.
    """

    values: Mapping[str, float]
    deviations: Mapping[str, float]
    correlation: Array
    measured: tuple[tuple[str, float, float], ...]
    residuals: Array
    located: tuple[Any, ...]
    found: bool
    reason: str

    def __repr__(self) -> str:
        named = ", ".join(f"{name} {with_error(value, self.deviations[name])}" for name, value in self.values.items())
        return f"<Fit: {named}; {self.reason}>"

    def __getitem__(self, name: str) -> float:
        """A parameter; raises KeyError for other names."""
        return self.values[name]

    @property
    def chi_square(self) -> float:
        """The sum of squares of the residuals, which in the mean is their number less that of parameters."""
        return float(self.residuals @ self.residuals)


@in_turn
def fit_parameters(
    measured: Sequence[tuple[Any, ...]],
    *,
    over: Sequence[str],
    bounds: Mapping[str, Any] | None = None,
    progress: Report | None = None,
) -> Fit:
    """Find the parameters at which special points and solutions are where they were measured, by least squares.

    Arguments:
        measured: a list of (special point, value, standard deviation): the value is that of the parameter in which the
            point was located; or of (solution, quantity, value, standard deviation), with a name that `optimise`
            takes. The points and solutions are those of the model at the first guess.
        over: names of the parameters that are fitted; all others keep the values of each point.
        bounds: (lower, upper) of these by name, None where there is none.
        progress: called with a `SearchProgress` at every set of parameters.

    Returns:
        The `Fit`; `found` says whether its sum of squares is least.

    Raises:
        ValueError, TypeError: arguments that are not accepted, before anything is solved.
        ArithmeticError: not everything is located at the start, or the measured quantities do not determine the
            parameters.
    """
    from scipy.optimize import least_squares

    problem, rows = _stated(measured, over, bounds)
    search, nothing = Search(problem, progress), np.full((len(rows), 1 + len(problem.over)), np.nan)

    def located(p: Array) -> tuple[Array, Array]:
        """Residuals and their derivatives; not numbers where not everything is located, which shortens the step."""
        found = search.rows(p)
        return (nothing[:, 0], nothing[:, 1:]) if found is None else (found[0][1:], found[1][1:])

    (start,), scales, names = problem.places(1, 0), problem.scales, ", ".join(problem.over)
    residuals, J = located(start)
    if not np.all(np.isfinite(residuals)):
        raise ArithmeticError(f"fit_parameters: not all is located at the start, with derivatives by {names}")
    _covariance(problem, J)  # before the search wanders along what is not determined
    stops = dict.fromkeys(("ftol", "xtol", "gtol"), LEAST_SQUARES_RTOL)
    least: Any = least_squares  # its stub wants arguments of every method
    end = least(lambda p: located(p)[0], start, lambda p: located(p)[1], problem.ends, x_scale=scales, **stops)
    residuals, J = located(end.x)
    covariance = _covariance(problem, J)
    deviations, free = np.sqrt(np.diag(covariance)), end.active_mask == 0
    step = np.linalg.lstsq((J * deviations)[:, free], residuals)[0]
    found = bool(np.all(np.abs(step) <= LARGEST_STEP_LEFT))
    held = ", ".join(name for name, inside in zip(problem.over, free, strict=True) if not inside)
    reason = f"{'the' if found else 'no'} least sum of squares; {len(search.path)} sets of parameters"
    values, errors = (dict(zip(problem.over, numbers.tolist(), strict=True)) for numbers in (end.x, deviations))
    located_there = tuple(search.known[-1].things[n].solution for n, *_ in rows)
    return Fit(
        values, errors, covariance / np.outer(deviations, deviations), tuple(row[1:] for row in rows), residuals,
        located_there, found, reason + (f"; on a bound: {held}" if held else ""),
    )  # fmt: skip


def _covariance(problem: DesignProblem, J: Array) -> Array:
    """(J^T J)^-1; raises ArithmeticError where it is singular."""
    _, singular, right = np.linalg.svd(J * problem.scales, full_matrices=False)
    if len(J) < J.shape[1] or not singular[-1] > SMALLEST_SINGULAR_RATIO * singular[0]:
        raise ArithmeticError(f"fit_parameters: what is measured does not determine {', '.join(problem.over)}")
    root = right.T / singular * problem.scales[:, None]
    return np.asarray(root @ root.T)


def _stated(measured: Any, over: Any, bounds: Any) -> tuple[DesignProblem, list[tuple[int, str, float, float]]]:
    """The problem whose constraints are the residuals; and of each the thing, quantity, value and deviation."""
    if not isinstance(measured, list | tuple) or not measured:
        raise TypeError(f"measured: given {short_repr(measured)}; accepted: a list of {ITEM_WORDS}")
    things, rows = dict[int, Any](), list[tuple[int, str, float, float]]()
    names = over if isinstance(over, list | tuple) else [over]
    for k, item in enumerate(measured, start=1):
        place = f"measured, item {k}"
        known = isinstance(item, tuple | list) and item and isinstance(item[0], SpecialPoint | Solution)
        if not known or len(item) != 4 - isinstance(item[0], SpecialPoint):
            raise TypeError(f"{place}: given {short_repr(item)}; accepted: {ITEM_WORDS}")
        thing, quantity = item[0], item[0].parameter if len(item) == 3 else item[1]
        value, deviation = number(place, item[-2]), number(place, item[-1])
        if not deviation > 0.0:
            raise ValueError(f"{place}: given the standard deviation {deviation:g}; accepted: one > 0")
        if any(isinstance(name, str) and name == quantity for name in names):
            raise ValueError(f"over: given {quantity}, which item {k} of measured locates; accepted: other parameters")
        things.setdefault(id(thing), thing)
        rows.append((list(things).index(id(thing)), quantity, value, deviation))

    def residuals(*known: Any) -> ca.SX:
        return ca.vertcat(*((known[n].value(quantity) - value) / s for n, quantity, value, s in rows))

    def misfit(*known: Any) -> ca.SX:
        return ca.sumsqr(residuals(*known)) / 2

    problem = DesignProblem.of(misfit, list(things.values()), over, [(residuals, None, None)], bounds, False)
    for name in bounds or {}:
        check_name("bounds", name, problem.named)
    return problem, rows
