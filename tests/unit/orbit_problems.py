"""What tests of all transcriptions share: models written by hand, orbits solved for, derivatives to compare with."""

from __future__ import annotations

from typing import Any

import casadi as ca
import mpmath as mp
import numpy as np
from numpy.typing import NDArray

from casadi_skin.lattice.chain import Chain
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.ode import OdeModel
from casadi_skin.solve.ipopt import IpoptCorrector
from casadi_skin.solve.newton import Corrector, NewtonCorrector
from casadi_skin.zero.butcher import CollocationTable, gauss_table, radau_table
from casadi_skin.zero.collocation import CollocationProblem
from casadi_skin.zero.problem import OrbitProblem
from casadi_skin.zero.shooting import ShootingProblem

Array = NDArray[np.float64]
CORRECTORS: dict[str, type[NewtonCorrector] | type[IpoptCorrector]] = {
    "newton": NewtonCorrector,
    "ipopt": IpoptCorrector,
}


# Models ---------------------------------------------------------------------------------------------------------------


def asymmetric_oscillator(**changes: Any) -> OdeModel:
    """q'' = -q - p q^2, reversible but not odd, from q(0) = 1/2; written by hand."""
    q, v, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("p")
    declared: dict[str, Any] = {"reversal": (1, -1), "normalisation": q - 0.5, "checked": False}
    return OdeModel("asymmetric", q, -q - p * q**2, p, 2, v, **(declared | changes))


def oscillators(**changes: Any) -> OdeModel:
    """Two coupled cubic oscillators written by hand: q'' = -K q - p q^3, q(0).q(0) = 1."""
    q, v, p = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("p")
    force = -ca.DM([[2.0, -0.5], [-0.5, 3.0]]) @ q - p * q**3
    declared: dict[str, Any] = {"reversal": (1, 1, -1, -1), "half_period": (-1,) * 4, "normalisation": ca.dot(q, q) - 1}
    return OdeModel("oscillators", q, force, p, 2, v, **(declared | changes))


def predator_and_prey(**changes: Any) -> OdeModel:
    """x' = x (p - y), y' = y (x - 1) with x = 2 at its maximum: conservative, of first order, with no reversal."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    field = ca.vertcat(x[0] * (p - x[1]), x[1] * (x[0] - 1))
    conserved = x[0] - ca.log(x[0]) + x[1] - p * ca.log(x[1])
    declared: dict[str, Any] = {"normalisation": x[0] - 2, "hamiltonian": conserved, "checked": False}
    return OdeModel("predator and prey", x, field, p, **(declared | changes))


# Collocation ----------------------------------------------------------------------------------------------------------


def integrated_lagrange(nodes: list[mp.mpf], ends: list[mp.mpf]) -> mp.matrix:
    """Integrals from 0 to each end of the Lagrange polynomials of the nodes, (ends, nodes), in mpmath's precision."""
    table = mp.matrix(len(ends), len(nodes))
    for j, node in enumerate(nodes):
        lagrange = [mp.mpf(1)]  # coefficients, constant first
        for other in (*nodes[:j], *nodes[j + 1 :]):
            shifted, scaled = [mp.mpf(0), *lagrange], [other * a for a in lagrange] + [mp.mpf(0)]
            lagrange = [(a - b) / (node - other) for a, b in zip(shifted, scaled, strict=True)]
        for i, end in enumerate(ends):
            table[i, j] = sum(a * end ** (n + 1) / (n + 1) for n, a in enumerate(lagrange))
    return table


def check_table(table: CollocationTable, nodes: list[mp.mpf], ends: list[mp.mpf]) -> None:
    """A table is that of nodes and ends known to many digits."""
    assert (table.degree, table.extended.shape) == (len(nodes), (len(ends), len(nodes)))
    assert max(abs(mp.mpf(c) - exact) for c, exact in zip(table.nodes.tolist(), nodes, strict=True)) < 3e-16
    exact = integrated_lagrange(nodes, ends)
    for i, row in enumerate(table.extended.tolist()):
        assert max(abs(mp.mpf(value) - exact[i, j]) for j, value in enumerate(row)) < 1e-15


def gauss_problem(model: OdeModel, intervals: int, symmetry: SymmetryClass, degree: int = 5) -> CollocationProblem:
    """Gauss-Legendre collocation of an orbit."""
    return CollocationProblem(model, intervals, symmetry, gauss_table(degree))


def radau_problem(model: OdeModel, intervals: int, symmetry: SymmetryClass, degree: int = 5) -> CollocationProblem:
    """Radau IIA collocation of an orbit."""
    return CollocationProblem(model, intervals, symmetry, radau_table(degree))


# Orbits ---------------------------------------------------------------------------------------------------------------


def corrector_of(problem: OrbitProblem, kind: str = "newton") -> Corrector:
    """A corrector that asks for as many digits as the problem can give."""
    digits = problem.resolution if isinstance(problem, ShootingProblem) else 14
    return CORRECTORS[kind](problem, 10.0 ** (1 - min(digits, 13)))


def moved(problem: OrbitProblem, z: Array, target: float, steps: int, kind: str = "newton") -> Array:
    """The orbit with the free parameter at `target`, from z in equal steps."""
    corrector, row = corrector_of(problem, kind), problem.parameter_row()
    for value in np.linspace(z[problem.parameter_index], target, steps + 1):
        correction = corrector.correct(z, row, value)
        assert correction.converged, correction
        z = correction.z
    return z


def linear_mode(chain: Chain, mode: int) -> Array:
    """Gauge profile of a linear mode with sum of w q^2 equal to 1, typed out."""
    q = np.sin(mode * np.pi * np.arange(1, chain.sites + 1) / (chain.sites + 1))
    return np.asarray(q / np.sqrt(chain.weights @ q**2))


def solved(problem: OrbitProblem, chain: Chain, mode: int, kappa: float, steps: int = 8, kind: str = "newton") -> Array:
    """The orbit at kappa = g S, from the linear mode in equal steps."""
    z = problem.pack(linear_mode(chain, mode), chain.linear_frequency(mode), 0.0)
    return moved(problem, z, kappa, steps, kind)


# Derivatives ----------------------------------------------------------------------------------------------------------


def dense_jacobian(problem: OrbitProblem, z: Array) -> Array:
    """dR/dz as a full matrix."""
    matrix = np.zeros((problem.size - 1, problem.size))
    np.add.at(matrix, problem.pattern, problem.evaluate(z)[1])
    return matrix


def differences(problem: OrbitProblem, z: Array) -> Array:
    """Central differences along every unknown, of fourth order."""
    columns = []
    for unit in np.eye(problem.size):
        near, far = (
            (problem.evaluate(z + h * unit)[0] - problem.evaluate(z - h * unit)[0]) / (2 * h) for h in (1e-3, 2e-3)
        )
        columns.append((4 * near - far) / 3)
    return np.stack(columns, axis=1)


def check_jacobian(problem: OrbitProblem, z: Array, tolerance: float = 3e-10) -> None:
    """dR/dz is that of differences in every column, and no entry is there twice."""
    expected = differences(problem, z)
    np.testing.assert_allclose(dense_jacobian(problem, z), expected, rtol=0, atol=tolerance * np.abs(expected).max())
    rows, columns = problem.pattern
    assert len(set(zip(rows.tolist(), columns.tolist(), strict=True))) == rows.size
