"""Special points of programs, such as FMUs, followed in two parameters: those of the same equations as expressions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import ab
from foreign_fmus import casadi_fmu
from programs import Program

from casadi_skin import OdeModel, find_equilibrium, find_orbit, import_fmu


def reaction(x: ca.MX, y: ca.MX, p: ca.MX, p2: ca.MX, p3: ca.MX) -> tuple[ca.MX, ca.MX]:
    """The A to B reaction of AUTO-07p's demo `ab`."""
    rate = p * (1 - x) * ca.exp(y)
    return -x + rate, -y + p2 * rate - p3 * y


@pytest.mark.slow
def test_folds_and_hopf_points_of_an_fmu_are_those_of_its_equations(tmp_path: Path) -> None:
    path = casadi_fmu(tmp_path, "ab", reaction, {"x": 0.0, "y": 0.0}, {"p": 0.0, "p2": 14.0, "p3": 2.0})
    models = import_fmu(path, parameters=["p", "p2", "p3"]), ab()
    points, known = (find_equilibrium(model, [0, 0]).follow("p", 0.2).special_points for model in models)
    assert [point.kind for point in points] == ["fold", "fold", "hopf"]
    for point, exact, to in zip(points, known, (13.4, 13.9, 13.9), strict=True):
        assert point.parameters["p"] == pytest.approx(exact.parameters["p"], abs=1e-14)
        assert point.coefficient == pytest.approx(exact.coefficient, rel=1e-4)
        curve, other = point.curve("p2", to), exact.curve("p2", to)
        assert curve.complete
        assert curve["p"][-1] == pytest.approx(other["p"][-1], abs=1e-13)
        found, there = ([(q.kind, q.parameters["p2"]) for q in c.special_points] for c in (curve, other))
        assert [kind for kind, _ in found] == [kind for kind, _ in there]
        assert [place for _, place in found] == pytest.approx([place for _, place in there], abs=1e-10)


@pytest.mark.slow
def test_the_generalized_hopf_point_of_an_fmu_is_that_of_its_equations_within_its_error(tmp_path: Path) -> None:
    """Higher derivatives are differences of its Jacobian: the error is what steps twice as long change."""

    def rates(x: Any, y: Any, w: Any, mu: Any, b: Any) -> tuple[Any, Any, Any]:
        s = x**2 + y**2
        growth, turn = mu + (b - 0.3) * s - s**2 + 0.5 * w, 1 + b
        return growth * x - turn * y, growth * y + turn * x + 0.2 * x**2, s + 0.4 * x * y - w

    names = ("x", "y", "w", "mu", "b")
    path = casadi_fmu(tmp_path, "bautin", rates, dict.fromkeys(names[:3], 0.0), {"mu": -0.5, "b": -0.6})
    x, y, w, mu, b = (ca.SX.sym(name) for name in names)
    same = OdeModel("bautin", ca.vertcat(x, y, w), ca.vertcat(*rates(x, y, w, mu, b)), ca.vertcat(mu, b))
    found = []
    for model in (import_fmu(path, parameters=["mu", "b"]), same):
        start = find_equilibrium(model, np.zeros(3), parameters={"mu": -0.5, "b": -0.6})
        (hopf,) = start.follow("mu", 0.5).special_points
        (point,) = hopf.curve("b", 0.6).special_points
        assert point.kind == "generalized hopf"
        found.append(point)
    mine, exact = found
    assert abs(mine.parameters["b"] - exact.parameters["b"]) <= mine.error + exact.error < 1e-4
    assert mine.error > 1e-7  # differences do not have more digits


@pytest.mark.slow
def test_a_fold_of_cycles_of_an_fmu_is_followed(tmp_path: Path) -> None:
    """r' = r (mu + a r^2 - r^4): the fold is along mu = -a^2/4."""

    def rates(x: ca.MX, y: ca.MX, mu: ca.MX, a: ca.MX) -> tuple[ca.MX, ca.MX]:
        s = x**2 + y**2
        return (mu + a * s - s**2) * x - y, (mu + a * s - s**2) * y + x

    path = casadi_fmu(tmp_path, "cycles", rates, {"x": 1.0, "y": 0.0}, {"mu": 0.1, "a": 1.0})
    orbit = find_orbit(
        import_fmu(path, parameters=["mu", "a"]), lambda t: [np.cos(t), np.sin(t)], 6.28, tolerance=1e-5,
        corrector="newton",
    )  # fmt: skip
    branch = orbit.follow("mu", -0.26, until=lambda solution: solution.point.special == "fold")
    curve = branch.special_points[0].curve("a", 1.01, max_points=2)
    assert len(curve) > 1
    assert np.max(np.abs(curve["mu"] + curve["a"] ** 2 / 4.0)) < 1e-9


@pytest.mark.slow
def test_a_program_of_first_derivatives_alone_has_the_curves_of_its_formulas() -> None:
    """Folds, a Hopf point and a pitchfork in two parameters, by differences of the Jacobian."""
    state, p = ca.MX.sym("state", 2), ca.MX.sym("p", 3)
    field = ca.Function("reaction", [state, p], [ca.vertcat(*reaction(*ca.vertsplit(state), *ca.vertsplit(p)))])
    program, labels = Program(field, orders=1), ("p", "p2", "p3")
    model = OdeModel("ab", state, program(state, p), p, nominal=(0, 14, 2), parameter_labels=labels)
    points, known = (find_equilibrium(m, [0, 0]).follow("p", 0.2).special_points for m in (model, ab()))
    assert [point.kind for point in points] == ["fold", "fold", "hopf"]
    for point, exact in zip(points, known, strict=True):
        assert point.parameters["p"] == pytest.approx(exact.parameters["p"], abs=1e-14)
        curve, other = point.curve("p2", 13.9), exact.curve("p2", 13.9)
        assert curve.complete
        assert curve["p"][-1] == pytest.approx(other["p"][-1], abs=1e-13)

    x, y = ca.MX.sym("x"), ca.MX.sym("y")
    square = Program(ca.Function("square", [x, y], [x * y - x**3]), orders=1)
    q = ca.MX.sym("q", 2)
    model = OdeModel("pitchfork", x, square(x, q[0] - q[1] ** 2), q, nominal=(-1.0, 0.0), parameter_labels=("a", "b"))
    (pitchfork,) = find_equilibrium(model, [0.0]).follow("a", 0.5).special_points
    curve = pitchfork.curve("b", 0.6)
    np.testing.assert_allclose(curve["a"], curve["b"] ** 2, atol=1e-13)
