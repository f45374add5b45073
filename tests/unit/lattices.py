"""Lattices that tests share."""

from __future__ import annotations

from casadi_skin import Bond, Lattice, Site

GAINS = ("1 - gamma", "1 + gamma")


def chain(sites: int, alpha: float, gamma: float, g: float) -> Lattice:
    """The paper's chain."""
    parameters = {"alpha": alpha, "gamma": gamma, "g": g}
    return Lattice(sites, [Site("a", "alpha*y + g*y^3")], [Bond("a", "a", (1,), gain=GAINS)], "fixed", parameters)


def fput(sites: int, boundary: str) -> Lattice:
    """Fermi, Pasta, Ulam and Tsingou's lattice."""
    return Lattice(sites, [Site("a")], [Bond("a", "a", (1,), "d + beta*d^3")], boundary, {"beta": 1.0})


def plane(cells: tuple[int, int] = (6, 5), boundary: str = "fixed") -> Lattice:
    """A square lattice that leans to a corner."""
    bonds = [Bond("a", "a", (1, 0), gain=GAINS), Bond("a", "a", (0, 1), gain=("1 - gamma/2", "1 + gamma/2"))]
    return Lattice(cells, [Site("a", "y + g*y^3")], bonds, boundary, {"gamma": 0.3, "g": -1.0})


def dimer(cells: int, boundary: str = "fixed") -> Lattice:
    """A dimer whose bonds inside of a cell are nonreciprocal."""
    bonds = [Bond("a", "b", (0,), "u*d", GAINS), Bond("b", "a", (1,), "w*d")]
    sites = [Site("a", "y + g*y^3"), Site("b", "y + g*y^3", mass="M")]
    return Lattice(cells, sites, bonds, boundary, {"u": 0.5, "w": 1.0, "gamma": 0.3, "g": 1.0, "M": 1.0})
