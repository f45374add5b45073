"""Lattices as models: the same numbers as equations written by hand, what they find out by themselves, refusals."""

from __future__ import annotations

import pickle
from typing import Any

import casadi as ca
import numpy as np
import pytest
from lattices import GAINS, chain, dimer, fput, plane
from marks import slow

from casadi_skin import Bond, Chain, Lattice, OdeModel, Site, Uniform, follow_family, optimise
from casadi_skin.lattice.chain import declared_chain


def accelerations(model: OdeModel, y: Any, parameters: Any = ()) -> Any:
    """The accelerations at positions, by the model's nominal parameters unless others are given."""
    rhs = ca.Function("f", [model.state, model.parameters], [model.rhs])
    return np.array(rhs(y, parameters or model.nominal)).ravel()


# The same numbers -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sites", "gamma", "mode", "g"), [slow(7, 0.3, 4, 1.0), slow(24, -0.25, 24, 1.0), slow(48, 0.6, 1, -1.0)]
)
def test_the_chain_as_a_lattice_has_the_numbers_of_the_chain(sites: int, gamma: float, mode: int, g: float) -> None:
    """To the last digit: it is solved in the chain's coordinates."""
    models = Chain(sites, 0.9, gamma, g), chain(sites, 0.9, gamma, g)
    options = {"mode": mode, "amplitude_max": 1.0, "stability": True, "tolerance": 1e-9}
    ours, theirs = (follow_family(model, at=(0.2, 1.0), **options) for model in models)
    assert np.array_equal(ours.S, theirs.S)
    assert np.array_equal(ours.Omega, theirs.Omega)
    assert [change.S for change in ours.changes] == [change.S for change in theirs.changes]
    a, b = (branch.at(S=1.0) for branch in (ours, theirs))
    assert b.energy == a.energy
    assert np.array_equal(b.floquet().multipliers, a.floquet().multipliers)


def test_a_lattice_that_is_the_chain_keeps_its_own_parameters() -> None:
    bond = Bond("a", "a", (-1,), "d", ("1 + lean", "1 - lean"))
    lattice = Lattice(6, [Site("a", "(k + 1)*y + h*y^3/2")], [bond], "fixed", {"k": 0.5, "lean": 0.1, "h": -1.0})
    options = {"mode": 1, "amplitude_max": 0.2, "tolerance": 1e-9}
    branch = follow_family(lattice, parameters={"lean": 0.3, "h": -2.0}, **options)
    assert np.array_equal(branch.Omega, follow_family(Chain(6, 1.5, 0.3, -1.0), **options).Omega)
    moved = branch.orbits[-1].follow("lean", 0.2)
    assert moved.parameters["k"][-1] == 0.5
    there = follow_family(lattice, parameters={"lean": 0.2, "h": -2.0}, at=(0.2,), **options)
    assert moved.Omega[-1] == pytest.approx(there.at(S=0.2).Omega, rel=1e-8)


@pytest.mark.parametrize(
    ("onsite", "force", "gain", "mass", "boundary"),
    [
        ("y + y^3", "2*d", GAINS, "1", "fixed"),
        ("y + y^3 + y^5", "d", GAINS, "1", "fixed"),
        ("sin(y)", "d", GAINS, "1", "fixed"),
        ("n*y + y^3", "d", GAINS, "1", "fixed"),
        ("y + y^3", "d + d^3", GAINS, "1", "fixed"),
        ("y + y^3", "d", ("1", "1 + gamma"), "1", "fixed"),
        ("y + y^3", "d", GAINS, "2", "fixed"),
        ("y + y^3", "d", GAINS, "1", "free"),
    ],
)
def test_what_is_not_the_chain_is_not_taken_for_it(
    onsite: str, force: str, gain: tuple[str, str], mass: str, boundary: str
) -> None:
    lattice = Lattice(4, [Site("a", onsite, mass)], [Bond("a", "a", (1,), force, gain)], boundary, {"gamma": 0.2})
    assert declared_chain(lattice.declaration, lattice.equations.reversible, {"gamma": 0.2}) is None


@pytest.mark.parametrize(("sites", "energy"), [(8, 0.5320603626), slow(32, 0.1043149731)])
def test_the_pi_mode_of_fput_loses_stability_at_the_published_energy(sites: int, energy: float) -> None:
    S = 0.3 if sites == 8 else 0.06
    branch = follow_family(fput(sites, "periodic"), mode="last", amplitude_max=S, tolerance=1e-9, stability=True)
    place = branch.changes[0].place
    found, slope = 2.0 * place.S + 4.0 * place.S**2 / sites, 2.0 + 8.0 * place.S / sites  # of y_n = (-1)^n sqrt(S/N)
    assert place.S_error < 1e-9  # two equal multipliers leave the circle, and are one in the search
    assert abs(found - energy) < slope * place.S_error + 5e-11  # the published digits


def test_the_pi_mode_of_fput_has_its_exact_period() -> None:
    branch = follow_family(fput(8, "periodic"), mode="last", amplitude_max=2.0, at=(2.0,), tolerance=1e-12)
    assert branch.at(S=2.0).period == pytest.approx(2.38401101455, abs=1e-11)  # amplitude 0.5, elliptic functions


def test_values_by_cell_and_boundaries_against_sums_by_hand() -> None:
    k, e = [1.0, 2.0, 0.5, 3.0], Uniform(-0.1, 0.1, seed=5)
    site = Site("a", "(k + e + n/10)*y", mass="m0*s")
    parameters = {"s": "1 + q", "k": k, "e": e, "m0": 2.0, "q": "n/4"}
    y, n = np.array([0.3, -0.2, 0.7, 0.1]), np.arange(1, 5)
    onsite = (np.array(k) + np.random.default_rng(5).uniform(-0.1, 0.1, (4,)) + n / 10) * y
    for boundary, padded in (
        ("fixed", np.array([0.0, *y, 0.0])), ("periodic", np.array([y[-1], *y, y[0]])),
        ("free", np.array([y[0], *y, y[-1]])),
    ):  # fmt: skip
        lattice = Lattice(4, [site], [Bond("a", "a", (1,), "d + d^3", ("2", "3"))], boundary, parameters)
        d = np.diff(padded)
        force = d + d**3
        expected = (-onsite + 2.0 * force[1:] - 3.0 * force[:-1]) / (2.0 * (1 + n / 4))
        assert accelerations(lattice, y) == pytest.approx(expected, rel=1e-14)


def test_a_plane_against_sums_by_hand() -> None:
    lattice, y = plane((3, 2)), np.random.default_rng(1).normal(size=(3, 2))
    padded = np.pad(y, 1)
    dx, dy = np.diff(padded[:, 1:-1], axis=0), np.diff(padded[1:-1], axis=1)
    expected = -(y - y**3) + 0.7 * dx[1:] - 1.3 * dx[:-1] + 0.85 * dy[:, 1:] - 1.15 * dy[:, :-1]
    assert accelerations(lattice, y.ravel()) == pytest.approx(expected.ravel(), rel=1e-13)
    assert lattice.state_names[:3] == ("y_1_1", "y_1_2", "y_2_1")


# What lattices find out -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lattice", "lean"),
    [
        (chain(8, 1.0, 0.25, -1.0), (5 / 3) ** 3.5),
        (plane(), (1.3 / 0.7) ** 2.5 * (1.15 / 0.85) ** 2),
        (fput(5, "free"), 1.0),
    ],
)
def test_the_gauge_is_that_of_the_bonds(lattice: Lattice, lean: float) -> None:
    assert lattice.structure.log_weights is not None
    assert np.exp(0.5 * np.max(lattice.structure.log_weights)) == pytest.approx(lean, rel=1e-12)
    assert lattice.structure.hamiltonian
    assert lattice.hamiltonian is not None


def test_gains_that_disagree_around_a_loop_have_no_gauge() -> None:
    ring = Lattice(6, [Site("a", "y + y^3")], [Bond("a", "a", (1,), gain=GAINS)], "periodic", {"gamma": 0.2})
    damped = Lattice(6, [Site("a", "y", damping="0.1")], [Bond("a", "a", (1,), gain=GAINS)], "periodic", {"gamma": 0.2})
    assert ring.structure.log_weights is damped.structure.log_weights is None
    assert ring.hamiltonian is None
    with pytest.raises(ValueError, match=r"omega\^2 = .*j of a linear mode is complex; accepted: real ones"):
        follow_family(ring, mode=1, amplitude_max=1.0)


def test_two_bonds_of_different_gains_are_reversible_only_and_one_of_the_same_is_hamiltonian() -> None:
    linear, cubic = Bond("a", "a", (1,), "d", ("0.8", "1.2")), Bond("a", "a", (1,), "d^3")
    reversible = Lattice(8, [Site("a", "y")], [linear, cubic])
    same = Lattice(8, [Site("a", "y")], [Bond("a", "a", (1,), "d + d^3", ("0.8", "1.2"))])
    for lattice, hamiltonian in ((reversible, False), (same, True)):
        branch = follow_family(lattice, mode=1, amplitude_max=0.1)
        assert lattice.structure.hamiltonian is hamiltonian is branch.space.coordinates.symplectic
    assert "no Krein signatures" in dict(reversible.structure.lines())["flow"]


def test_what_holds_at_the_declared_values_alone_is_not_declared() -> None:
    bonds = [Bond("a", "a", (1,), gain=("p", "1")), Bond("a", "a", (2,))]
    assert Lattice(5, [Site("a", "y")], bonds, "fixed", {"p": 1.0}).hamiltonian is None


@pytest.mark.parametrize(
    ("onsite", "force", "odd", "polynomial"),
    [
        ("y + y^3", "d", True, True),
        ("y + y^2", "d", False, True),
        ("sin(y)", "d", True, False),
        ("y", "exp(d) - 1", False, False),
    ],
)
def test_oddness_and_polynomials(onsite: str, force: str, odd: bool, polynomial: bool) -> None:
    lattice = Lattice(4, [Site("a", onsite)], [Bond("a", "a", (1,), force)])
    assert (lattice.structure.odd, lattice.structure.polynomial) == (odd, polynomial)
    assert (lattice.half_period is not None) == odd
    lattice.check_symmetries()


def test_momentum_and_mirrors() -> None:
    assert fput(6, "periodic").structure.momentum
    assert not fput(6, "fixed").structure.momentum
    assert plane((3, 3)).structure.mirrors == ()
    assert dimer(4).structure.mirrors == ()
    reciprocal = Lattice((3, 2), [Site("a", "y")], [Bond("a", "a", (1, 0)), Bond("a", "a", (0, 1), "2*d")])
    assert reciprocal.structure.mirrors == (1, 2)
    assert Lattice((3, 2), [Site("a", "n*y")], [Bond("a", "a", (1, 0))]).structure.mirrors == (2,)


@pytest.mark.slow
def test_a_gauge_that_overflows_leaves_the_energy_out() -> None:
    assert chain(400, 1.0, 0.9, 1.0).hamiltonian is None
    assert chain(400, 1.0, 0.25, 1.0).hamiltonian is not None


def test_lattices_go_to_other_processes_and_to_designs_as_models() -> None:
    lattice = dimer(3)
    other = pickle.loads(pickle.dumps(lattice))
    y = np.linspace(0.1, 0.6, 6)
    assert accelerations(other, y) == pytest.approx(accelerations(lattice, y), rel=1e-15)
    changed = lattice.with_nominal((0.7, 1.1, 0.2, -1.0, 2.0))
    assert accelerations(changed, y) == pytest.approx(accelerations(lattice, y, changed.nominal), rel=1e-15)
    orbit = follow_family(lattice, 1, 0.3).orbits[-1]
    found = optimise("Omega", orbit, over=["u"], bounds={"u": (0.4, 0.6)})
    assert (found["u"], found.active) == (pytest.approx(0.4, abs=1e-12), ("u >= 0.4",))


# Refusals -------------------------------------------------------------------------------------------------------------

A = Site("a", "y")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"bonds": [Bond("a", "b", (1,))]}, 'bond 1 to: given \'b\''),
        ({"bonds": [Bond("a", "a", (1,)), Bond("c", "a", (1,))]}, "bond 2 from: given 'c'"),
        ({"bonds": [Bond("a", "a", (1, 0))]}, r"bond 1 offset: given \[1, 0\]; accepted: 1 whole number,"),
        ({"bonds": [Bond("a", "a", (0,))]}, r"bond 1 offset: given \[0\], which leads from each a to itself"),
        ({"bonds": [Bond("a", "a", (4,))], "boundary": "periodic"}, "leads from each a to itself"),
        ({"bonds": [Bond("a", "a", (1,), "d + x")]}, 'bond 1 force: column 5: given the name "x"; accepted: d, c, n'),
        ({"bonds": [Bond("a", "a", (1,), gain=("1", "1 - c"))]}, 'bond 1 gain 2: given "1 - c", which is 0 in cell 1'),
        ({"bonds": [Bond("a", "a", (1,), "log(d)")]}, 'bond 1 force: given "log\\(d\\)", which is -inf in cell 1'),
        ({"sites": [Site("a", "1/y")]}, 'site 1 onsite: given "1/y", which is (inf|nan) in cell 1; .*finite at rest'),
        ({"sites": [Site("a", "9^9^9^9*y")]}, 'site 1 onsite: given "9.*y", which is not finite in cell 1; .*rest'),
        ({"bonds": [Bond("a", "a", (1,), "d + 9^9^9^9*d^3")]}, 'bond 1 force: given "d.*, which is not finite'),
        ({"sites": [Site("a", mass="2 - n")]}, 'site 1 mass: given "2 - n", which is 0 in cell 2; .*a mass > 0'),
        ({"sites": [A, A]}, "site 2 name: given 'a'"),
        ({"sites": []}, "sites: given none"),
        ({"cells": [2, 2, 2]}, "cells: given"),
        ({"cells": 0}, "cells: given 0"),
        ({"boundary": "perodic"}, "did you mean periodic"),
        ({"boundary": ["free", "free"]}, "boundary: given .*accepted: one word"),
        ({"parameters": {"y": 1.0}}, "parameters: given the name 'y'"),
        ({"parameters": {"k": [1.0, 2.0]}}, r"parameters k: given numbers of shape \[2\]; accepted: 4 finite numbers"),
        ({"parameters": {"k": "1 + z"}}, 'parameters k: column 5: given the name "z"'),
        ({"parameters": {"k": "2*p", "p": "k + 1"}}, 'parameters k: given "2\\*p", which depends on itself'),
        ({"parameters": {"k": float("nan")}}, "parameters k: given nan"),
        ({"forcing_period": "1"}, "forcing_period: given '1' without a drive"),
        ({"sites": [Site("a", "y", drive="t")]}, 'site 1 drive: given "t"; accepted: sines and cosines'),
        ({"sites": [Site("a", "y", drive="cos(t) + sin(2*t)")]}, "drives of frequencies 1 and 2; accepted"),
    ],
)  # fmt: skip
def test_refusals_are_one_line_with_the_place(given: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {"cells": 4, "sites": [A], "parameters": {"c": 1.0}} | given
    with pytest.raises((ValueError, TypeError), match=message) as caught:
        Lattice(**arguments)
    assert "\n" not in str(caught.value)


def test_an_unstable_linear_lattice_is_refused_by_its_families() -> None:
    with pytest.raises(ValueError, match=r"mode 1 of lattice does not oscillate: omega\^2 = -"):
        follow_family(chain(4, -3.0, 0.2, 1.0), mode=1, amplitude_max=1.0)


@pytest.mark.parametrize("more", ["", " + y^5"])
def test_a_parameter_at_which_a_formula_is_not_finite_is_refused_with_the_formula(more: str) -> None:
    """Where the lattice is the chain of the paper, and where another power makes it no longer so."""
    lattice = Lattice(3, [Site("a", f"y + c^999*y^3{more}")], [Bond("a", "a", (1,))], parameters={"c": 1.0})
    with pytest.raises(ValueError, match=r'site 1 onsite: given "y \+ c\^999\*y\^3.*", in which a value is not finite'):
        follow_family(lattice, 1, 0.5, parameters={"c": 9.0})


@pytest.mark.parametrize(("onsite", "bond"), [("y + sqrt(abs(y))*y", "d"), ("y", "d + sqrt(abs(d))*d")])
def test_a_force_that_is_not_smooth_at_rest_is_named(onsite: str, bond: str) -> None:
    with pytest.raises(ValueError, match="lattice: the force on y_1 is not smooth at rest") as caught:
        follow_family(Lattice(3, [Site("a", onsite)], [Bond("a", "a", (1,), bond)]), 1, 0.5)
    assert "\n" not in str(caught.value)


def test_modes_that_share_their_frequency_are_refused() -> None:
    with pytest.raises(ValueError, match="modes 2, 3 of lattice have the same frequency"):
        follow_family(fput(8, "periodic"), mode=2, amplitude_max=0.1)
