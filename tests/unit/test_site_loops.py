"""C with loops over sites: the same values as the expressions, and loops where rows repeat."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
from pathlib import Path
from typing import Literal

import casadi as ca
import numpy as np
import pytest
from c_programs import COMPILERS, Library

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


def code(source: Path, name: str) -> str:
    """The functions of a source, without its tables of names and structure."""
    return source.read_text().partition(f"int {name}_rhs(")[2].partition("const int ")[0]


def plane(cells: list[int], boundary: Literal["fixed", "free", "periodic"] = "fixed") -> Lattice:
    bonds = [Bond("a", "a", (1, 0), gain=("1 - r", "1 + r")), Bond("a", "a", (0, 1), force="d + 0.1*d^3")]
    return Lattice(cells, [Site("a", onsite="k*y + y^3")], bonds, boundary, parameters={"k": 1.0, "r": 0.25})


@pytest.mark.parametrize("boundary", ["fixed", "free", "periodic"])
def test_planes_are_loops_in_both_directions(boundary: Literal["fixed", "free", "periodic"], tmp_path: Path) -> None:
    text = agree(plane([9, 14], boundary), tmp_path / "c", "plane")
    inner = text.partition("int plane_rhs(")[2].partition("int plane_jacobian(")[0]
    assert "    for (int i = 0; i < 7; i++) {" in inner  # lines between the outer ones, and cells between their ends
    assert "        for (int j = 0; j < 12; j++) {" in inner
    assert "+ 15] - x[14 * i + j + 14]" in inner or "x[14 * i + j + 15] - " in inner
    other = export_c(plane([21, 30], boundary), tmp_path / "other", ["rhs", "jacobian"], name="plane")
    assert len(code(other / "plane.c", "plane")) < 1.02 * len(code(tmp_path / "c" / "plane.c", "plane")) < 45_000


@pytest.mark.slow
def test_planes_with_far_bonds_are_loops_too(tmp_path: Path) -> None:
    """Cells at the boundary are written apart, of which there are many; CasADi's code grows with the plane."""
    bonds = [Bond("a", "a", at, force="k*sin(d) + d^3") for at in ((1, 0), (0, 1), (1, 1), (-1, 2), (2, -1))]
    sizes = []
    for cells in ([20, 24], [26, 30]):
        lattice = Lattice(cells, [Site("a", onsite="k*y + y^3")], bonds, "periodic", parameters={"k": 1.0})
        folder = export_c(lattice, tmp_path / str(cells[0]), ["rhs", "jacobian"], name="far")
        assert not (folder / "far_generated.c").exists()
        sizes.append(len(code(folder / "far.c", "far")))
    assert sizes[1] < 1.03 * sizes[0]
    library, x = Library(folder, "far"), np.sin(np.arange(lattice.full_size) + 1.0)
    dxdt, dfdx = np.empty(x.size), library.work("JACOBIAN_NONZEROS")
    library.call("jacobian", 0.0, x, np.ones(1), dxdt, dfdx, None, library.work("JACOBIAN_WORK"))
    known = lattice.function("f", lattice.full_rhs, ca.jacobian(lattice.full_rhs, lattice.full_state))(0.0, x, 1.0)
    np.testing.assert_allclose(dxdt, np.array(known[0]).ravel(), atol=1e-14)
    np.testing.assert_allclose(dfdx, known[1].nonzeros(), atol=1e-14)


def test_planes_of_two_sites_a_cell_and_a_ring(tmp_path: Path) -> None:
    """A honeycomb whose stiffness is that of the cell, in a table of loops in loops; and a chain that is closed."""
    stiffness = [[1.0 + 0.01 * (i**2 + j) for j in range(10)] for i in range(8)]
    sites = [Site("a", onsite="k*y + y^3"), Site("b", onsite="sin(y)")]
    bonds = [Bond("a", "b", (0, 0)), Bond("b", "a", (1, 0), force="d^2"), Bond("b", "a", (0, 1), force="exp(d) - 1")]
    text = agree(Lattice([8, 10], sites, bonds, parameters={"k": stiffness}), tmp_path / "plane", "plane")
    assert "[9 * i + j]" in text  # the stiffness of the inner cells
    ring = Lattice(20, [Site("a")], [Bond("a", "a", (1,), force="d + 0.3*d^2")], "periodic")
    agree(ring, tmp_path / "ring", "ring")


def test_a_block_in_space_is_loops_in_three_directions(tmp_path: Path) -> None:
    """With the stiffness of every cell in tables: their indices go through all three."""
    cells = (8, 9, 10)
    x, stiffness = ca.SX.sym("x", math.prod(cells)), np.random.default_rng(4).uniform(1.0, 2.0, cells)

    def at(*cell: int) -> ca.SX:
        inside = all(0 <= place < size for place, size in zip(cell, cells, strict=True))
        return x[int(np.ravel_multi_index(cell, cells))] if inside else 0

    rates = [
        at(i - 1, j, k) + at(i + 1, j, k) + at(i, j - 1, k) + at(i, j + 1, k) + at(i, j, k - 1) - c * at(i, j, k) ** 3
        for (i, j, k), c in np.ndenumerate(stiffness)
    ]
    assert "[63 * i + 9 * j + k]" in agree(OdeModel("block", x, ca.vertcat(*rates)), tmp_path / "c", "block")


@pytest.mark.slow
@pytest.mark.parametrize("compiler", COMPILERS)
def test_a_large_plane_compiles_in_a_second(compiler: str, tmp_path: Path) -> None:
    """Processor time; every row on its own took gcc half a minute."""
    source = export_c(plane([60, 60]), tmp_path / "c", ["rhs", "jacobian"], name="plane") / "plane.c"
    assert len(code(source, "plane")) < 45_000
    before = os.times().children_user
    subprocess.run([compiler, "-std=c99", "-O2", "-c", str(source), "-o", str(tmp_path / "o.o")], check=True)
    assert os.times().children_user - before < 1


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
