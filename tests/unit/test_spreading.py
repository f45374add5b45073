"""Where the energy of a lattice is: sums by hand, closed forms of rings, starts, escapes."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from lattices import GAINS, chain, dimer, plane
from marks import slow

from casadi_skin import Bond, Chain, EvolutionError, Lattice, OdeModel, Site, evolve
from casadi_skin.dynamics.starts import energies_by_site, initial_state, spreading
from casadi_skin.lattice.linear import lattice_modes


def test_energies_of_sites_are_those_written_by_hand() -> None:
    lattice, generator = dimer(3), np.random.default_rng(0)
    y, v = generator.normal(size=(2, 6))
    u, w, gamma, g = 0.5, 1.0, 0.3, 1.0
    c = np.repeat((0.7 / 1.3) ** np.arange(3), 2)  # c_b (1 + gamma) = c_a (1 - gamma) inside of a cell, equal between
    c[1::2] *= 0.7 / 1.3
    c /= c.min()
    expected = c * (v**2 / 2 + y**2 / 2 + g * y**4 / 4)
    for i in range(0, 6, 2):
        inside = c[i] * (1 - gamma) * u * (y[i + 1] - y[i]) ** 2 / 2
        expected[[i, i + 1]] += inside / 2
    for i in (1, 3):
        expected[[i, i + 1]] += c[i] * w * (y[i + 1] - y[i]) ** 2 / 4
    expected[0] += c[0] * w * y[0] ** 2 / 2
    expected[5] += c[5] * w * y[5] ** 2 / 2
    found = energies_by_site(lattice, np.concatenate([y, v]))[0]
    assert found == pytest.approx(expected, rel=1e-13)
    energy = lattice.function("H", lattice.hamiltonian)(0.0, np.concatenate([y, v]), lattice.nominal)
    assert found.sum() == pytest.approx(float(energy), rel=1e-13)


def test_a_wave_on_a_ring_moves_its_centre_at_the_group_velocity() -> None:
    n, k, width = 120, 1.2, 8.0
    ring = Lattice(n, [Site("a", "y")], [Bond("a", "a", (1,))], "periodic")
    cells = np.arange(n)
    packet = np.exp(-((cells - 60.0) ** 2) / (2 * width**2) + 1j * k * (cells - 60.0))
    omega = np.sqrt(1 + 4 * np.sin(k / 2) ** 2)
    waves = np.fft.fftfreq(n) * 2 * np.pi
    rates = np.sqrt(1 + 4 * np.sin(waves / 2) ** 2)
    velocity = np.fft.ifft(-1j * rates * np.fft.fft(packet)).real
    found = spreading(evolve(ring, packet.real, velocity, np.linspace(0.0, 80.0, 41)))
    assert found.centre[0, 0] == pytest.approx(61.0, abs=0.01)
    moved = np.unwrap(found.centre[:, 0] * 2 * np.pi / n) * n / (2 * np.pi)
    assert np.polyfit(found.t, moved, 1)[0] == pytest.approx(np.sin(k) / omega, rel=0.02)
    assert found.participation[0] == pytest.approx(2 * np.sqrt(np.pi) * width / np.sqrt(2), rel=0.1)  # less: waves
    assert found.second_moment[0] == pytest.approx(width**2 / 2, rel=0.02)
    assert found.second_moment[-1] > found.second_moment[0]
    assert found.total == pytest.approx(found.total[0], rel=1e-8)


def test_without_a_gauge_energies_have_weights_one_and_mean_gains() -> None:
    ring = Lattice(4, [Site("a", "y", damping="0.1")], [Bond("a", "a", (1,), gain=GAINS)], "periodic", {"gamma": 0.2})
    y, v = np.array([0.1, 0.3, -0.2, 0.5]), np.array([0.2, -0.1, 0.0, 0.4])
    bonds = (np.roll(y, -1) - y) ** 2 / 2
    expected = v**2 / 2 + y**2 / 2 + (bonds + np.roll(bonds, 1)) / 2
    assert energies_by_site(ring, np.concatenate([y, v]))[0] == pytest.approx(expected, rel=1e-14)


def test_a_chain_is_measured_as_the_lattice_that_it_is() -> None:
    start = initial_state(Chain(8, 1.0, 0.25, -1.0), 0.3, site=2, moving=True)
    times = np.linspace(0.0, 5.0, 11)
    one, other = (
        spreading(evolve(model, *start, times)) for model in (Chain(8, 1.0, 0.25, -1.0), chain(8, 1, 0.25, -1))
    )
    np.testing.assert_allclose(one.energies, other.energies, rtol=1e-7, atol=1e-9 * np.max(other.energies))


def test_starts_of_every_kind() -> None:
    lattice = plane((3, 3))
    y, v = initial_state(lattice, 0.5, mode=2)
    assert not v.any()
    assert np.abs(y) == pytest.approx(0.5 * np.abs(lattice_modes(lattice).right[:, 1].real))
    assert initial_state(lattice, 0.5, site=4, moving=True)[1].tolist() == [0, 0, 0, 0.5, 0, 0, 0, 0, 0]
    noise, _ = initial_state(lattice, 0.5, seed=1)
    assert np.linalg.norm(noise) == pytest.approx(0.5)
    assert np.array_equal(noise, initial_state(lattice, 0.5, seed=1)[0])
    for wrong, message in (
        ({}, "start: given none; accepted: one of mode, site, vector, seed"),
        ({"mode": 1, "site": 1}, "start: given mode and site"),
        ({"site": 10}, r"site: given 10; accepted: 1\.\.9"),
        ({"vector": np.zeros(9)}, "vector: given zeros"),
    ):
        with pytest.raises(ValueError, match=message):
            initial_state(lattice, 0.5, **wrong)  # type: ignore[arg-type]
    both = initial_state(lattice, 0.5, vector=[3.0] + [0.0] * 16 + [4.0])
    assert (both[0][0], both[1][8]) == pytest.approx((0.3, 0.4))
    leaning = Lattice(5, [Site("a", "y")], [Bond("a", "a", (1,), gain=GAINS)], "periodic", {"gamma": 0.3})
    with pytest.raises(ValueError, match="accepted: one with a real frequency"):
        initial_state(leaning, 0.5, mode=2)


def test_starts_of_damped_lattices_and_of_any_model() -> None:
    """One number a component where the model is of first order; modes without damping; pendula by their own modes."""
    bond = Bond("a", "a", (1,), "0.2*d")
    damped = Lattice(4, [Site("a", "sin(y)", damping="0.1")], [bond])
    state, none = initial_state(damped, 0.3, mode=1)
    assert none is None
    free, rest = initial_state(Lattice(4, [Site("a", "sin(y)")], [bond]), 0.3, mode=1)
    assert state == pytest.approx(np.concatenate([free, rest]))
    kicked, _ = initial_state(damped, 0.3, site=2, moving=True)
    assert kicked.tolist() == [0, 0, 0, 0, 0, 0.3, 0, 0]
    ended = evolve(damped, kicked, None, np.linspace(0.0, 200.0, 11)).states[-1]
    assert np.max(np.abs(ended)) < 0.3 * np.exp(-0.05 * 200.0)
    x = ca.SX.sym("x")
    decay = OdeModel("decay", x, -x)
    assert initial_state(decay, 2.0, site=1)[0].tolist() == [2.0]
    with pytest.raises(ValueError, match="moving: given with decay, of first order"):
        initial_state(decay, 2.0, site=1, moving=True)


@pytest.mark.parametrize("method", [slow("cvodes"), "dop853", slow("symplectic")])
def test_a_site_that_escapes_is_named(method: str) -> None:
    lattice = plane((3, 2))
    with pytest.raises(EvolutionError, match=r"followed to t = .* of 20: .*; y_2_1 runs to infinity$"):
        evolve(lattice, *initial_state(lattice, 4.0, site=3), np.linspace(0.0, 20.0, 201), method)
