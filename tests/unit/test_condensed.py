"""Condensed collocation equations, compiled, beside SuperLU and dense elimination."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from critical_models import cycles_with_fold
from cycles_in_closed_form import Block, Truth
from kernels import needs_kernels, numpy_alone

from casadi_skin import OdeModel, find_equilibrium, find_orbit
from casadi_skin.solve.bordered import BorderedSolver, CompiledFactors, SparseFactors
from casadi_skin.zero.augmented import BothWays, SingularProblem, Triplets, _sparse
from casadi_skin.zero.butcher import CollocationTable, gauss_table, radau_table
from casadi_skin.zero.collocation import CollocationEquations
from casadi_skin.zero.discretisation import Formulation
from casadi_skin.zero.problem import Array, SingularError

NODES = np.array([0.0, 0.5 - 0.05**0.5, 0.5 + 0.05**0.5, 1.0])
LOBATTO = CollocationTable(NODES, NODES[1:], np.ones((3, 4)), 6)  # of the places alone
TABLES = {"gauss": gauss_table(6), "midpoint": gauss_table(1), "radau": radau_table(3), "euler": radau_table(1)}
TABLES["lobatto"] = LOBATTO


class Equations(CollocationEquations):
    """Those of a formulation, without any meaning; unknowns and residuals are measured in units of the components."""

    def __init__(self, formulation: Formulation, intervals: int, table: CollocationTable, units: Array) -> None:
        self._discretise(formulation, intervals, table)
        self.units = np.concatenate([np.tile(units, self.columns), np.ones(self.size - self.states)])

    def sizes_at(self, z: Array) -> tuple[Array, float]:
        return self.units, 0.0

    def units_at(self, z: Array, nonzeros: Array) -> tuple[Array, Array]:
        largest = np.zeros(self.size - 1)
        np.maximum.at(largest, self.pattern[0], np.abs(nonzeros) * self.units[self.pattern[1]])
        return self.units, largest

    def frequency(self, z: Array) -> float:
        return 1.0

    def frequency_step(self, z: Array, step: Array) -> float:
        return 0.0


def equations(
    n: int, K: int, table: str, scalars: int = 2, integrals: int = 0, periodic: bool = True, spread: float = 0.0
) -> Equations:
    """Of n states with a full Jacobian, whose units spread over so many powers of ten."""
    x, end, sigma = ca.SX.sym("x", n), ca.SX.sym("end", n), ca.SX.sym("sigma", scalars)
    ends = end - x if periodic else ca.vertcat(x[: n // 2], end[n // 2 :])
    more = [ca.sin(ca.sum1(x) * ca.sum1(end) * ca.sum1(sigma) + i) for i in range(scalars - 1 - integrals)]
    integrands = ca.vertcat(*(ca.cos(ca.sum1(x) * ca.sum1(sigma) + i) for i in range(integrals)))
    formulation = Formulation(
        ca.SX.sym("s"), x, (x, end), sigma, ca.sin(ca.sum1(x)) * ca.DM.ones(n) * ca.sum1(sigma) ** 2,
        ca.vertcat(ends, *more), integrands if integrals else ca.SX(0, 1), ca.SX.sym("constants", 0),
    )  # fmt: skip
    units = 10.0 ** np.random.default_rng(n).permutation(np.linspace(-spread, spread, n))
    return Equations(formulation, K, TABLES[table], units)


def random_matrix(problem: Equations, seed: int, stiffness: float = 1.0) -> tuple[Array, Array]:
    """Non-zeros of a matrix with these units, derivatives within intervals up to the stiffness, and a closing row."""
    random, (rows, columns) = np.random.default_rng(seed), problem.pattern
    structure, bottom, n = problem.discretisation.structure, problem.states - problem.formulation.states, rows.size
    size = 10.0 ** random.uniform(-1.0, np.log10(stiffness), size=problem.resolution)
    interval = np.minimum(rows // (bottom // problem.resolution), problem.resolution - 1)
    values = structure.differences + random.normal(size=n) * np.where(rows < bottom, size[interval], 1.0)
    units = problem.units
    in_units = np.concatenate([units[problem.formulation.states : problem.states], np.ones(problem.size)])
    return values * in_units[rows] / units[columns], random.normal(size=problem.size) / units


def balanced(problem: Equations, nonzeros: Array, row: Array) -> tuple[Array, Array]:
    """The matrix in units of the unknowns, rows divided by their largest entries, and these."""
    matrix = np.zeros((problem.size, problem.size))
    matrix[problem.pattern], matrix[-1] = nonzeros, row
    matrix *= problem.units
    largest = np.max(np.abs(matrix), axis=1)
    return matrix / largest[:, None], largest


CASES = [
    *((n, K, table, 2, 0, True) for n in (1, 2, 3, 5) for K in (1, 2, 7) for table in TABLES),
    (2, 5, "gauss", 4, 2, False), (3, 4, "radau", 5, 3, True), (3, 4, "lobatto", 3, 1, False),
    (4, 6, "gauss", 1, 0, False), (11, 3, "gauss", 3, 1, True), (17, 3, "radau", 2, 1, False),
    (2, 40, "gauss", 2, 1, True), (30, 2, "euler", 2, 0, True),
]  # fmt: skip


@needs_kernels
@pytest.mark.parametrize(("n", "K", "table", "scalars", "integrals", "periodic"), CASES)
@pytest.mark.parametrize(("spread", "stiffness"), [(0.0, 1.0), (8.0, 1.0), (4.0, 1e5)])
def test_solutions_are_those_of_dense_elimination(
    n: int, K: int, table: str, scalars: int, integrals: int, periodic: bool, spread: float, stiffness: float
) -> None:
    """To rounding, in any units; the sign of the determinant is that of SuperLU too."""
    problem = equations(n, K, table, scalars, integrals, periodic, spread)
    solver, solved = BorderedSolver(problem), 0
    for seed in range(4):
        nonzeros, row = random_matrix(problem, seed, stiffness)
        matrix, largest = balanced(problem, nonzeros, row)
        b = np.random.default_rng(1).normal(size=(problem.size, 5)) * largest[:, None]
        try:
            solve = solver.factor(problem.units, nonzeros, row)
        except SingularError:
            assert np.linalg.cond(matrix) > 1e10
            continue
        assert isinstance(solve, CompiledFactors)
        x = solve(b)
        in_units = x / problem.units[:, None]
        left = np.abs(matrix @ in_units - b / largest[:, None])
        backward = np.max(left / np.max(np.abs(in_units), axis=0), axis=1)
        assert np.max(backward[: problem.size - 1 - integrals]) <= 5e-14
        assert np.max(backward) <= 2e-12  # of rows that are no pivots of intervals
        np.testing.assert_allclose(solve(b[:, 1]), x[:, 1], rtol=0, atol=1e-14 * np.max(np.abs(x[:, 1])))
        other = np.ascontiguousarray(b.T / largest)  # of the transposed matrix in these units, from b / largest
        solve.kernel.solve(solve.memory, turned := np.array(other / problem.units, order="C"), True)
        turned *= largest
        left = np.abs(turned @ matrix - other)
        assert np.max(left) <= 1e-12 * np.max(np.abs(turned))
        assert solve.orientation == np.linalg.slogdet(matrix)[0]
        assert solver.orientation(nonzeros, row) == solver.unchecked(nonzeros, row).orientation
        assert solver.factor(problem.units, nonzeros, -row).orientation == -solve.orientation
        solved += 1
    assert solved >= 2


@needs_kernels
@pytest.mark.parametrize("fault", ["a repeated row", "an empty row", "no derivative", "not a number", "nearly"])
def test_singular_matrices_are_refused(fault: str) -> None:
    problem = equations(3, 4, "gauss")
    (rows, columns), n = problem.pattern, problem.size
    nonzeros, row = random_matrix(problem, 1)
    matrix = np.zeros((n - 1, n))
    matrix[rows, columns] = nonzeros
    if fault == "a repeated row":
        row = matrix[-2]
    elif fault == "an empty row":
        row = np.zeros(n)
    elif fault == "no derivative":
        nonzeros[columns == 20] = row[20] = 0.0
    elif fault == "not a number":
        nonzeros[100] = np.nan
    else:
        row = matrix[-2] + 1e-14 * row
    assert BorderedSolver(problem)._condensed(nonzeros, row, problem.units) is None
    with pytest.raises(SingularError, match=r"singular|factorised"):
        BorderedSolver(problem).factor(problem.units, nonzeros, row)


def test_superlu_takes_what_the_kernel_does_not() -> None:
    """Many states, and all where there is no compiler."""
    many = equations(31, 2, "euler")
    with numpy_alone():
        few = equations(2, 4, "gauss")
        solver = BorderedSolver(few)
    for problem, solve in ((many, BorderedSolver(many).factor), (few, solver.factor)):
        nonzeros, row = random_matrix(problem, 0)
        matrix, largest = balanced(problem, nonzeros, row)
        found = solve(problem.units, nonzeros, row)
        assert isinstance(found, SparseFactors)
        np.testing.assert_allclose(matrix @ (found(largest) / problem.units), 1.0, rtol=0, atol=1e-11)


@needs_kernels
def test_borders_of_special_orbits_are_solved_as_by_superlu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also transposed; of a torus two copies of an orbit are eliminated side by side.

    No state depends on the parameter at the branch point, which the border alone has in its equations.
    """
    condensed, kinds = SingularProblem._condensed, set[str]()

    def compared(problem: SingularProblem, K: Triplets, b: Array, c: Array) -> BothWays | None:
        found = condensed(problem, K, b, c)
        kinds.add(problem.singularity.kind)
        for one, other in zip(found, _sparse(K, b, c), strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-10 * np.max(np.abs(other)))
        return found

    monkeypatch.setattr(SingularProblem, "_condensed", compared)
    (torus, crossing) = Truth((Block((0.05, -0.1), 0.7), Block((-0.07, 0.1)))).follow().special_points  # type: ignore
    assert (torus.kind, crossing.kind) == ("torus", "branch point")
    lure, alpha = ca.SX.sym("x", 3), ca.SX.sym("alpha")
    rhs = ca.vertcat(lure[1], lure[2], -alpha * lure[2] - lure[1] - lure[0] + lure[0] ** 2)
    (hopf,) = (
        find_equilibrium(OdeModel("lure", lure, rhs, alpha), [0, 0, 0], parameters={"alpha": 2.0})
        .follow("alpha", 0.5)
        .special_points
    )
    doubling = hopf.follow("alpha", 0.6, stability=True).special_points[-1]
    assert (doubling.kind, doubling.parameters["alpha"]) == ("period doubling", pytest.approx(0.63030201, abs=1e-7))
    orbit = find_orbit(
        cycles_with_fold(), lambda t: [1.1 * np.cos(t), 1.1 * np.sin(t)], 2 * np.pi,
        parameters={"mu": 1.1**4 - 1.1**2, "a": 1.0},
    )  # fmt: skip
    assert [point.kind for point in orbit.follow("mu", -0.5).special_points] == ["fold", "hopf"]
    assert kinds == {"torus", "branch point", "period doubling", "fold"}


def test_two_meshes_share_a_solver_and_no_factors() -> None:
    problem = equations(2, 6, "gauss")
    solver, b = BorderedSolver(problem), np.ones(problem.size)
    matrices = [random_matrix(problem, seed) for seed in range(3)]
    solves = [solver.factor(problem.units, *matrix) for matrix in matrices]
    solutions = [solve(b) for solve in solves]
    for one, other in pairwise(solutions):
        assert not np.allclose(one, other)
    for solve, x in zip(solves, solutions, strict=True):
        np.testing.assert_array_equal(solve(b), x)
