"""The Taylor series of a branch and the walk on it, against exact series, the equations, and the arclength walk."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest
from orbit_problems import linear_mode

from casadi_skin import Branch, Chain, OdeModel, follow_family
from casadi_skin.follow.family import Family
from casadi_skin.follow.point import LocalCurve, PointSolver
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.zero.cosines import PolynomialForm, TaylorRecursion, TrigonometricProblem
from casadi_skin.zero.family import family_request
from casadi_skin.zero.problem import SingularError
from casadi_skin.zero.settings import End, Point

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


def series_at(problem: TrigonometricProblem, z: np.ndarray, orders: int) -> np.ndarray:
    """Coefficients of a family at its linear mode z, in the parameter itself."""
    solve = BorderedSolver(problem).factor(z, problem.evaluate(z)[1], problem.parameter_row())
    unit = np.eye(problem.size)[-1]
    return TaylorRecursion(problem, PolynomialForm.of(problem.model), orders).series(z, solve(unit), solve)


def test_one_site_has_the_series_of_the_exact_frequency(way: None) -> None:
    """Of Omega = pi sqrt(w2 + k)/(2 K(m)), m = k/(2 (w2 + k)), computed with 60 digits."""
    problem = TrigonometricProblem(Chain(1, 1.0, 0.0, 1.0).gauge_model(), 24)
    coefficients = series_at(problem, problem.pack(np.ones(1), np.sqrt(3.0), 0.0), 12)
    with mpmath.workdps(60):
        exact = mpmath.taylor(lambda k: mpmath.pi * mpmath.sqrt(3 + k) / (2 * mpmath.ellipk(k / (2 * (3 + k)))), 0, 12)
    assert coefficients[:, -2] == pytest.approx([float(c) for c in exact], rel=1e-11)


def web() -> OdeModel:
    """Couplings between sites that are not neighbours, in no order, and powers of the parameter."""
    q, v, p = ca.SX.sym("q", 4), ca.SX.sym("v", 4), ca.SX.sym("p")
    cubic = ca.vertcat(q[3] ** 2 * q[0], q[0] ** 3, q[0] ** 2 * q[1], q[2] * q[1] * q[0])
    signs: dict[str, Any] = {"reversal": (1,) * 4 + (-1,) * 4, "half_period": (-1,) * 8}
    rhs = -ca.DM([1.0, 1.7, 2.9, 4.1]) * q - p * cubic - 0.3 * p**2 * q**3
    return OdeModel("web", q, rhs, p, 2, v, normalisation=ca.dot(q, q) - 1, **signs)


def starts() -> list[tuple[OdeModel, np.ndarray, float]]:
    """Models with a linear mode and its frequency."""
    chains = ((Chain(5, 1.0, 0.3, 1.0), 2), (Chain(6, 0.5, -0.6, -1.0), 1))
    found = [(chain.gauge_model(), linear_mode(chain, mode), chain.linear_frequency(mode)) for chain, mode in chains]
    return [*found, (web(), np.eye(4)[0], 1.0)]


@pytest.mark.parametrize(("model", "mode", "Omega"), starts())
def test_the_equations_hold_to_the_order_of_the_series(
    way: None, model: OdeModel, mode: np.ndarray, Omega: float
) -> None:
    """The residual at tau falls with tau^(orders + 1): a wrong coefficient of any order would show."""
    problem = TrigonometricProblem(model, 8)
    coefficients = series_at(problem, problem.pack(mode, Omega, 0.0), 7)
    residuals = [np.abs(problem.evaluate(LocalCurve(coefficients, 1.0).at(tau))[0]).max() for tau in (0.8, 0.4, 0.2)]
    orders = np.log2(np.array(residuals[:-1]) / residuals[1:])
    assert residuals[-1] > 1e-13
    assert orders[-1] == pytest.approx(8.0, abs=0.5 if model.name == "web" else 0.25)


# The walk -----------------------------------------------------------------------------------------------------------


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


def test_few_stretches_cover_the_family_and_leave_the_corrector_nothing_to_do() -> None:
    """Points are where they would be drawn; Ipopt accepts what the series predicts but next to a change of level."""
    branch = follow_family(Chain(24, 1.0, 0.25, -1.0), 1, 3.0, tolerance=1e-9, walker="series")
    assert sum(o.point.walked for o in branch.orbits) <= 16
    assert sum(o.point.iterations > 0 for o in branch.orbits) <= 8
    assert np.max(np.diff(branch.S)) <= 3.0 / 30.0 * 1.01
    assert branch.S[-1] == 3.0
    assert 35 < len(branch) < 80
