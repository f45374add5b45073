"""Multipliers of lattices against variational equations written by hand in physical coordinates, by Dormand-Prince."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from lattices import GAINS
from variational import integrated

from casadi_skin import Bond, Lattice, Site, follow_family

Forces = Callable[[np.ndarray], np.ndarray]


def bonds(y: np.ndarray) -> np.ndarray:
    """Extensions of the bonds of a chain between walls."""
    return np.diff(np.concatenate([[0.0], y, [0.0]]))


def dimer(y: np.ndarray) -> np.ndarray:
    inside, between = 0.5 * (y[1::2] - y[0::2]), bonds(y)[0::2]
    force = -y - y**3
    force[0::2] += 0.7 * inside - between[:-1]
    force[1::2] += -1.3 * inside + between[1:]
    return force / np.where(np.arange(y.size) % 2, 0.8, 1.0)


def reversible(y: np.ndarray) -> np.ndarray:
    d = bonds(y)
    return 0.8 * d[1:] - 1.2 * d[:-1] + d[1:] ** 3 - d[:-1] ** 3 - y


def sine_gordon(y: np.ndarray) -> np.ndarray:
    d = 0.5 * bonds(y)
    return -np.sin(y) + 0.7 * d[1:] - 1.3 * d[:-1]


def cubic(y: np.ndarray) -> np.ndarray:
    d = bonds(y)
    return -np.array([1.0, 1.3, 1.7, 2.2]) * y + 0.7 * d[1:] ** 3 - 1.3 * d[:-1] ** 3


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of two sets of multipliers, each matched with the nearest of the other."""
    distance = np.abs(a[:, None] - b)
    return float(max(distance.min(axis=0).max(), distance.min(axis=1).max()))


DIMER = Lattice(
    4, [Site("a", "y + y^3"), Site("b", "y + y^3", mass="0.8")],
    [Bond("a", "b", (0,), "0.5*d", GAINS), Bond("b", "a", (1,))], "fixed", {"gamma": 0.3},
)  # fmt: skip
REVERSIBLE = Lattice(6, [Site("a", "y")], [Bond("a", "a", (1,), "d", ("0.8", "1.2")), Bond("a", "a", (1,), "d^3")])
SINE_GORDON = Lattice(6, [Site("a", "sin(y)")], [Bond("a", "a", (1,), "0.5*d", GAINS)], "fixed", {"gamma": 0.3})
CUBIC = Lattice(
    4, [Site("a", "k*y")], [Bond("a", "a", (1,), "d^3", GAINS)], "fixed", {"gamma": 0.3, "k": [1.0, 1.3, 1.7, 2.2]}
)


@pytest.mark.parametrize(
    ("lattice", "force", "mode", "S", "symplectic"),
    [
        pytest.param(DIMER, dimer, 2, 1.5, True, marks=pytest.mark.slow),
        pytest.param(REVERSIBLE, reversible, 1, 0.6, False, marks=pytest.mark.slow),
        pytest.param(SINE_GORDON, sine_gordon, 1, 5.0, True, marks=pytest.mark.slow),
        (CUBIC, cubic, 2, 0.5, True),
    ],
)
def test_multipliers_are_those_of_the_variational_equations(
    lattice: Lattice, force: Forces, mode: int, S: float, symplectic: bool
) -> None:
    branch = follow_family(lattice, mode=mode, amplitude_max=S, at=(S,), tolerance=1e-10)
    orbit, n = branch.at(S=S), lattice.size
    coordinates: Any = branch.space.coordinates
    assert coordinates.symplectic is symplectic

    (end,), (matrix,) = integrated(force, orbit.profile, [orbit.period], 1e-11, 1e-13)
    assert end == pytest.approx(np.append(orbit.profile, np.zeros(n)), abs=1e-8)
    known = np.linalg.eigvals(matrix)
    trivial = np.argsort(np.abs(known - 1.0))[:2]  # a double one: computed to half the digits
    found = orbit.floquet().multipliers
    others = np.delete(found, np.argsort(np.abs(found - 1.0))[:2])
    assert apart(np.delete(known, trivial), others) < 1e-7
    assert np.min(np.abs(found - 1.0)) < 1e-9
