"""Equations in odd cosines by the compiled kernel: those of CasADi for every kind of operation, or none at all."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from kernels import needs_kernels, numpy_alone
from lattices import plane
from orbit_problems import gauss_problem
from small_models import pendulums

from casadi_skin import Chain, follow_family
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.ode import OdeModel
from casadi_skin.native import OPERATIONS
from casadi_skin.zero.collocation import CollocationProblem
from casadi_skin.zero.cosines import TrigonometricProblem
from casadi_skin.zero.family import family_request
from casadi_skin.zero.problem import Problem


def two_oscillators(force: Callable[[ca.SX, ca.SX], ca.SX]) -> OdeModel:
    """Two coupled oscillators with a force of their position, odd in it, and the parameter."""
    q, v, p = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("p")
    rhs = -q - 0.3 * (q - q[::-1]) - force(q, p)
    return OdeModel(
        "two oscillators", q, rhs, p, order=2, velocity=v, reversal=(1, 1, -1, -1), half_period=(-1,) * 4,
        normalisation=ca.dot(q, q) - 1 - 0.1 * q[0] * q[1],
    )  # fmt: skip


FORCES: dict[str, Callable[[ca.SX, ca.SX], ca.SX]] = {
    "polynomial": lambda q, p: p * q**3 - p**2 * q**5,
    "quotients": lambda q, p: q / (2 + p + q**2) + q * (1 / (3 + q * q)),
    "roots and powers": lambda q, p: q * ca.sqrt(1 + q**2) + q * (2 + q**2) ** 1.5 + q * (2 + q**2) ** (p**2),
    "circles": lambda q, p: ca.sin(q) + p * q * ca.cos(q) + ca.tan(0.3 * q),
    "exponentials": lambda q, p: q * ca.exp(-(q**2)) + p * q * ca.log(2 + q**2) + ca.tanh(p * q),
    "limits": lambda q, p: ca.if_else(p == 0, q**3, ca.sin(p * q) / p) + ca.if_else(p**2 <= 0.5, q**3, q),
    "none": lambda q, p: 0 * q,
}
MODELS = {
    **{f"chain of {n}": Chain(n, 1.0, 0.3, -1.0).gauge_model() for n in (1, 2, 24)},
    "pendulums": family_request(pendulums(), 1, 1.0).coordinates.scaled,
    "plane": family_request(plane((4, 3)), 1, 1.0).coordinates.scaled,
    **{name: two_oscillators(force) for name, force in FORCES.items()},
}


@needs_kernels
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("harmonics", [1, 4, 7])
def test_residuals_and_jacobians_are_those_of_casadi(name: str, harmonics: int) -> None:
    problem, generator = TrigonometricProblem(MODELS[name], harmonics), np.random.default_rng(harmonics)
    z = generator.normal(size=(3, problem.size))
    z[:, problem.Omega_index] = 0.9, 1.4, 2.3
    assert problem._kernel is not None
    np.testing.assert_array_equal(problem.pattern, problem.compiled.sparsity_out(1).get_triplet())
    found, expected = problem.evaluate_all(z), [Problem.evaluate(problem, one) for one in z]
    for values, exact in zip(found, zip(*expected, strict=True), strict=True):
        np.testing.assert_allclose(values, exact, rtol=0, atol=1e-14 * np.max(np.abs(exact)))
    for k, one in enumerate(z):  # the last bits do not depend on the number of states
        for values, alone in zip(found, problem.evaluate(one), strict=True):
            np.testing.assert_array_equal(values[k], alone)


@needs_kernels
def test_every_operation_of_the_kernel_is_tried() -> None:
    used = set[int]()
    for force in FORCES.values():
        model = two_oscillators(force)
        assert TrigonometricProblem(model, 2)._kernel is not None
        function = ca.Function("f", [model.state, model.parameters], [model.rhs, ca.jacobian(model.rhs, model.state)])
        used |= {function.instruction_id(k) for k in range(function.n_instructions())}
    assert {getattr(ca, f"OP_{name}") for name in OPERATIONS} - used <= {ca.OP_ASSIGN, ca.OP_POW, ca.OP_CONSTPOW}


def test_a_model_with_another_operation_is_left_to_casadi() -> None:
    problem = TrigonometricProblem(two_oscillators(lambda q, p: p * q * ca.fabs(q)), 3)
    assert problem._kernel is None
    z = np.random.default_rng(0).normal(size=(2, problem.size))
    found = problem.evaluate_all(z)
    np.testing.assert_array_equal(found[0][1], problem.evaluate(z[1])[0])


def test_points_of_one_programme_that_cannot_be_evaluated_leave_the_others_as_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = gauss_problem(Chain(4, 1.0, 0.3, -1.0).gauge_model(), 2, SymmetryClass.QUARTER, 3)
    z = np.random.default_rng(1).normal(size=(3, problem.size))
    assembled = CollocationProblem._values

    def values(self: CollocationProblem, point: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if np.array_equal(point, z[1]):
            raise ArithmeticError
        return assembled(self, point, numbers)

    monkeypatch.setattr(CollocationProblem, "_values", values)
    residuals, nonzeros = problem.evaluated(z, problem.numbers)
    assert np.all(np.isnan(residuals[1]))
    assert np.all(np.isnan(nonzeros[1]))
    expected = problem.evaluate_all(z[::2])
    np.testing.assert_allclose(residuals[::2], expected[0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(nonzeros[::2], expected[1], rtol=0, atol=1e-13)


@needs_kernels
@pytest.mark.parametrize("name", ["pendulums", "plane"])
def test_families_of_lattices_are_the_same_by_casadi(name: str) -> None:
    model = pendulums() if name == "pendulums" else plane((4, 3))
    compiled = follow_family(model, 1, 0.5, at=(0.2, 0.5))
    with numpy_alone():
        plain = follow_family(model, 1, 0.5, at=(0.2, 0.5))
    np.testing.assert_allclose(compiled.S, plain.S, rtol=0, atol=1e-12)
    np.testing.assert_allclose(compiled.Omega, plain.Omega, rtol=0, atol=1e-13)
