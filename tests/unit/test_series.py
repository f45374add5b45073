"""The Taylor series of a branch and the walk on it, against exact series, the equations, and the arclength walk."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from casadi_skin import Branch, Chain, Orbit, follow_family
from casadi_skin.follow.branch_run import Following
from casadi_skin.follow.family import Family
from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.polynomials import Stretch
from casadi_skin.follow.series import SeriesContinuation
from casadi_skin.lattice.closed_forms import duffing_frequency
from casadi_skin.zero.cosines import TrigonometricProblem
from casadi_skin.zero.problem import SingularError
from casadi_skin.zero.recursion import PolynomialForm, TaylorRecursion
from casadi_skin.zero.request import family_request
from casadi_skin.zero.settings import End, Point

SOFTENING_END = {0.2: 1.036393147166972, 1.0: 1.018532435491958, 3.0: 0.765958900020734}  # N = 24, j = 1, g = -1

# Families that fold in S and come back, found by search: chain, mode, S beyond the fold.
FOLDED = [
    (Chain(6, 2.342, 0.33, 1.0), 3, 10.0),
    pytest.param(Chain(4, 1.219, 0.57, 1.0), 3, 10.0, marks=pytest.mark.slow),
    pytest.param(Chain(2, 1.224, 0.86, -1.0), 1, 3.2, marks=pytest.mark.slow),
]


def tools_of(chain: Chain, mode: int, amplitude_max: float, tolerance: float = 1e-9, **more: object) -> Family:
    settings = {"corrector": "newton", "walker": "series"} | more
    return Family(family_request(chain, mode, amplitude_max, tolerance=tolerance, **settings))  # type: ignore[arg-type]


@cache
def followed(chain: Chain, mode: int, amplitude_max: float, tolerance: float, at: tuple[float, ...] = ()) -> Branch:
    return follow_family(chain, mode, amplitude_max, at=at, tolerance=tolerance, corrector="newton", walker="series")


# The series ---------------------------------------------------------------------------------------------------------


def series_at_start(chain: Chain, mode: int, harmonics: int, orders: int) -> tuple[Family, np.ndarray]:
    """Coefficients of a family at its linear mode, in kappa = g S itself."""
    tools = tools_of(chain, mode, 3.0)
    problem = TrigonometricProblem(tools.coordinates.scaled, harmonics)
    z = problem.pack(tools.coordinates.mode, chain.linear_frequency(mode), 0.0)
    solve = tools.levels.solver(problem).factor(z, problem.evaluate(z)[1], problem.parameter_row())
    unit = np.zeros(problem.size)
    unit[-1] = 1.0
    return tools, TaylorRecursion(problem, PolynomialForm.of(tools.coordinates.scaled), orders).series(
        z, solve(unit), solve
    )


def test_one_site_has_the_series_of_the_exact_frequency(way: None) -> None:
    """Of Omega = pi sqrt(w2 + k)/(2 K(m)), m = k/(2 (w2 + k)), computed with 60 digits."""
    import mpmath

    _, coefficients = series_at_start(Chain(1, 1.0, 0.0, 1.0), 1, 24, 12)
    with mpmath.workdps(60):
        exact = mpmath.taylor(lambda k: mpmath.pi * mpmath.sqrt(3 + k) / (2 * mpmath.ellipk(k / (2 * (3 + k)))), 0, 12)
    assert coefficients[:, -2] == pytest.approx([float(c) for c in exact], rel=1e-11)


@pytest.mark.parametrize(("chain", "mode"), [(Chain(5, 1.0, 0.3, 1.0), 2), (Chain(6, 0.5, -0.6, -1.0), 1)])
def test_the_equations_hold_to_the_order_of_the_series(way: None, chain: Chain, mode: int) -> None:
    """The residual at tau falls with tau^(orders + 1): a wrong coefficient of any order would show."""
    tools, coefficients = series_at_start(chain, mode, 8, 7)
    problem = TrigonometricProblem(tools.coordinates.scaled, 8)
    residuals = [np.abs(problem.evaluate(Stretch(coefficients, 1.0).at(tau))[0]).max() for tau in (0.8, 0.4, 0.2)]
    orders = np.log2(np.array(residuals[:-1]) / residuals[1:])
    assert orders == pytest.approx([8.0, 8.0], abs=0.25)


def test_terms_in_no_order_are_gathered(way: None) -> None:
    """Couplings between sites that are not neighbours, and powers of the parameter, take the general way."""
    import casadi as ca

    from casadi_skin.model.ode import OdeModel

    q, v, p = ca.SX.sym("q", 4), ca.SX.sym("v", 4), ca.SX.sym("p")
    stiff = ca.DM([1.0, 1.7, 2.9, 4.1])
    cubic = ca.vertcat(q[3] ** 2 * q[0], q[0] ** 3, q[0] ** 2 * q[1], q[2] * q[1] * q[0])
    signs = {"reversal": (1,) * 4 + (-1,) * 4, "half_period": (-1,) * 8}
    model = OdeModel(
        "web", q, -stiff * q - p * cubic - 0.3 * p**2 * q**3, p, 2, v, normalisation=ca.dot(q, q) - 1, **signs
    )
    problem = TrigonometricProblem(model, 6)
    z = problem.pack(np.array([1.0, 0.0, 0.0, 0.0]), 1.0, 0.0)
    solver = tools_of(Chain(2, 1.0, 0.0, 1.0), 1, 1.0).levels
    solve = type(solver.solver(problem))(problem).factor(z, problem.evaluate(z)[1], problem.parameter_row())
    unit = np.zeros(problem.size)
    unit[-1] = 1.0
    coefficients = TaylorRecursion(problem, PolynomialForm.of(model), 6).series(z, solve(unit), solve)
    residuals = [np.abs(problem.evaluate(Stretch(coefficients, 1.0).at(tau))[0]).max() for tau in (0.8, 0.4, 0.2)]
    assert residuals[2] > 1e-13
    assert np.log2(residuals[1] / residuals[2]) == pytest.approx(7.0, abs=0.5)


def test_crossings_of_a_polynomial_that_turns() -> None:
    """(tau - 0.1)(tau - 0.104)(tau - 0.9): two crossings closer than the samples."""
    gap = np.polynomial.polynomial.polyfromroots([0.1, 0.104, 0.9])
    stretch = Stretch(gap[:, None], 1.0)
    assert [tau for tau, _ in stretch.crossings(0, [0.0])] == pytest.approx([0.1, 0.104, 0.9], abs=1e-12)
    assert [tau for tau, _ in Stretch(gap[:, None], 0.5).crossings(0, [0.0])] == pytest.approx([0.1, 0.104], abs=1e-12)
    assert stretch.crossings(0, [5.0]) == []
    values = [value for _, value in stretch.crossings(0, [-1e-3, 0.0, 1e-3])]
    assert values.count(0.0) == 3
    assert (values.count(-1e-3), values.count(1e-3)) == (3, 1)


# The walk -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("corrector", [pytest.param("ipopt", marks=pytest.mark.slow), "newton"])
def test_the_softening_end_breather_has_the_reference_frequencies(corrector: str) -> None:
    chain, at = Chain(24, 1.0, 0.25, -1.0), tuple(SOFTENING_END)
    branch = follow_family(chain, 1, 3.0, at=at, tolerance=1e-11, corrector=corrector, walker="series")
    assert branch.complete
    for S, Omega in SOFTENING_END.items():
        orbit = next(o for o in branch.orbits if S == o.S)
        assert orbit.point.requested
        assert abs(orbit.Omega - Omega) <= min(orbit.Omega_error + 5e-15, 1e-11)


@pytest.mark.parametrize(("g", "amplitude_max"), [pytest.param(1.0, 1e4, marks=pytest.mark.slow), (-1.0, 2.9)])
def test_one_site_is_exact_along_the_whole_family(g: float, amplitude_max: float) -> None:
    branch = followed(Chain(1, 1.0, 0.0, g), 1, amplitude_max, 1e-9)
    exact = np.array([duffing_frequency(3.0, g, np.sqrt(S)) for S in branch.S])
    assert branch.complete
    assert np.all(np.diff(branch.S) > 0)
    assert np.abs(branch.Omega / exact - 1.0).max() <= 1e-9
    errors = np.array([o.Omega_error for o in branch.orbits])
    assert np.all(np.abs(branch.Omega - exact) <= errors + 5e-15 * exact)


@pytest.mark.parametrize(("chain", "mode", "amplitude_max"), FOLDED)
def test_folds_are_passed_as_the_arclength_walk_passes_them(chain: Chain, mode: int, amplitude_max: float) -> None:
    branch = followed(chain, mode, amplitude_max, 1e-9)
    other = follow_family(chain, mode, amplitude_max, tolerance=1e-9, corrector="newton")
    assert branch.complete
    assert np.any(np.diff(branch.S) < 0)
    assert branch.Omega[-1] == pytest.approx(other.Omega[-1], rel=1e-9)
    middle = 0.5 * (branch.S.max() + amplitude_max)
    assert branch.S.max() == pytest.approx(other.S.max(), rel=1e-2)
    assert branch.at(0.5 * middle).Omega == pytest.approx(other.at(0.5 * middle).Omega, rel=1e-9)


def test_a_requested_S_is_met_at_every_passage_of_a_fold() -> None:
    """The family passes S three times between its two folds."""
    chain, mode, amplitude_max = FOLDED[0]
    plain = followed(chain, mode, amplitude_max, 1e-9)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(plain.S))))
    inside = float(0.5 * (plain.S[turns[0] + 1] + plain.S[turns[1] + 1]))
    branch = followed(chain, mode, amplitude_max, 1e-9, (inside,))
    found = [o.Omega for o in branch.orbits if inside == o.S]
    assert len(found) == 3
    assert found == pytest.approx([plain.at(inside, which=k).Omega for k in range(3)], rel=1e-9)


def test_points_are_where_they_would_be_drawn() -> None:
    branch = followed(Chain(24, 1.0, 0.25, -1.0), 1, 3.0, 1e-9)
    assert np.max(np.diff(branch.S)) <= 3.0 / 30.0 * 1.01
    assert branch.S[-1] == 3.0
    assert 35 < len(branch) < 80


def test_the_corrector_has_nothing_to_do() -> None:
    """Ipopt accepts what the series predicts; points on a finer level than their stretch are corrected."""
    branch = follow_family(Chain(24, 1.0, 0.25, -1.0), 1, 3.0, tolerance=1e-9, walker="series")
    iterations = [o.point.iterations for o in branch.orbits]
    assert sum(i > 0 for i in iterations) <= 8


def test_few_stretches_cover_the_family() -> None:
    branch = followed(Chain(24, 1.0, 0.25, -1.0), 1, 3.0, 1e-9)
    assert sum(o.point.walked for o in branch.orbits) <= 16


def test_a_walk_broken_off_goes_on_as_if_it_had_not_been() -> None:
    tools = tools_of(Chain(8, 1.0, 0.3, -1.0), 1, 2.5)
    whole = [o for o in Following(tools) if isinstance(o, Orbit)]
    walked = [i for i, o in enumerate(whole) if o.point.walked]
    assert len(walked) >= 3
    for cut in walked[:3]:
        again = Following(Family(tools.request), solutions=whole[: cut + 1])
        rest = [o for o in again if isinstance(o, Orbit)]
        assert [o.S for o in rest] == [o.S for o in whole[cut + 1 :]]
        assert [o.Omega for o in rest] == [o.Omega for o in whole[cut + 1 :]]


def test_a_point_that_the_corrector_moves_is_where_the_walk_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """The points of a batch are computed ahead: those after a base that is another now are computed again."""
    tools = tools_of(Chain(8, 1.0, 0.3, -1.0), 1, 2.5, corrector="ipopt")
    whole = list(tools.continuation((tools.start,)))
    last_word, bases = PointSolver._last_word, set[int]()

    def moving(solver: PointSolver, point: Point, *more: Any) -> Any:
        word = last_word(solver, point, *more)
        if not point.walked or round(point.parameter, 9) in bases:
            return word
        bases.add(round(point.parameter, 9))
        assert isinstance(word, Point)
        return replace(word, z=word.z * (1.0 + 1e-12))

    monkeypatch.setattr(PointSolver, "_last_word", moving)
    moved = list(tools.continuation((tools.start,)))
    assert len(bases) == sum(point.walked for point in whole) > 3
    assert len(moved) == len(whole)
    np.testing.assert_allclose([p.parameter for p in moved], [p.parameter for p in whole], rtol=1e-8)
    between = [k for k, point in enumerate(whole) if not point.walked]
    assert any(moved[k].parameter != whole[k].parameter for k in between)
    assert [p.walked for p in moved] == [p.walked for p in whole]


def test_a_point_that_the_corrector_refuses_ends_the_walk_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    tools = tools_of(Chain(8, 1.0, 0.3, -1.0), 1, 2.5, corrector="ipopt")
    whole = list(tools.continuation((tools.start,)))
    last_word, refused = PointSolver._last_word, whole[13]

    def refusing(solver: PointSolver, point: Point, *more: Any) -> Any:
        return SingularError("refused") if point.parameter == refused.parameter else last_word(solver, point, *more)

    monkeypatch.setattr(PointSolver, "_last_word", refusing)
    walk = tools.continuation((tools.start,))
    assert [p.parameter for p in walk] == [p.parameter for p in whole[:13]]
    assert walk.end is End.NO_STEP
    assert "refused" in walk.detail


def test_a_resolution_that_does_not_suffice_ends_the_walk_by_name() -> None:
    tools = tools_of(Chain(1, 1.0, 0.0, 1.0), 1, 50.0, tolerance=1e-10)
    tools.levels.resolutions = (4, 6)
    walk = tools.continuation((tools.start,))
    points = list(walk)
    assert walk.end is End.RESOLUTION
    assert 0 < len(points) < 60


def test_the_limit_on_points_ends_the_walk_by_name() -> None:
    tools = tools_of(Chain(3, 1.0, 0.3, 1.0), 1, 3.0)
    point_solver = type(tools.point_solver)(tools.levels, replace(tools.request.continuation_settings(), max_points=5))
    walk = SeriesContinuation(point_solver, (tools.start,), tools._recursion, lambda problem: 1e-12)
    assert len(list(walk)) >= 5
    assert walk.end is End.POINTS


def test_other_transcriptions_have_no_series() -> None:
    with pytest.raises(ValueError, match=r'walker: given "series"; accepted with gauss: arclength'):
        tools_of(Chain(3, 1.0, 0.3, 1.0), 1, 3.0, transcription="gauss")
