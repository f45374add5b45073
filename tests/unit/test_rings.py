"""Rings: lattices whose momentum is conserved, and whose symmetries repeat multipliers on the whole family."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from casadi_skin import Bond, Lattice, OdeModel, Site, follow_family
from casadi_skin.results.figures.multipliers import multiplier_figure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Force:
    """The force of a bond as a formula, as a function, and its derivative."""

    formula: str
    value: Callable[[Array], Array]
    slope: Callable[[Array], Array]


ALPHA = Force("d + 0.25*d^2 + 0.5*d^3", lambda d: d + 0.25 * d**2 + 0.5 * d**3, lambda d: 1 + 0.5 * d + 1.5 * d**2)
LENNARD_JONES = Force(
    "12*(1/(1 + d)^7 - 1/(1 + d)^13)",
    lambda d: 12 * ((1 + d) ** -7 - (1 + d) ** -13),
    lambda d: 12 * (13 * (1 + d) ** -14 - 7 * (1 + d) ** -8),
)


def ring(sites: int, formula: str) -> Lattice:
    return Lattice(sites, [Site("a")], [Bond("a", "a", (1,), formula)], "periodic")


def largest_multiplier(sites: int, force: Force, S: float) -> float:
    """Of perturbations of the pi mode at right angles to it and to the centre of mass, by DOP853.

    All sites move as y_n = (-1)^n a with a'' = F(-2 a) - F(2 a), and bonds are longer and shorter in turn.
    """
    lengths = -2.0 * (-1.0) ** np.arange(sites)
    incidence = np.roll(np.eye(sites), 1, axis=1) - np.eye(sites)
    directions = np.column_stack([np.ones(sites), lengths, np.random.default_rng(0).normal(size=(sites, sites - 2))])
    across = np.linalg.qr(directions)[0][:, 2:]
    stretched, size = incidence @ across, sites - 2

    def pull(a: float) -> float:
        return float(force.value(np.array(-2 * a)) - force.value(np.array(2 * a)))

    def rates(_: float, z: Array) -> Array:
        x = z[2:].reshape(2 * size, 2 * size)
        pulled = stretched.T @ (force.slope(lengths * z[0])[:, None] * (stretched @ x[:size]))
        return np.concatenate([[z[1], pull(z[0])], np.vstack([x[size:], -pulled]).ravel()])

    def at_rest(_: float, z: Array) -> float:
        return float(z[1])

    at_rest.direction, at_rest.terminal = 1.0, True  # type: ignore[attr-defined]
    accuracy = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14}
    start = np.sqrt(S / sites)
    found = solve_ivp(lambda _, z: [z[1], pull(z[0])], (0, 50), [start, -1e-300], events=at_rest, **accuracy)
    initial = np.concatenate([[start, 0.0], np.eye(2 * size).ravel()])
    end = solve_ivp(rates, (0, 2 * found.t_events[0][0]), initial, **accuracy).y[2:, -1]
    return float(np.max(np.abs(np.linalg.eigvals(end.reshape(2 * size, 2 * size)))))


@pytest.mark.parametrize(
    ("sites", "force", "S_max"),
    [(6, ALPHA, 1.0), (8, ALPHA, 0.8), pytest.param(16, ALPHA, 0.4, marks=pytest.mark.slow), (4, LENNARD_JONES, 0.02)],
    ids=["alpha_6", "alpha_8", "alpha_16", "lennard_jones_4"],
)
def test_pi_mode_of_a_ring_loses_stability_where_an_independent_scan_does(
    sites: int, force: Force, S_max: float
) -> None:
    branch = follow_family(ring(sites, force.formula), mode="last", amplitude_max=S_max, stability=True)
    (change,) = branch.changes
    assert change.stable_before
    assert not change.stable_after
    assert change.error <= 1e-8 * change.S
    assert largest_multiplier(sites, force, change.S * (1 - 1e-4)) < 1 + 1e-7
    assert largest_multiplier(sites, force, change.S * (1 + 1e-4)) > 1 + 1e-4
    assert branch.unresolved == ()
    assert all(orbit.stable == (change.S > orbit.S) for orbit in branch.solutions)


def test_ring_of_two_kinds_of_sites_changes_where_a_monodromy_matrix_does() -> None:
    """Acoustic and optical edges of the bands are modes of their own; the monodromy matrix is that of all positions."""
    sites = [Site("a"), Site("b", mass="2.5")]
    bonds = [Bond("a", "b", (0,), ALPHA.formula), Bond("b", "a", (1,), ALPHA.formula)]
    lattice = Lattice(4, sites, bonds, "periodic")
    branch = follow_family(lattice, mode="last", amplitude_max=1.0, stability=True)
    (change,) = branch.changes
    assert branch.unresolved == ()
    y, n = lattice.state, lattice.size
    slope = ca.Function("slope", [y], [lattice.rhs, ca.densify(ca.jacobian(lattice.rhs, y))])

    def largest(S: float) -> float:
        orbit = branch.at(S=S)

        def rates(_: float, z: Array) -> Array:
            force, J = (np.array(v) for v in slope(z[:n]))
            x = z[2 * n :].reshape(2 * n, 2 * n)
            return np.concatenate([z[n : 2 * n], force.ravel(), np.vstack([x[n:], J @ x[:n]]).ravel()])

        start = np.concatenate([orbit.evaluate(0.0).ravel()[:n], np.zeros(n), np.eye(2 * n).ravel()])
        end = solve_ivp(rates, (0, orbit.period), start, method="DOP853", rtol=1e-11, atol=1e-12).y[2 * n :, -1]
        return float(np.max(np.abs(np.linalg.eigvals(end.reshape(2 * n, 2 * n)))))

    assert largest(change.S - 1e-3) < 1 + 1e-5 < 1 + 1e-3 < largest(change.S + 1e-3)


def test_momentum_has_its_pair_of_multipliers_and_vectors() -> None:
    orbit = follow_family(ring(6, ALPHA.formula), mode="last", amplitude_max=0.5).at(S=0.5)
    floquet = orbit.floquet()
    assert floquet.trivial == 4
    assert np.all(floquet.multipliers[:4] == 1.0)
    assert floquet.multipliers.size == 12
    assert np.min(np.abs(floquet.others - 1.0)) > 1e-3
    vectors = orbit.floquet_vectors()
    np.testing.assert_allclose(np.abs(vectors[:, 2]), np.repeat([1.0, 0.0], 6), atol=1e-12)
    np.testing.assert_allclose(np.abs(vectors[:, 3]), np.repeat([0.0, 1.0], 6), atol=1e-12)
    assert np.linalg.matrix_rank(vectors) == 12
    np.testing.assert_allclose(np.sum(vectors[:6, 4:], axis=0), 0.0, atol=1e-9)


def test_momenta_of_several_free_parts_are_found_without_a_declaration() -> None:
    """Two molecules of two atoms that nothing joins: each has a momentum."""
    y = ca.SX.sym("y", 4)
    v = ca.SX.sym("v", 4)
    one, other = y[1] - y[0], 1.7 * (y[3] - y[2])
    pull = ca.vertcat(one + one**3, -one - one**3, other + other**3, -other - other**3)
    model = OdeModel("molecules", y, pull, order=2, velocity=v, reversal=(1,) * 4 + (-1,) * 4, half_period=(-1,) * 8)
    orbit = follow_family(model, mode="last", amplitude_max=0.3, stability=True).solutions[-1]
    assert orbit.floquet().trivial == 6
    assert orbit.floquet().multipliers.size == 8
    assert orbit.stable


def test_a_family_that_is_unstable_from_rest_on_has_no_change_there() -> None:
    """Free ends, six sites: omega_1 + omega_3 = omega_6 exactly, and quadratic forces couple the three."""
    lattice = Lattice(6, [Site("a")], [Bond("a", "a", (1,), ALPHA.formula)], "free")
    omega = 2 * np.sin(np.pi * np.arange(6) / 12)
    assert omega[1] + omega[3] == pytest.approx(omega[5], rel=1e-14)
    branch = follow_family(lattice, mode="last", amplitude_max=0.2, stability=True)
    (change,) = branch.changes
    assert (change.stable_before, change.stable_after) == (False, True)
    (tongue,) = branch.stability_diagram.tongues
    assert tongue.open_start
    inside = branch.S > 1e-6  # below, multipliers are nearer to the circle than their errors
    assert np.array_equal(branch.stable[inside], branch.S[inside] > change.S)
    assert branch.unresolved == ()


def test_a_picture_of_a_ring_tells_how_many_multipliers_are_trivial() -> None:
    branch = follow_family(ring(4, "d + d^3"), 4, 0.1, stability=True, tolerance=1e-4)
    figure = multiplier_figure(branch)
    assert any("(4 trivial ones left out)" in axes.get_ylabel() for axes in figure.axes)
