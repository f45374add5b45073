"""What the search for changes of stability does for many at once is what it does for one."""

from __future__ import annotations

import numpy as np
import pytest

from casadi_skin import Chain, follow_family
from casadi_skin.follow.family import Family
from casadi_skin.follow.family_changes import orbit_near, orbits_near
from casadi_skin.follow.point import PointSolver
from casadi_skin.stability.flows import OrbitState
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.blocks import SERIES_DEGREE
from casadi_skin.stability.tongues.chebyshev import Function, find_zeros


@pytest.fixture(scope="module")
def family() -> tuple[Family, list[OrbitState]]:
    """The first softening family of twelve sites, with orbits that need different numbers of steps."""
    branch = follow_family(Chain(12, 1.0, 0.25, -1.0), 1, 3.0, stability=False)
    return branch.space, [OrbitState(orbit.point.problem, orbit.point.z) for orbit in branch.orbits]


def test_transition_matrices_alike_are_in_one_number_of_steps(family: tuple[Family, list[OrbitState]]) -> None:
    space, orbits = family
    flow = space.flow
    free = flow.transitions(orbits, 1e-9)
    assert len({found.steps for found in free}) > 1
    alike = flow.transitions(orbits, 1e-9, alike=True)
    assert len({found.steps for found in alike}) == 1
    for one, other in zip(free, alike, strict=True):
        assert np.linalg.norm(one.matrix - other.matrix) <= one.error + other.error
        assert np.linalg.norm(other.truncation) <= 1e-9


def test_orbits_found_together_are_those_found_one_by_one(family: tuple[Family, list[OrbitState]]) -> None:
    space, orbits = family
    solver: PointSolver = space.point_solver
    problem = max((orbit.problem for orbit in orbits), key=lambda problem: problem.resolution)
    z = np.array([orbit.problem.prolong(orbit.z, problem) for orbit in orbits[4:12]])
    row = solver.metric(problem, z[3]) * (z[-1] - z[0])
    guesses = z * (1.0 + 1e-4 * np.cos(np.arange(z.shape[1])))
    together = orbits_near(solver, problem, guesses, row)
    for guess, orbit in zip(guesses, together, strict=True):
        alone = orbit_near(solver, problem, guess, row)
        assert orbit.z == pytest.approx(alone.z, abs=1e-12)
        assert np.max(np.abs(problem.evaluate(orbit.z)[0])) < 1e-12
        assert row @ orbit.z == pytest.approx(float(row @ guess), abs=1e-12)
        for name in ("along", "response"):
            mine, other = getattr(orbit, name), getattr(alone, name)
            assert np.max(np.abs(mine - other)) <= 1e-6 * np.max(np.abs(other))
    assert orbits_near(solver, problem, guesses, row, 0.0) == [None] * len(z)


def test_zeros_found_together_are_those_of_the_polynomials() -> None:
    """Products of factors with zeros that are known: none, one at an end, three, and two that only come near zero."""
    x, zeros = chebyshev.nodes(SERIES_DEGREE), [[], [1.0], [-0.71, 0.2, 0.2004], [0.3]]
    values = np.array([np.prod([x - zero for zero in each], axis=0) * (2.0 + x) for each in zeros])
    values[3] = (x - 0.3) ** 2 + 1e-12
    errors = np.full((4, SERIES_DEGREE + 1), 1e-11)
    functions = Function.several(chebyshev.transform(SERIES_DEGREE) @ values.T, errors)
    assert [function.excludes_zero for function in functions] == [True, False, False, False]
    find_zeros(functions)
    for function, expected in zip(functions, zeros, strict=True):
        places = [place for place, _, _ in function.zeros]
        assert places == pytest.approx(expected, abs=1e-9)
        for place, width, crosses in function.zeros:
            assert width == pytest.approx(function.near_zero(place, 2.0), rel=1e-9)
            assert crosses == (expected != [0.3])
    (_, width, _), *_ = functions[2].zeros or ()
    slope = (2.0 - 0.71) * (-0.71 - 0.2) * (-0.71 - 0.2004)
    assert width == pytest.approx(1e-11 / abs(slope), rel=1e-3)
    (_, width, _), *_ = functions[3].zeros or ()
    assert width == pytest.approx(np.sqrt(2.0 * 1e-11 / 2.0), rel=1e-3)
