"""Equations assembled by structure beside CasADi's own graph of them, and what is built once."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from kernels import needs_kernels, numpy_alone

from casadi_skin import BoundaryValueProblem
from casadi_skin.follow.find import space_of
from casadi_skin.follow.space import BoundaryError
from casadi_skin.model.ode import OdeModel
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.zero import butcher
from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.discretisation import improved, largest_terms, missed


def oscillator() -> BoundaryValueProblem:
    """A closed orbit of given mean x^2, with a period and a parameter free: every kind of equation and unknown."""
    x, y, mu, T = (ca.SX.sym(name) for name in ("x", "y", "mu", "T"))
    model = OdeModel("v", ca.vertcat(x, y), T * ca.vertcat(y, mu * (1 - x**2) * y - x), ca.vertcat(mu, T))
    conditions = [model.start(x) - model.end(x), model.start(y) - model.end(y), model.start(y)]
    return BoundaryValueProblem(
        model, conditions, integrals=[x**2 - 2.1], parameters={"mu": 1.0, "T": 6.6}, free=["mu", "T"]
    )


@pytest.mark.parametrize("options", [{}, {"transcription": "radau"}, {"degree": 1}, {"degree": 2}])
def test_the_assembled_equations_are_those_of_the_graph(options: dict[str, object]) -> None:
    problem = space_of(oscillator(), [1.0, 2.0], options).levels.problem(5)
    generator = np.random.default_rng(0)
    z, lengths = generator.normal(size=problem.size), generator.uniform(0.1, 1.0, 5)
    problem = problem.with_constants(lengths / lengths.sum())
    residual, nonzeros = problem.evaluate(z)
    expected, jacobian = problem.function(z, problem.constants)
    np.testing.assert_allclose(residual, expected.full()[:, 0], rtol=0, atol=1e-14)
    matrix = np.zeros(jacobian.shape)
    matrix[problem.pattern] = nonzeros
    np.testing.assert_allclose(matrix, jacobian.full(), rtol=0, atol=1e-14)
    assert np.array_equal(problem.pattern, jacobian.sparsity().get_triplet())


@needs_kernels
@pytest.mark.parametrize("options", [{}, {"transcription": "radau"}, {"degree": 1}, {"degree": 12}])
def test_defects_products_and_other_meshes_are_those_by_numpy(options: dict[str, object]) -> None:
    problem = space_of(oscillator(), [1.0, 2.0], options).levels.problem(8)
    generator = np.random.default_rng(0)
    z, steps = generator.normal(size=problem.size), generator.normal(size=(3, problem.size))
    lengths, others, inside = (generator.uniform(0.1, 1.0, count) for count in (8, 8, 50))
    problem, other = (problem.with_constants(one / one.sum()) for one in (lengths, others))

    def found() -> list[np.ndarray]:
        problem.discretisation._at = b""  # nothing is kept
        parts = *problem.evaluate(z), *missed(problem.discretisation, z, problem.numbers)
        places = np.concatenate([problem._fractions(), inside])
        meshes = (
            problem.all_prolonged(steps, other),
            problem.sample(z, places),
            problem._wanted(z),
            problem._wanted(0 * z),
        )
        changes = [problem.profile_change(z, steps[0]), problem.profile_change(z, steps[0], parts[-1])]
        solve = BorderedSolver(problem).factor(z, problem.evaluate(z)[1], problem.parameter_row())
        better = improved(problem.discretisation, z * (1.0 + 1e-6), problem.numbers, solve, np.ones(2))
        along = problem.null_vector(z, solve, np.ones(z.size))[0]
        return [*parts, problem.rounding(z), along, *meshes, np.array(changes), *better]

    compiled = found()
    with numpy_alone():
        for one, plain in zip(compiled, found(), strict=True):
            assert one.shape == plain.shape
            np.testing.assert_allclose(one, plain, rtol=0, atol=1e-11 * np.max(np.abs(plain), initial=0.0))


@needs_kernels
def test_a_term_that_is_no_number_is_the_largest() -> None:
    rows, columns = np.array([0, 0, 0, 1, 1]), np.array([0, 1, 2, 0, 1])
    nonzeros, z = np.array([1.0, np.inf, 2.0, -3.0, 1.0]), np.array([1.0, 0.0, 1.0])
    with np.errstate(invalid="ignore"):
        np.testing.assert_array_equal(largest_terms(nonzeros, rows, columns, z, 2), [np.nan, 3.0])


def test_other_values_of_parameters_build_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also on a branch, and for problems made of one another; and give what a problem stated anew gives."""
    u, v, a, b = (ca.SX.sym(name) for name in ("u", "v", "a", "b"))
    model = OdeModel("m", ca.vertcat(u, v), ca.vertcat(v, -a * ca.exp(b * u)), ca.vertcat(a, b))

    def stated(*values: float) -> BoundaryValueProblem:
        parameters = dict(zip(("a", "b"), values, strict=True))
        return BoundaryValueProblem(model, [model.start(u), model.end(u) - b], parameters=parameters)

    first = stated(0.0, 1.0)
    first.solve([0.0, 0.0]).follow("b", 1.2)
    expected = [stated(a, b).solve([0.0, 0.0]) for a, b in ((1.0, 0.9), (-1.0, 0.5))]
    branch = stated(1.0, 0.9).solve([0.0, 0.0]).follow("b", 0.5)

    def build(*_: object, **__: object) -> None:
        raise AssertionError("built again")

    monkeypatch.setattr(ca.Function, "map", build)
    monkeypatch.setattr(ca, "jacobian", build)
    second = first.with_parameters(a=1.0, b=0.9)
    third = second.with_parameters(a=-1.0, b=0.5)
    for problem, other in zip((second, third), expected, strict=True):
        found = problem.solve([0.0, 0.0])
        assert found.parameters == other.parameters == dict(problem.values)
        np.testing.assert_allclose(found.states, other.states, rtol=0, atol=1e-13)
    again = second.solve([0.0, 0.0]).follow("b", 0.5)
    np.testing.assert_allclose(again.solutions[-1].states, branch.solutions[-1].states, rtol=0, atol=1e-13)
    with pytest.raises(ValueError, match="parameters: given 'c'"):
        first.with_parameters(c=1.0)


def test_a_solve_tells_how_far_it_is_and_ends_in_time() -> None:
    told: list[str] = []
    problem, guess = oscillator(), lambda t: [2 * np.cos(2 * np.pi * t), -2 * np.sin(2 * np.pi * t)]
    problem.solve(guess, progress=told.append)
    assert "step 1 of Newton's method" in told[0]
    with pytest.raises(BoundaryError, match=r"the time allowed, 1e-06 s, is over, at step 1 of Newton's method"):
        problem.solve(guess, time_limit=1e-6)
    with pytest.raises(ValueError, match="time_limit: given -1; accepted: a number of seconds > 0"):
        problem.solve(guess, time_limit=-1)


def test_a_second_method_of_as_many_stages_has_equations_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """u'' = u by Gauss's method, then by one with Chebyshev's nodes in its place: each has its values at its times."""
    u, v = ca.SX.sym("u"), ca.SX.sym("v")
    model = OdeModel("line", ca.vertcat(u, v), ca.vertcat(v, u))
    problem = BoundaryValueProblem(model, [model.start(u), model.end(u) - 1.0])

    def chebyshev(degree: int) -> CollocationTable:
        powers = np.arange(1, degree + 1)
        nodes = 0.5 - 0.5 * np.cos((powers - 0.5) * np.pi / degree)
        slopes = np.linalg.inv(powers * nodes[:, None] ** (powers - 1))  # of polynomials without a constant
        ends = np.append(nodes, 1.0)
        return CollocationTable(nodes, ends, ends[:, None] ** powers @ slopes, degree)

    by_gauss = problem.solve([0.0, 0.0], degree=3, intervals=8, tolerance=1e-8)
    monkeypatch.setitem(butcher.TABLES, "gauss", chebyshev)
    by_another = problem.solve([0.0, 0.0], degree=3, intervals=8, tolerance=1e-8)
    assert by_gauss.t[1] != by_another.t[1]
    for solution in (by_gauss, by_another):
        np.testing.assert_allclose(solution.states[:, 0], np.sinh(solution.t) / np.sinh(1.0), atol=1e-7)
