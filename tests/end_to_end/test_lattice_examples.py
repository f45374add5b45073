"""The example scenes of lattices against an independent harmonic balance, and what their pages say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import fsolve

from casadi_skin import Lattice, find_orbit, follow_family
from casadi_skin.lattice.linear import bands, lattice_modes
from casadi_skin.runs.binding import lattice_of
from casadi_skin.runs.reading import read_scene

EXAMPLES = Path(__file__).parents[2] / "examples"
Forces = Callable[[np.ndarray], np.ndarray]


def example(name: str) -> Lattice:
    """The lattice of an example."""
    table = read_scene(EXAMPLES / f"{name}.toml").lattice
    assert table is not None
    return lattice_of(table)


def harmonic_balance(force: Forces, mode: np.ndarray, omega: float, S: float, harmonics: int = 8) -> float:
    """Omega of the orbit of y'' = f(y) at S near a mode: odd cosines, Galerkin's projection by sums over a period."""
    orders = 2 * np.arange(harmonics) + 1
    theta = 2.0 * np.pi * np.arange(8 * harmonics) / (8 * harmonics)
    cosines = np.cos(np.outer(theta, orders))

    def residual(z: np.ndarray) -> np.ndarray:
        a, Omega = z[:-1].reshape(harmonics, -1), z[-1]
        forces = np.array([force(y) for y in cosines @ a])
        balance = -((Omega * orders) ** 2)[:, None] * a - 2.0 / theta.size * cosines.T @ forces
        return np.append(balance.ravel(), np.sum(a.sum(axis=0) ** 2) - S)

    start = np.zeros((harmonics, mode.size))
    start[0] = mode * np.sqrt(S)
    z, _, status, words = fsolve(residual, np.append(start.ravel(), omega), xtol=1e-13, full_output=True)
    assert status == 1 or np.max(np.abs(residual(z))) < 1e-11, words
    return float(z[-1])


def dimer(y: np.ndarray) -> np.ndarray:
    """Forces of nonreciprocal_dimer.toml, written by hand."""
    u, w, gamma = 0.4, 1.0, 0.4
    inside = u * (y[1::2] - y[0::2])
    between = w * np.diff(np.concatenate([[0.0], y, [0.0]]))[0::2]
    force = -y - y**3
    force[0::2] += (1 - gamma) * inside - between[:-1]
    force[1::2] += -(1 + gamma) * inside + between[1:]
    return force


def corner(y: np.ndarray) -> np.ndarray:
    """Forces of corner_breather.toml, written by hand."""
    grid, gamma = y.reshape(6, 5), 0.5
    padded = np.pad(grid, 1)
    neighbours = (1 + gamma) * (padded[:-2, 1:-1] + padded[1:-1, :-2])
    neighbours += (1 - gamma) * (padded[2:, 1:-1] + padded[1:-1, 2:])
    return np.asarray((neighbours - 5 * grid + grid**3).ravel())


def insensitive(y: np.ndarray) -> np.ndarray:
    """Forces of insensitive_breather.toml, written by hand."""
    inside, between = 0.8 * (y[1::2] - y[0::2]), np.diff(np.concatenate([[0.0], y, [0.0]]))[0::2]
    force = -y - y**3
    force[0::2] += 0.5 * inside - between[:-1]
    force[1::2] += -1.5 * inside + between[1:]
    return force


def sine_gordon(y: np.ndarray) -> np.ndarray:
    """Forces of sine_gordon_breather.toml, written by hand."""
    bonds = 0.5 * np.diff(np.concatenate([[0.0], y, [0.0]]))
    return np.asarray(-np.sin(y) + 0.7 * bonds[1:] - 1.3 * bonds[:-1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "force", "mode", "S"),
    [
        ("nonreciprocal_dimer", dimer, 13, 0.2),
        ("insensitive_breather", insensitive, 20, 0.5),
        ("sine_gordon_breather", sine_gordon, 1, 4.0),
        ("nonreciprocal_dimer", dimer, 12, 1.0),
        ("corner_breather", corner, 1, 1.0),
    ],
)
def test_examples_agree_with_harmonic_balance(name: str, force: Forces, mode: int, S: float) -> None:
    lattice = example(name)
    orbit = follow_family(lattice, mode=mode, amplitude_max=S, at=(S,), tolerance=1e-11).at(S=S)
    modes = lattice_modes(lattice)
    omega = modes.frequencies.real[mode - 1]
    start = modes.right[:, mode - 1].real if S < 0.5 else orbit.profile / np.linalg.norm(orbit.profile)
    assert harmonic_balance(force, start, omega, S) == pytest.approx(orbit.Omega, rel=1e-9)


@pytest.mark.slow
def test_the_frequency_of_the_insensitive_breather_moves_less_the_longer_the_lattice_is() -> None:
    """By (u (1 + gamma) / w)^2 = 1.44 a cell in first order, (3 g / 8 omega) sum of L R^3 / sum of L R."""
    shifts = {}
    declared = example("insensitive_breather").declaration
    for cells in (12, 20):
        lattice = Lattice(cells, declared.sites, declared.bonds, "fixed", declared.parameters)
        shifts[cells] = follow_family(lattice, cells, 1e-3, at=(1e-3,), tolerance=1e-9).at(S=1e-3).Omega_shift
        modes = lattice_modes(lattice)
        R, L = modes.right[:, cells - 1].real, modes.left[:, cells - 1].real
        first = 3 / 8 * 1e-3 * np.sum(L * R**3) / (modes.frequencies.real[cells - 1] * (L @ R))
        assert shifts[cells] == pytest.approx(first, rel=0.01)
    assert shifts[12] / shifts[20] == pytest.approx(1.44**8, rel=0.05)


def test_the_edge_modes_of_the_dimer_lie_in_its_gap_one_at_each_end() -> None:
    lattice = example("nonreciprocal_dimer")
    modes = lattice_modes(lattice)
    assert np.all(modes.participation[[11, 12]] < 2.0)
    assert modes.centre[11, 0] < 2.0
    assert modes.centre[12, 0] > 11.0
    low, high = bands(lattice).gaps[0]
    assert low < modes.squares.real[11] < modes.squares.real[12] < high


def test_the_modes_of_the_disordered_chain_are_localised() -> None:
    lattice = example("disordered_chain")
    modes = lattice_modes(lattice)
    e = np.random.default_rng(3).uniform(-0.5, 0.5, (32,))
    K = np.diag(1.6 + e) - 0.3 * (np.eye(32, k=1) + np.eye(32, k=-1))
    assert modes.squares.real == pytest.approx(np.linalg.eigvalsh(K), rel=1e-13)
    assert np.median(modes.participation) < 8.0


@pytest.mark.slow
def test_the_resonance_curve_of_the_driven_chain_has_a_fold_where_its_stability_is_lost() -> None:
    lattice = example("driven_chain")
    branch = find_orbit(lattice, np.zeros(12), tolerance=1e-8).follow("omega", 1.3, stability=True)
    folds = [point for point in branch.special_points if point.kind == "fold"]
    assert folds[0].parameters["omega"] == pytest.approx(1.17510394551, abs=1e-9)
    assert branch.changes[0].value == pytest.approx(folds[0].parameters["omega"], abs=1e-8)
