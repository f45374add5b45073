"""Boundary-value problems of the test set of Cash and Mazzia, beside scipy's solve_bvp: errors and times of both.

34 problems (https://archimede.uniba.it/~bvpsolvers/testsetbvpsolvers, numbers 1 to 35 but for 34, which is Bratu's and
has no layer), each at three values of its parameter, at the tolerance 1e-6, from straight lines between the values at
the ends. Errors are those of the first component, relative to its largest value: true ones where the solution is known
in closed form, else the difference of both programs.

Run: python tests/benchmarks/boundary_test_set.py, which prints a table, or with numbers of problems after it.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp
from scipy.special import erf, hyp1f1

from casadi_skin import BoundaryValueProblem, OdeModel
from casadi_skin.follow.space import BoundaryError

Array = NDArray[np.float64]
TOLERANCE = 1e-6
NODES = 20_000  # that solve_bvp may use: with 100,000 it takes 6 GB for number 27
PI = np.pi
Rates = Callable[..., Sequence[Any]]  # of the functions' module, x, the states and eps


@dataclass(frozen=True)
class Case:
    """States' rates; values at the ends by place, functions of eps; parameters; the interval; the solution if known."""

    rates: Rates
    left: dict[int, Callable[[float], float]]
    right: dict[int, Callable[[float], float]]
    eps: tuple[float, ...]
    interval: tuple[float, float] = (0.0, 1.0)
    exact: Callable[[Array, float], Array] | None = None

    @property
    def size(self) -> int:
        """Number of states: as many as conditions."""
        return len(self.left) + len(self.right)


def second(force: Rates, ends: Sequence[Any], eps: tuple[float, ...], *rest: Any) -> Case:
    """u'' = force with u held at both ends."""
    left, right = ({0: end if callable(end) else (lambda e, end=end: end)} for end in ends)
    return Case(lambda m, x, u, v, e: (v, force(m, x, u, v, e)), left, right, eps, *rest)


def known(force: Rates, exact: Callable[[Array, float], Array], eps: tuple[float, ...], start: float = 0.0) -> Case:
    """u'' = force with the values of a known solution at the ends."""
    ends = [lambda e, x=x: float(exact(np.array([x]), e)[0]) for x in (start, 1.0)]
    return second(force, ends, eps, (start, 1.0), exact)


def _cosine(x: Array, e: float) -> Array:
    return np.cos(PI * x)


def _both_ends(left: bool, right: bool) -> Callable[[Array, float], Array]:
    """cos(pi x) with layers at the ends of (-1, 1), which solve eps u'' = u each by itself."""

    def exact(x: Array, e: float) -> Array:
        r, whole = np.sqrt(e), 1.0 - np.exp(-4.0 / np.sqrt(e))
        at_left = (np.exp(-(x + 1) / r) - np.exp((x - 3) / r)) / whole
        at_right = (np.exp((x - 1) / r) - np.exp(-(x + 3) / r)) / whole
        return np.asarray(np.cos(PI * x) + left * at_left + right * at_right)

    return exact


def _corner(x: Array, e: float) -> Array:
    r = np.sqrt(2 * e)
    tail, end = (np.sqrt(2 * e / PI) * np.exp(-z * z / (2 * e)) for z in (x, 1.0))
    return np.asarray(np.cos(PI * x) + x + (x * erf(x / r) + tail) / (erf(1 / r) + end))


def _log_cosh(x: Array, e: float) -> Array:
    s = np.abs(x - 0.745) / e
    return np.asarray(1 + e * (s + np.log1p(np.exp(-2 * s)) - np.log(2)))


def _resonance(x: Array, e: float) -> Array:
    """An odd and an even solution; what changes the first by itself is 1 in exp(1/(2 eps)), and no double."""
    even = hyp1f1(-0.5, 0.5, x * x / (2 * e)) / hyp1f1(-0.5, 0.5, 1 / (2 * e))
    return np.asarray(0.5 * x + 1.5 * even)


def _nozzle(m: Any, x: Any, u: Any, v: Any, e: Any) -> Any:
    A, slope, g = 1 + x * x, 2 * x, 1.4
    return (((1 + g) / 2 - e * slope) * u * v - v / u - slope / A * (1 - (g - 1) * u * u / 2)) / (e * A * u)


def _beam(m: Any, x: Any, y: Any, angle: Any, moment: Any, force: Any, e: Any) -> Sequence[Any]:
    tension = 1 / m.cos(angle) + e * force * m.tan(angle)
    return m.sin(angle), moment, -force / e, ((y - 1) * m.cos(angle) - moment * tension) / e


def _cole(m: Any, x: Any, u: Any, v: Any, e: Any) -> Any:
    return (u - u * v) / e


L, M, H = (1e-1, 1e-2, 1e-3), (1e-2, 1e-3, 1e-4), (0.05, 0.02, 0.01)
COLE = ((-1 / 3, 1 / 3), (1, -1 / 3), (1, 1 / 3), (1, 3 / 2), (0, 3 / 2), (-7 / 6, 3 / 2))
CASES: dict[int, Case] = {
    1: known(lambda m, x, u, v, e: u / e, lambda x, e: (np.exp(-x / np.sqrt(e)) - np.exp((x - 2) / np.sqrt(e)))
             / (1 - np.exp(-2 / np.sqrt(e))), L),
    2: known(lambda m, x, u, v, e: v / e, lambda x, e: np.expm1((x - 1) / e) / np.expm1(-1 / e), L),
    3: known(lambda m, x, u, v, e: (u - (2 + m.cos(PI * x)) * v - (1 + e * PI**2) * m.cos(PI * x)
             - (2 + m.cos(PI * x)) * PI * m.sin(PI * x)) / e, _cosine, L, -1.0),
    4: known(lambda m, x, u, v, e: ((1 + e) * u - v) / e,
             lambda x, e: np.exp(x - 1) + np.exp(-(1 + e) * (1 + x) / e), L, -1.0),
    5: known(lambda m, x, u, v, e: (x * v + u - (1 + e * PI**2) * m.cos(PI * x) + PI * x * m.sin(PI * x)) / e,
             _cosine, L, -1.0),
    6: known(lambda m, x, u, v, e: (-x * v - e * PI**2 * m.cos(PI * x) - PI * x * m.sin(PI * x)) / e,
             lambda x, e: np.cos(PI * x) + erf(x / np.sqrt(2 * e)) / erf(1 / np.sqrt(2 * e)), M, -1.0),
    7: known(lambda m, x, u, v, e: (-x * v + u - (1 + e * PI**2) * m.cos(PI * x) - PI * x * m.sin(PI * x)) / e,
             _corner, M, -1.0),
    8: known(lambda m, x, u, v, e: -v / e,
             lambda x, e: (2 - np.exp(-1 / e) - np.exp(-x / e)) / (1 - np.exp(-1 / e)), L),
    9: known(lambda m, x, u, v, e: -(4 * x * v + 2 * u) / (e + x * x), lambda x, e: 1 / (e + x * x), L, -1.0),
    10: known(lambda m, x, u, v, e: -x * v / e,
              lambda x, e: 1 + erf(x / np.sqrt(2 * e)) / erf(1 / np.sqrt(2 * e)), M, -1.0),
    11: known(lambda m, x, u, v, e: (u - (1 + e * PI**2) * m.cos(PI * x)) / e, _cosine, M, -1.0),
    12: known(lambda m, x, u, v, e: (u - (1 + e * PI**2) * m.cos(PI * x)) / e, _both_ends(False, True), M, -1.0),
    13: known(lambda m, x, u, v, e: (u - (1 + e * PI**2) * m.cos(PI * x)) / e, _both_ends(True, False), M, -1.0),
    14: known(lambda m, x, u, v, e: (u - (1 + e * PI**2) * m.cos(PI * x)) / e, _both_ends(True, True), M, -1.0),
    15: second(lambda m, x, u, v, e: x * u / e, (1.0, 1.0), (5e-3, 3e-3, 1e-4), (-1.0, 1.0)),
    16: known(lambda m, x, u, v, e: -((PI / 2) ** 2) * u / e**2, lambda x, e: np.sin(PI * x / (2 * e)),
              (0.11, 1 / 15, 1 / 41)),
    17: Case(lambda m, x, u, v, e: (v, -3 * e * u / (e + x * x) ** 2),
             {0: lambda e: -0.1 / np.sqrt(e + 0.01)}, {0: lambda e: 0.1 / np.sqrt(e + 0.01)}, (1e-2, 1e-4, 1e-6),
             (-0.1, 0.1), lambda x, e: x / np.sqrt(e + x * x)),
    18: known(lambda m, x, u, v, e: -v / e, lambda x, e: np.exp(-x / e), L),
    19: second(lambda m, x, u, v, e: (PI / 2 * m.sin(PI * x / 2) * m.exp(2 * u) - m.exp(u) * v) / e, (0.0, 0.0), H),
    20: known(lambda m, x, u, v, e: (1 - v * v) / e, _log_cosh, (0.5, 0.1, 0.06)),
    21: known(lambda m, x, u, v, e: (u + u * u - m.exp(-2 * x / m.sqrt(e))) / e,
              lambda x, e: np.exp(-x / np.sqrt(e)), M),
    22: second(lambda m, x, u, v, e: -(v + u * u) / e, (0.0, 0.5), L),
    23: second(lambda m, x, u, v, e: m.sinh(u / e) / e, (0.0, 1.0), (1 / 5, 1 / 7, 1 / 9)),
    24: second(_nozzle, (0.9129, 0.375), (5e-2, 1e-2, 1e-3)),
    **{25 + k: second(_cole, ends, L) for k, ends in enumerate(COLE)},
    31: Case(_beam, {0: lambda e: 0.0, 2: lambda e: 0.0}, {0: lambda e: 0.0, 2: lambda e: 0.0}, (0.1, 0.05, 0.01)),
    32: Case(lambda m, x, a, b, c, d, e: (b, c, d, (b * c - a * d) / e), {0: lambda e: 0.0, 1: lambda e: 0.0},
             {0: lambda e: 1.0, 1: lambda e: 0.0}, (1e-2, 1e-3, 1e-4)),
    33: Case(lambda m, x, a, b, c, d, f, g, e: (b, c, d, (a * d - f * g) / e, g, (f * b - a * g) / e),
             {0: lambda e: 0.0, 1: lambda e: 0.0, 4: lambda e: -1.0},
             {0: lambda e: 0.0, 1: lambda e: 0.0, 4: lambda e: 1.0}, L),
    35: second(lambda m, x, u, v, e: (x * v - u) / e, (1.0, 2.0), L, (-1.0, 1.0), _resonance),
}  # fmt: skip


def guess(case: Case, e: float, x: Array) -> Array:
    """Straight lines between the values at the ends, and their slopes as the next states; shape (states, places)."""
    start, end = case.interval
    values = np.zeros((case.size, x.size))
    for k in range(case.size):
        first, last = case.left.get(k), case.right.get(k)
        if first is not None and last is not None:
            slope = (last(e) - first(e)) / (end - start)
            values[k] = first(e) + slope * (x - start)
            if k + 1 < case.size and k + 1 not in case.left:
                values[k + 1] = slope
    return values


def here(case: Case, e: float) -> tuple[Any, str, float]:
    """The solution by this package, what it tells or how it refuses, and the seconds of the whole call."""
    x, eps, y = ca.SX.sym("x"), ca.SX.sym("eps"), [ca.SX.sym(f"y{k + 1}") for k in range(case.size)]
    rates, ends = ca.vertcat(*case.rates(ca, x, *y, eps)), np.array(case.interval)
    timed = {"time": x, "forcing_period": 1.0} if ca.depends_on(rates, x) else {}
    began = time.perf_counter()
    model = OdeModel("case", ca.vertcat(*y), rates, eps, **timed)
    conditions = [model.start(y[k]) - value(e) for k, value in case.left.items()]
    conditions += [model.end(y[k]) - value(e) for k, value in case.right.items()]
    problem = BoundaryValueProblem(model, conditions, interval=case.interval, parameters={"eps": e})
    try:
        found = problem.solve((ends, guess(case, e, ends).T), tolerance=TOLERANCE)
    except BoundaryError as error:
        return None, str(error), time.perf_counter() - began
    return found, found.found_by, time.perf_counter() - began


def scipys(case: Case, e: float) -> tuple[Any, str, float]:
    """The same by solve_bvp."""

    def fun(x: Array, y: Array) -> Array:
        return np.stack([np.broadcast_to(rate, x.shape) for rate in case.rates(np, x, *y, e)])

    def ends(a: Array, b: Array) -> Array:
        first = [a[k] - value(e) for k, value in case.left.items()]
        return np.array([*first, *(b[k] - value(e) for k, value in case.right.items())])

    x = np.linspace(*case.interval, 11)
    began = time.perf_counter()
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            found = solve_bvp(fun, ends, x, guess(case, e, x), tol=TOLERANCE, max_nodes=NODES)
        except (ValueError, SystemError, MemoryError, np.linalg.LinAlgError) as error:
            return None, str(error), time.perf_counter() - began
    return (found if found.success else None), str(found.message), time.perf_counter() - began


def places(case: Case) -> Array:
    """Places all over the interval, and densely at its ends and in its middle, where layers are."""
    start, end = case.interval
    near = np.geomspace(1e-5, 0.1, 300) * (end - start)
    middle = 0.5 * (start + end)
    x = np.concatenate([np.linspace(start, end, 2001), start + near, end - near, middle + near, middle - near])
    return np.unique(x)


@dataclass(frozen=True)
class Result:
    """One problem at one eps: errors, None where refused; whether they are true; seconds; what was told."""

    number: int
    eps: float
    ours: float | None
    scipy: float | None
    true: bool
    estimate: float
    seconds: tuple[float, float]
    told: str


def compare(number: int, e: float) -> Result:
    """Both programs on one problem."""
    case = CASES[number]
    (mine, told, time_here), (theirs, _, time_there) = here(case, e), scipys(case, e)
    x = places(case)
    values = [None if s is None else f(x) for s, f in (
        (mine, lambda t: mine.evaluate(t)[:, 0]), (theirs, lambda t: theirs.sol(t)[0]))]  # fmt: skip
    reference = None if case.exact is None else case.exact(x, e)
    other = [values[1], values[0]]
    errors: list[float | None] = []
    for k, value in enumerate(values):
        to = reference if reference is not None else other[k]
        if value is None:
            errors.append(None)
        else:
            errors.append(np.nan if to is None else float(np.max(np.abs(value - to)) / np.max(np.abs(to))))
    estimate = np.nan if mine is None else mine.error
    return Result(number, e, errors[0], errors[1], reference is not None, estimate, (time_here, time_there), told)


def main(numbers: Sequence[int] = ()) -> list[Result]:
    """All results, in order."""
    return [compare(number, e) for number in (numbers or CASES) for e in CASES[number].eps]


def shown(error: float | None, refused: str) -> str:
    """An error as a table shows it."""
    if error is None:
        return refused
    return "alone" if np.isnan(error) else f"{error:.0e}"


if __name__ == "__main__":
    print("| no. | eps | error here | estimated | error of solve_bvp | true | s here | s solve_bvp | told |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for number in [int(a) for a in sys.argv[1:]] or CASES:
        for r in (compare(number, e) for e in CASES[number].eps):
            cells = [str(r.number), f"{r.eps:.3g}", shown(r.ours, "refused"), f"{r.estimate:.0e}"]
            cells += [shown(r.scipy, "failed"), "yes" if r.true else "no", *(f"{s:.2f}" for s in r.seconds), r.told]
            print(f"| {' | '.join(cells)} |", flush=True)
