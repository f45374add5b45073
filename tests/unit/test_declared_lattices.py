"""Declared lattices of many kinds against a program that shares nothing with the package (see lattice_referee)."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from lattice_referee import Referee
from lattices import GAINS
from scipy.optimize import linear_sum_assignment

from casadi_skin import Bond, Chain, Lattice, OdeModel, Site, find_equilibrium, follow_family
from casadi_skin.dynamics.evolve import evolve
from casadi_skin.lattice.linear import bands, lattice_modes

CUBIC, ONE = "y + g*y^3", ("1", "1")
A = [("a", CUBIC, "1")]
DIMER = [("a", CUBIC, "1"), ("b", CUBIC, "0.8")]
TRIMER = [("a", CUBIC, "1"), ("b", "1.1*y + g*y^3", "1"), ("c", "1.3*y", "1.5")]
KAGOME = [
    ("a", "b", (0, 0), "d", ONE), ("a", "c", (0, 0), "d", ONE), ("b", "c", (0, 0), "d", ONE),
    ("b", "a", (1, 0), "0.6*d", ONE), ("c", "a", (0, 1), "0.5*d", ONE), ("b", "c", (1, -1), "0.4*d", ONE),
]  # fmt: skip
HONEYCOMB = [("a", "b", (0, 0), "d", GAINS), ("b", "a", (1, 0), "d", ONE), ("b", "a", (0, 1), "0.8*d", ONE)]
ALL = {"g": -0.5, "gamma": 0.3, "u": 0.5}


def chain(force: str = "d", gain: tuple[str, str] = GAINS) -> list[Any]:
    """The bond to the next cell."""
    return [("a", "a", (1,), force, gain)]


# cells, sites, bonds, boundary, mode, S: of all kinds that the package solves
CASES: dict[str, tuple[Any, ...]] = {
    "chain": ((6,), A, chain(), "fixed", 1, 0.3),
    "a mode with nodes": ((7,), A, chain(), "fixed", 4, 0.2),
    "two lattices in one": (
        (3,), [("a", CUBIC, "1"), ("b", "2*y", "1")], [*chain("0.3*d"), ("b", "b", (1,), "0.2*d", ONE)], "fixed",
        2, 0.2,
    ),
    "dimer": ((3,), DIMER, [("a", "b", (0,), "u*d", GAINS), ("b", "a", (1,), "d", ONE)], "fixed", 6, 0.3),
    "square": ((2, 3), A, [("a", "a", (1, 0), "d", GAINS), ("a", "a", (0, 1), "d", ("0.9", "1.2"))], "fixed", 1, 0.1),
    "kagome": ((1, 2), TRIMER, KAGOME, ("periodic", "free"), 6, 0.2),
    "honeycomb": ((2, 2), DIMER, HONEYCOMB, "free", 1, 0.1),
    "disorder and masses": ((6,), [("a", "k*y + y^3", "1 + n/10")], chain("0.3*d"), "fixed", 3, 0.3),
    "FPUT alpha, free": ((5,), [("a", "0", "1")], chain("d + 0.5*d^2", ONE), "free", 3, 0.1),
    "FPUT alpha, ring": ((6,), [("a", "0", "1")], chain("d + 0.5*d^2", ONE), "periodic", 6, 0.1),
    "Toda, free and leaning": ((4,), [("a", "0", "1 + n/10")], chain("exp(d) - 1"), "free", 4, 0.1),
    "Morse": ((4,), [("a", "0", "1")], chain("(1 - exp(-d))*exp(-d)", ONE), "fixed", 2, 0.05),
    "sine-Gordon": ((5,), [("a", "sin(y)", "1")], chain("0.4*d"), "fixed", 1, 2.0),
    "only reversible": ((5,), [("a", "y", "1")], [*chain("d"), *chain("d^3", ONE)], "fixed", 1, 0.3),
    "no gauge": ((5,), [("a", "4*y + y^3", "1")], [*chain(), ("a", "a", (2,), "0.05*d", ("2", "1"))], "fixed", 5, 0.2),
}  # fmt: skip
QUICK = ("two lattices in one", "only reversible")


def both(name: str) -> tuple[Lattice, Referee, int, float]:
    """The lattice as the package and as the referee declare it, with a mode and an S."""
    cells, sites, bonds, boundary, mode, S = CASES[name]
    walls = (boundary,) * len(cells) if isinstance(boundary, str) else boundary
    parameters = ALL | {"k": np.random.default_rng(2).uniform(0.7, 1.3, cells).tolist()}
    ours = [Site(*site) for site in sites], [Bond(*bond) for bond in bonds]
    return Lattice(cells, *ours, walls, parameters), Referee(cells, sites, bonds, walls, parameters), mode, S


@pytest.mark.parametrize("name", [pytest.param(k, marks=() if k in QUICK else pytest.mark.slow) for k in CASES])
def test_declared_lattices_have_the_orbits_of_another_program(name: str) -> None:
    lattice, referee, mode, S = both(name)
    options = {"mode": mode, "amplitude_max": S, "at": (S,), "stability": True, "events": False, "tolerance": 1e-10}
    orbit = follow_family(lattice, **options).at(S=S)
    cosines, Omega = referee.orbit(mode, S)
    start = cosines.sum(axis=0)
    assert lattice_modes(lattice).squares == pytest.approx(referee.modes()[0], abs=1e-8)
    assert orbit.Omega == pytest.approx(Omega, rel=1e-9)
    assert np.ravel(orbit.evaluate(0.0))[: start.size] == pytest.approx(start, abs=1e-7)
    if lattice.hamiltonian is not None:
        assert orbit.energy == pytest.approx(referee.energy(start), rel=1e-9)
    values, condition = referee.multipliers(start, 2 * np.pi / Omega)
    distance = np.abs(values[:, None] - orbit.floquet().multipliers)
    rows, columns = linear_sum_assignment(distance)
    simple = (np.abs(values - 1) > 1e-3) & (condition < 1e4)  # those at 1 have the root of the error
    assert simple.sum() >= values.size - 2 * (1 + np.sum(np.abs(referee.modes()[0]) < 1e-10))
    assert np.max(np.where(simple[rows], distance[rows, columns], 0.0)) < 1e-6


def test_the_turning_point_of_phase_zero_does_not_depend_on_rounding() -> None:
    """Both ends of a mirrored mode are equally large: S is that of the first at its positive side."""
    lattice = Lattice(6, [Site("a")], [Bond("a", "a", (1,), "d + 0.5*d^2")], "free")
    referee = Referee((6,), [("a", "0", "1")], chain("d + 0.5*d^2", ONE), ("free",), {})
    orbit = follow_family(lattice, mode=6, amplitude_max=0.1, at=(0.1,), tolerance=1e-10).at(S=0.1)
    assert orbit.Omega == pytest.approx(referee.orbit(6, 0.1)[1], rel=1e-9)


@pytest.mark.parametrize(
    ("onsite", "force", "boundary", "message"),
    [
        ("n^2*y + y^3", "d^3", "fixed", "mode 3 of lattice has 3 times the frequency of mode 1"),
        ("n^2*y + y^2", "d^3", "fixed", "mode 2 of lattice has 2 times the frequency of mode 1"),
        ("sqrt(2)*(n - 1)*y + y^2", "d^3", "fixed", "omega.2 = 0 of lattice, whose mode is no free motion"),
    ],
)
def test_a_mode_whose_family_does_not_start_alone_is_refused(
    onsite: str, force: str, boundary: str, message: str
) -> None:
    lattice = Lattice(3, [Site("a", onsite)], [Bond("a", "a", (1,), force)], boundary)
    with pytest.raises(ValueError, match=message):
        follow_family(lattice, mode=2 if "free motion" in message else 1, amplitude_max=0.1)


def test_a_mode_beside_one_of_nine_times_its_frequency_has_its_family() -> None:
    """So high a harmonic is not among the unknowns at first, and later the frequency has moved off."""
    lattice = Lattice(2, [Site("a", "(8*n - 7)^2*y + y^3")], [Bond("a", "a", (1,), "d^3")])
    referee = Referee((2,), [("a", "(8*n - 7)^2*y + y^3", "1")], chain("d^3", ONE), ("fixed",), {})
    orbit = follow_family(lattice, mode=1, amplitude_max=0.2, at=(0.2,), tolerance=1e-10).at(S=0.2)
    assert orbit.Omega == pytest.approx(referee.orbit(1, 0.2)[1], rel=1e-9)


def test_bands_at_other_gains_are_those_of_the_lattice_declared_with_them() -> None:
    """The factor from cell to cell is that of the gains asked for; a ring's bands hold its frequencies."""

    def dimer(gamma: float, boundary: str = "fixed") -> Lattice:
        bonds = [Bond("a", "b", (0,), "0.5*d", GAINS), Bond("b", "a", (1,))]
        return Lattice(30, [Site("a", "y"), Site("b", "2*y")], bonds, boundary, {"gamma": gamma})

    found, there = bands(dimer(0.2), {"gamma": 0.5}), bands(dimer(0.5))
    assert found.beta == pytest.approx((np.sqrt(3.0),), rel=1e-12)
    assert found.squares == pytest.approx(there.squares, rel=1e-12)
    ring = bands(dimer(0.5, "periodic"), points=31, open_ends=False)  # of 30 cells, -pi and pi are the same
    by_bands = np.sort_complex(np.round(ring.squares[:-1].ravel(), 9))
    bonds = [("a", "b", (0,), "0.5*d", GAINS), ("b", "a", (1,), "d", ONE)]
    referee = Referee((30,), [("a", "y", "1"), ("b", "2*y", "1")], bonds, ("periodic",), {"gamma": 0.5})
    assert by_bands == pytest.approx(np.sort_complex(np.round(referee.modes()[0], 9)), abs=1e-6)


@pytest.mark.parametrize("onsite", ["sin(y)", pytest.param("y^3/6 - y", marks=pytest.mark.slow)])
def test_families_about_a_kink_are_those_of_another_program(onsite: str) -> None:
    """Written by hand for the referee: the force at the kink is taken from that at a displacement from it."""
    sites = np.arange(6)
    guess = 4 * np.arctan(np.exp(1.6 * (sites - 2.5))) if onsite == "sin(y)" else 2.4 * np.tanh(sites - 2.5)
    lattice = Lattice(6, [Site("a", onsite)], [Bond("a", "a", (1,), "k*d", GAINS)], "free", {"k": 0.3, "gamma": 0.02})
    kink = find_equilibrium(lattice, guess)
    assert kink.stable
    orbit = follow_family(kink.centred_model(), mode=2, amplitude_max=0.1, at=(0.1,), tolerance=1e-10).at(S=0.1)
    moved = onsite.replace("y", "(p + y)") + " - (" + onsite.replace("y", "p") + ")"
    values = {"k": 0.3, "gamma": 0.02, "p": kink.positions.tolist()}
    referee = Referee((6,), [("a", moved, "1")], chain("k*d"), ("free",), values)
    cosines, Omega = referee.orbit(2, 0.1)
    assert orbit.Omega == pytest.approx(Omega, rel=1e-10)
    assert orbit.energy == pytest.approx(referee.energy(cosines.sum(axis=0)), rel=1e-9)


def test_forces_about_a_rest_state_keep_their_digits_at_small_displacements() -> None:
    y, k = ca.SX.sym("y"), ca.SX.sym("k")
    model = OdeModel("well", y, ca.cos(y) - k, k, 2, ca.SX.sym("v"), reversal=(1, -1), nominal=(0.5,))
    about = find_equilibrium(model, [-1.0]).centred_model()
    force = ca.Function("f", [about.state], [about.rhs])
    for u in (1e-9, 1e-4, 0.049, 0.051, 1.0):
        exact = -2 * np.sin(u / 2) * np.sin(u / 2 - np.pi / 3)  # cos(u - pi/3) - cos(pi/3)
        assert float(force(u)) == pytest.approx(exact, rel=1e-14)
    with pytest.raises(ValueError, match="which is of first order; accepted: one of second order"):
        find_equilibrium(OdeModel("decay", y, -y), [0.0]).centred_model()


# The energy of a chain ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.3, -0.3])
def test_the_energy_of_an_orbit_of_a_chain_is_one_number(gamma: float) -> None:
    """Of its family, of the lattice that it is, followed in a parameter, evolved in time, and in a proof."""
    pytest.importorskip("flint")
    chain = Chain(6, 1.0, gamma, -1.0)
    orbit, lattice = (
        follow_family(model, 1, 0.5).at(S=0.2) for model in (chain, Lattice(6, *chain.cell, "fixed", chain.parameters))
    )
    found = [
        lattice.energy,
        orbit.follow("alpha", 1.05).orbits[0].energy,
        evolve(chain, orbit.profile, None, [0.0, 1.0]).energy[0],
        *orbit.certify().energy,
    ]
    np.testing.assert_allclose(found, orbit.energy, rtol=1e-9)
