"""Points of codimension two on curves of folds and of Hopf points: where one condition more holds.

On a curve of folds: a cusp, where the quadratic coefficient is zero; a Bogdanov-Takens point, where a second real
eigenvalue is zero; a zero-Hopf point, where a pair is on the imaginary axis. On a curve of Hopf points: a
Bogdanov-Takens point, where the frequency is zero; a zero-Hopf point; a Hopf-Hopf point, where a second pair is on the
axis; a generalized Hopf (Bautin) point, where the first Lyapunov coefficient is zero (Kuznetsov 2004, chapter 8).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.points import Point
from casadi_skin.equilibria.crossings import End, Stretch, crossings, end_of, height, matched
from casadi_skin.equilibria.location import HOPF, jacobian_of
from casadi_skin.equilibria.normal_forms import critical_pair, lyapunov_terms
from casadi_skin.equilibria.statics import ComplexArray
from casadi_skin.equilibria.systems import ExtendedSystem, HopfSystem
from casadi_skin.orbits.special_points import NotLocatedError

if TYPE_CHECKING:
    from casadi_skin.equilibria.curve import CurveSpace

CUSP, TAKENS, ZERO_HOPF = "cusp", "bogdanov-takens", "zero-hopf"
BAUTIN, HOPF_HOPF = "generalized hopf", "hopf-hopf"
FINE = 1e-11  # of a step, to which a root is found
VANISHES = 1e-4  # of its terms: the first Lyapunov coefficient where it has a root
Test = Callable[[Point], float]


def special_on_curve(space: CurveSpace, before: Point, after: Point) -> Iterator[Point]:
    """Points of codimension two between two points of a curve, in order; raises NotLocatedError."""
    found = [_root(space, before, after, kind, test) for kind, test in _tests(space, before, after)]
    yield from (point for _, point in sorted(found, key=lambda entry: entry[0]) if not _is_pole(space, point))


def _is_pole(space: CurveSpace, point: Point) -> bool:
    """Whether the first Lyapunov coefficient changes its sign through infinity, as it does at a zero-Hopf point."""
    if point.special != BAUTIN:
        return False
    terms = _lyapunov(space, point)
    return bool(abs(np.sum(terms)) > VANISHES * np.sum(np.abs(terms)))


def _tests(space: CurveSpace, before: Point, after: Point) -> Iterator[tuple[str, Test]]:
    """Kinds of the points that are passed, each with a function that changes its sign there."""
    hopf = space.kind == HOPF
    curve, length = space.point_solver.curve(before, after)
    ends = [_others(space, end_of(p, curve.slope(s))) for p, s in ((before, 0.0), (after, length))]
    stretch = Stretch(ends[0], ends[1], curve, length)
    if hopf and _kappa(before) * _kappa(after) < 0.0:
        yield TAKENS, _kappa
        return
    if not hopf:
        quadratic = _quadratic(space, before)
        if quadratic(before) * quadratic(after) < 0.0:
            yield CUSP, quadratic
    order = matched(stretch)
    reals, pairs = crossings(stretch, order)
    for _ in reals:
        yield (ZERO_HOPF if hopf else TAKENS), _tracked(space, 0j)
    for place in pairs:
        at = 1j * height(stretch.first.values[place], stretch.last.values[order][place])
        yield (HOPF_HOPF if hopf else ZERO_HOPF), _tracked(space, at)
    if hopf:

        def lyapunov(point: Point) -> float:
            return float(np.sum(_lyapunov(space, point)))

        try:
            if lyapunov(before) * lyapunov(after) < 0.0:
                yield BAUTIN, lyapunov
        except RuntimeError:  # the model has no third derivatives
            return


def _quadratic(space: CurveSpace, reference: Point) -> Test:
    """The quadratic coefficient of a fold, with the left null vector turned as at a reference."""
    n = space.statics.size

    def left(point: Point) -> Array:
        return np.asarray(np.linalg.svd(jacobian_of(cast(ExtendedSystem, point.problem), point.z))[0][:, -1])

    first = left(reference)

    def test(point: Point) -> float:
        problem, psi, v = cast(ExtendedSystem, point.problem), left(point), space.sizes * point.z[n : 2 * n]
        curved = space.statics.second(problem.state(point.z), problem.parameters(point.z), v, v).real / space.sizes
        return float(psi @ curved) * float(np.sign(psi @ first))

    return test


def _kappa(point: Point) -> float:
    return cast(HopfSystem, point.problem).kappa(point.z)


def _others(space: CurveSpace, end: End) -> End:
    """An end without its critical eigenvalues: the zero of a fold, the pair of a Hopf point."""
    keep = np.ones(end.values.size, dtype=bool)
    keep[_critical(space, end.point, end.values)] = False
    return replace(end, values=end.values[keep], rates=end.rates[keep])


def _critical(space: CurveSpace, point: Point, values: ComplexArray) -> list[int]:
    """Places of the critical eigenvalues."""
    if space.kind != HOPF:
        return [int(np.argmin(np.abs(values)))]
    system = cast(HopfSystem, point.problem)
    omega = system.rate * np.sqrt(complex(system.kappa(point.z)))
    first = int(np.argmin(np.abs(values - 1j * omega)))
    rest = np.abs(values + 1j * omega)
    rest[first] = np.inf
    return [first, int(np.argmin(rest))]


def _tracked(space: CurveSpace, at: complex) -> Test:
    """The real part of the eigenvalue, but the critical ones, that is nearest to a place on the imaginary axis.

    Near zero its sum with the zero of a fold is taken, which is smooth where both are one.
    """

    def test(point: Point) -> float:
        matrix = jacobian_of(cast(ExtendedSystem, point.problem), point.z)
        values = np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
        critical = _critical(space, point, values)
        others = np.delete(values, critical)
        nearest = others[np.argmin(np.abs(others - at))]
        return float((nearest + (values[critical[0]] if at == 0 and space.kind != HOPF else 0.0)).real)

    return test


def _lyapunov(space: CurveSpace, point: Point) -> Array:
    """The terms of the first Lyapunov coefficient at a point of a curve of Hopf points."""
    problem = cast(ExtendedSystem, point.problem)
    x, p = problem.state(point.z), problem.parameters(point.z)
    A = space.statics.jacobian(x, p)
    near = cast(HopfSystem, problem)
    omega, q, adjoint = critical_pair(A, near.rate * float(np.sqrt(max(near.kappa(point.z), 0.0))))
    return lyapunov_terms(space.statics, x, p, A, omega, q, adjoint)


def _root(space: CurveSpace, before: Point, after: Point, kind: str, test: Test) -> tuple[float, Point]:
    """The point between two where a test vanishes, with its place; raises NotLocatedError."""
    from scipy.optimize import brentq

    known = {0.0: before, 1.0: after}

    def value(fraction: float) -> float:
        if fraction not in known:
            point = space.point_solver.along(before, after, fraction)
            if point is None:
                raise NotLocatedError(f"a point of kind {kind} cannot be located: {space.point_solver.failure}")
            known[fraction] = point
        return test(known[fraction])

    root = float(brentq(value, 0.0, 1.0, xtol=FINE))
    value(root)
    point = known[root]
    beside = sorted(known, key=lambda fraction: abs(fraction - root))[1]
    width = abs(float(known[beside].z[-1] - point.z[-1])) if abs(beside - root) < 1e-6 else FINE
    _, length = space.point_solver.curve(before, after)
    moved = min(width, 10.0 * FINE * length) + point.error.relative(1.0)
    error = replace(point.error, parameter=float(moved))
    return root, replace(point, error=error, requested=False, walked=False, special=kind)
