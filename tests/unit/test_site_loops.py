"""C with loops over sites: the same values as the expressions, and loops where rows repeat."""

from __future__ import annotations

import shutil
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from c_programs import Library

from casadi_skin import Bond, Lattice, OdeModel, Site, export_c

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not there (CI has it)")


def agree(model: OdeModel, folder: Path, name: str) -> str:
    """The source, after its right-hand side and Jacobian were compared with the expressions."""
    library = Library(export_c(model, folder, ["rhs", "jacobian"], name=name), name)
    n, x, p = model.full_size, np.sin(np.arange(model.full_size) + 1.0), np.array(model.nominal or [], dtype=float)
    rates, dxdt = np.empty(n), np.empty(n)
    dfdx, dfdp = library.work("JACOBIAN_NONZEROS"), np.full((max(1, p.size), n), np.nan)
    assert library.call("rhs", 0.3, x, p, rates, library.work("RHS_WORK")) == 0
    assert library.call("jacobian", 0.3, x, p, dxdt, dfdx, dfdp, library.work("JACOBIAN_WORK")) == 0
    by_x, by_p = (ca.densify(ca.jacobian(model.full_rhs, s)) for s in (model.full_state, model.parameters))
    known = [np.array(v) for v in model.function("f", model.full_rhs, by_x, by_p)(0.3, x, p)]
    np.testing.assert_allclose(rates, known[0].ravel(), atol=1e-14)
    np.testing.assert_allclose(dxdt, known[0].ravel(), atol=1e-14)
    np.testing.assert_allclose(library.sparse("jacobian", dfdx, n), known[1], atol=1e-14)
    if p.size:
        np.testing.assert_allclose(dfdp.T, known[2], atol=1e-14)
    return (folder / f"{name}.c").read_text()


def test_a_lattice_of_two_sites_a_cell_with_values_by_cell(tmp_path: Path) -> None:
    sites = [Site("a", onsite="k*y + g*y^3", mass="2"), Site("b", onsite="sin(y)", damping="0.1*y^2")]
    bonds = [Bond("a", "b", (0,), force="d + d^3", gain=("1 - r", "1 + r")), Bond("b", "a", (1,), force="exp(d) - 1")]
    stiffness = [1.0 + 0.1 * k for k in range(12)]
    lattice = Lattice(12, sites, bonds, parameters={"k": stiffness, "g": 0.5, "r": 0.2})
    text = agree(lattice, tmp_path / "c", "two")
    rhs = text.partition("int two_rhs(")[2].partition("int two_jacobian(")[0]
    assert rhs.count("for (") == 2  # positions, and both sites of the inner cells
    assert "static const double" in text  # the stiffness by cell


@pytest.mark.slow
def test_a_lattice_in_the_plane_and_a_ring(tmp_path: Path) -> None:
    bonds = [Bond("a", "a", (1, 0)), Bond("a", "a", (0, 1), force="d^2")]
    plane = Lattice([9, 8], [Site("a", onsite="y^3")], bonds)
    agree(plane, tmp_path / "plane", "plane")
    ring = Lattice(20, [Site("a")], [Bond("a", "a", (1,), force="d + 0.3*d^2")], "periodic")
    agree(ring, tmp_path / "ring", "ring")


def test_every_operation_has_its_meaning(tmp_path: Path) -> None:
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    terms = [
        ca.if_else(x[0] < p[0], x[1], -x[2]), ca.sign(x[0]) * ca.fabs(x[1]), ca.fmin(x[0], p[1]) / x[2],
        ca.fmod(x[0], 0.3), ca.floor(3 * x[1]), ca.logic_and(x[0] > 0, x[1] > 0), ca.logic_not(x[0] > 0.5),
        ca.atan2(x[0], x[1]), ca.sqrt(1 + x[0] ** 2), x[0] ** p[0], 1 / x[1], 2 * x[2], ca.exp(-x[0]), x[1] ** 7,
    ]  # fmt: skip
    rhs = ca.vertcat(sum(terms), x[0] * terms[0], ca.tanh(x[2]))
    model = OdeModel("operations", x, rhs, p, nominal=(0.4, 1.2), state_labels=("α", "β", "β′"))
    agree(model, tmp_path / "c", "operations")
    names = (tmp_path / "c" / "operations.c").read_text()
    assert '"\\316\\261"' in names  # alpha in UTF-8
    assert (tmp_path / "c" / "license.txt").is_file()
