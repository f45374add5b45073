"""Points of codimension two on curves of folds, branch points and Hopf points: where one condition more holds.

On a curve of folds: a cusp, where the quadratic coefficient is zero; a Bogdanov-Takens point, where a second real
eigenvalue is zero; a zero-Hopf point, where a pair is on the imaginary axis. On a curve of branch points the last two,
the first a double branch point where the second eigenvalue has an eigenvector of its own; and a degenerate pitchfork or
transcritical point, where the cubic coefficient is zero or, without a symmetry, the quadratic one.
On a curve of Hopf points: a Bogdanov-Takens point, where the frequency is zero; a zero-Hopf point; a Hopf-Hopf point,
where a second pair is on the axis; a generalized Hopf (Bautin) point, where the first Lyapunov coefficient is zero
(Kuznetsov 2004, chapter 8).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from casadi_skin.follow.branch_points import double_between
from casadi_skin.follow.equilibrium_equations import EquilibriumEquations
from casadi_skin.follow.location import jacobian_of
from casadi_skin.follow.rest_events import EquilibriumSearch
from casadi_skin.follow.rest_normal_forms import critical_pair, lyapunov_terms
from casadi_skin.follow.search import Sample, Stretch, crossings, height, less
from casadi_skin.follow.special_points import TEST_ZERO_XTOL, zero_between
from casadi_skin.zero.augmented import ExtendedSystem, HopfSystem
from casadi_skin.zero.kinds import (
    BAUTIN,
    BRANCH_POINT,
    CUSP,
    DEGENERATE_PITCHFORK,
    DEGENERATE_TRANSCRITICAL,
    FOLD,
    HOPF,
    HOPF_HOPF,
    TAKENS,
    ZERO_HOPF,
    Unresolved,
)
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import Point
from casadi_skin.zero.statics import ComplexArray, NullSpace, Statics

VANISHING_TEST_RATIO = 1e-3  # of a test at the ends of a stretch: it is less at a root, and more at a pole
SYMMETRIC_TERM_RATIO = 1e-9  # of all terms: a quadratic coefficient that a symmetry makes zero
CURVE_DIFFERENCE_STEP = 1e-6  # of the unknowns: a step along a curve, for rates
NEAR_END = 6  # divisions of a step after which a curve of Hopf points is taken to end in a Bogdanov-Takens point
Test = Callable[[Point], float]


@dataclass(frozen=True, eq=False)
class Followed:
    """Folds, Hopf points or branch points (`kind`) that are followed, by their equations."""

    equations: EquilibriumEquations
    kind: str


def special_on_curve(space: Followed, before: Point, after: Point) -> Iterator[Point | Unresolved]:
    """Points of codimension two between two points of a curve, in order, and parts of it that are not resolved.

    Raises NotLocatedError.
    """
    all_found = list(_Search(space, before).between(before, after))
    found = [point for point in all_found if isinstance(point, Point)]
    yield from (part for part in all_found if isinstance(part, Unresolved))
    if space.kind == HOPF and not space.equations.statics.exact and not any(p.special == TAKENS for p in found):
        found += _by_differences(space, before, after)
        found.sort(key=lambda point: float(before.tangent @ (point.z - before.z)))
    yield from found


def _by_differences(space: Followed, before: Point, after: Point) -> Iterator[Point]:
    """The generalized Hopf point between two of a program, whose higher derivatives are differences.

    None is sought where l1 at both ends is smaller than what twice the steps of differences change.
    """

    def l1(point: Point) -> float:
        return float(np.sum(_lyapunov(space, point))) if _kappa(point) > 0.0 else np.inf

    def noise(point: Point) -> float:
        equations = space.equations
        statics = replace(equations.statics, widening=2.0)
        return abs(float(np.sum(_lyapunov(space, point, statics))) - l1(point))

    ends = [l1(point) for point in (before, after)]
    larger = before if abs(ends[0]) > abs(ends[1]) else after
    if not ends[0] * ends[1] < 0.0 or max(np.abs(ends)) <= noise(larger):
        return
    located = _root(space, before, after, BAUTIN, l1)
    if located is None:
        return
    point = located[1]
    slope = (ends[1] - ends[0]) / (after.z[-1] - before.z[-1])
    moved = float(abs((noise(point) + abs(l1(point))) / slope))
    yield replace(point, error=replace(point.error, parameter=point.error.parameter + moved))


class _Search(EquilibriumSearch):
    """Points of codimension two on one stretch of a curve."""

    def __init__(self, space: Followed, start: Point) -> None:
        super().__init__(space.equations, "real parts")
        self.space, self.tests = space, dict(_tests(space, start))

    def sample(self, point: Point) -> Sample:
        sample = super().sample(point)
        places = _critical(self.space, point, sample.values)
        h = CURVE_DIFFERENCE_STEP / max(1e-300, float(np.max(np.abs(point.tangent))))
        ahead = replace(point, z=point.z + h * point.tangent)
        values = [(test(point), test(ahead)) for test in self.tests.values()]
        return replace(less(sample, places), leading=tuple((here, (there - here) / h) for here, there in values))

    def found(self, stretch: Stretch, depth: int, last: bool) -> Sequence[Point] | None:
        ending = (
            TAKENS in self._changed(stretch) and depth >= NEAR_END
        )  # where the first Lyapunov coefficient has a pole
        if not (last or ending or np.all(stretch.settled)):
            return None
        ends, found = (stretch.first.point, stretch.last.point), list[tuple[float, Point]]()
        for kind, test in self._passed(stretch):
            located = self._double(*ends, kind, test) or _root(self.space, *ends, kind, test)
            if located is not None:
                found.append(located)
        return [point for _, point in sorted(found, key=lambda entry: entry[0])]

    def _double(self, before: Point, after: Point, kind: str, test: Test) -> tuple[float, Point] | None:
        """The branch point at which a second eigenvalue is zero with an eigenvector of its own; None where none is."""
        if self.space.kind != BRANCH_POINT or kind != TAKENS:
            return None

        def second(point: Point) -> float:
            matrix = jacobian_of(cast(ExtendedSystem, point.problem), point.z)  # in one scale: rows may vanish there
            return float(np.linalg.svd(matrix, compute_uv=False)[-2])

        return double_between(self.equations.point_solver, before, after, test, second)

    def _passed(self, stretch: Stretch) -> Iterator[tuple[str, Test]]:
        """Kinds of the points that are passed, each with a function that changes its sign there."""
        changed = self._changed(stretch)
        kinds = [TAKENS] if TAKENS in changed else changed
        yield from ((kind, self.tests[kind]) for kind in kinds)
        if TAKENS in kinds:
            return
        hopf, (reals, pairs) = self.space.kind == HOPF, crossings(stretch)
        for _ in reals:
            yield (ZERO_HOPF if hopf else TAKENS), _tracked(self.space, 0j)
        for place in pairs:
            at = 1j * height(stretch.first.values[place], stretch.last.values[stretch.order[place]])
            yield (HOPF_HOPF if hopf else ZERO_HOPF), _tracked(self.space, at)

    def _changed(self, stretch: Stretch) -> list[str]:
        """Kinds whose functions change their sign."""
        return [kind for kind, changed in zip(self.tests, stretch.changed, strict=False) if changed]

    def unresolved(self, stretch: Stretch) -> Iterator[Unresolved]:
        yield from ()


def _tests(space: Followed, start: Point) -> Iterator[tuple[str, Test]]:
    """Functions of a point that vanish at points of some kinds; others are found from eigenvalues."""
    if space.kind == FOLD:
        yield CUSP, _quadratic(space, start)
    if space.kind == BRANCH_POINT and space.equations.statics.exact:
        with suppress(RuntimeError):  # the model has no third derivatives
            yield _branching(space, start)
    if space.kind != HOPF:
        return
    yield TAKENS, _kappa
    if not space.equations.statics.exact:  # noise of differences has roots of its own
        return
    with suppress(RuntimeError):  # the model has no third derivatives
        size = float(np.sum(np.abs(_lyapunov(space, start)))) or 1.0

        def lyapunov(point: Point) -> float:
            l1 = np.inf
            with suppress(np.linalg.LinAlgError):  # at a pole, where another eigenvalue is zero to the last digit
                l1 = float(np.sum(_lyapunov(space, point))) if _kappa(point) > 0.0 else np.inf
            return float(np.tanh(l1 / size))

        yield BAUTIN, lyapunov


def _quadratic(space: Followed, reference: Point) -> Test:
    """The quadratic coefficient of a fold; its sign goes on from a reference by the normal of the curve of parameters.

    The left null vector itself may turn by more than a right angle within a step, in units in which its largest
    component passes through zero.
    """
    statics, sizes, n = space.equations.statics, space.equations.sizes, space.equations.statics.size
    system, names = cast(ExtendedSystem, reference.problem), list(statics.values)
    courses = [course for course in (*system.free, system.walking) if course is not None]
    ranges = np.array([course.to - course.start for course in courses])
    columns = [names.index(course.name) for course in courses]

    def left(point: Point) -> tuple[Array, Array]:
        psi, problem = _null_space(point).left[:, -1], cast(ExtendedSystem, point.problem)
        psi = psi / np.linalg.norm(psi)
        by_parameters = statics.by_parameters(problem.state(point.z), problem.parameters(point.z))[:, columns]
        return np.asarray(psi), np.asarray((psi / sizes) @ by_parameters * ranges)

    first = left(reference)[1]

    def test(point: Point) -> float:
        problem, (psi, normal), v = cast(ExtendedSystem, point.problem), left(point), sizes * point.z[n : 2 * n]
        curved = statics.second(problem.state(point.z), problem.parameters(point.z), v, v).real / sizes
        return float(np.copysign(1.0, normal @ first) * (psi @ curved))

    return test


def _branching(space: Followed, reference: Point) -> tuple[str, Test]:
    """The coefficient by which the branching equation degenerates, with its name: cubic where a symmetry is lost."""
    statics, sizes, n = space.equations.statics, space.equations.sizes, space.equations.statics.size

    def null_vector(point: Point) -> Array:
        v = _null_space(point).right[:, -1]
        return np.asarray(v / np.linalg.norm(v))

    first = null_vector(reference)

    def terms(point: Point) -> tuple[Array, Array]:
        problem, psi, v = cast(ExtendedSystem, point.problem), point.z[n : 2 * n], null_vector(point)
        v = v * np.sign(v @ first)
        A, (x, p) = jacobian_of(problem, point.z), (problem.state(point.z), problem.parameters(point.z))
        twice = statics.second(x, p, sizes * v, sizes * v).real / sizes
        closed = np.block([[A, psi[:, None]], [v[None, :], np.zeros((1, 1))]])
        bent = sizes * np.linalg.solve(closed, np.append(-twice, 0.0))[:-1]
        thrice = statics.third(x, p, sizes * v, sizes * v, sizes * v).real / sizes
        curved = statics.second(x, p, sizes * v, bent).real / sizes
        return 0.5 * psi * twice, np.concatenate([psi * thrice / 6.0, 0.5 * psi * curved])

    quadratic, cubic = terms(reference)
    scale = float(np.sum(np.abs(quadratic)) + np.sum(np.abs(cubic)))
    symmetric = bool(abs(np.sum(quadratic)) <= SYMMETRIC_TERM_RATIO * scale)
    kind = DEGENERATE_PITCHFORK if symmetric else DEGENERATE_TRANSCRITICAL
    return kind, lambda point: float(np.sum(terms(point)[int(symmetric)]))


def _null_space(point: Point) -> NullSpace:
    """Null vectors of dF/dy, in the sizes of the branch: tests along it have one scale."""
    problem = cast(ExtendedSystem, point.problem)
    return NullSpace.of_rates(jacobian_of(problem, point.z), np.ones(problem.statics.size))


def _kappa(point: Point) -> float:
    return cast(HopfSystem, point.problem).kappa(point.z)


def _critical(space: Followed, point: Point, values: ComplexArray) -> list[int]:
    """Places of the critical eigenvalues."""
    if space.kind != HOPF:
        return [int(np.argmin(np.abs(values)))]
    system = cast(HopfSystem, point.problem)
    omega = system.rate * np.sqrt(complex(system.kappa(point.z)))
    first = int(np.argmin(np.abs(values - 1j * omega)))
    rest = np.abs(values + 1j * omega)
    rest[first] = np.inf
    return [first, int(np.argmin(rest))]


def _tracked(space: Followed, at: complex) -> Test:
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


def _lyapunov(space: Followed, point: Point, statics: Statics | None = None) -> Array:
    """The terms of the first Lyapunov coefficient at a point of a curve of Hopf points."""
    statics = statics or space.equations.statics
    problem = cast(ExtendedSystem, point.problem)
    x, p = problem.state(point.z), problem.parameters(point.z)
    A = statics.jacobian(x, p)
    near = cast(HopfSystem, problem)
    omega, q, adjoint = critical_pair(A, near.rate * float(np.sqrt(max(near.kappa(point.z), 0.0))))
    return lyapunov_terms(statics, x, p, A, omega, q, adjoint)


def _root(space: Followed, before: Point, after: Point, kind: str, test: Test) -> tuple[float, Point] | None:
    """The point between two where a test vanishes, with its place; None where it has a pole, as l1 at zero-Hopf points.

    Raises NotLocatedError.
    """
    solver = space.equations.point_solver
    zero, beside, size = zero_between(solver, before, after, test, kind)
    if abs(zero.value) > VANISHING_TEST_RATIO * size:
        return None
    point, near = zero.point, abs(beside.fraction - zero.fraction) < 1e-6
    width = abs(float(beside.point.z[-1] - point.z[-1])) if near else TEST_ZERO_XTOL
    _, length = solver.curve(before, after)
    moved = min(width, 10.0 * TEST_ZERO_XTOL * length) + point.error.relative(1.0)
    error = replace(point.error, parameter=float(moved))
    return zero.fraction, replace(point, error=error, requested=False, walked=False, special=kind)
