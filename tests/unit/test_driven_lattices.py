"""Damped and driven lattices: equations, periods, and the way to the conservative family as both become weak."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from casadi_skin import Bond, Lattice, Site, find_orbit, follow_family

SITES = 4


def driven(c: float, force: float, omega: float, phase: float, sites: int = SITES) -> Lattice:
    """A hardening chain with weak damping at every site and a drive at the first."""
    site = Site("a", "y + y^3", damping="c", drive="-F*e*sin(omega*t + phase)")
    first = [1.0, *[0.0] * (sites - 1)]
    parameters = {"c": c, "F": force, "omega": omega, "phase": phase, "e": first}
    return Lattice(sites, [site], [Bond("a", "a", (1,))], "fixed", parameters)


def test_equations_of_a_damped_and_driven_lattice() -> None:
    lattice = driven(0.3, 2.0, 1.7, 0.4)
    assert lattice.forced
    assert lattice.forcing_period_at(lattice.nominal) == pytest.approx(2 * np.pi / 1.7, rel=1e-15)
    assert lattice.hamiltonian is lattice.reversal is None
    assert dict(lattice.structure.lines())["flow"] == "damped and driven"
    y, v, t = np.array([0.1, -0.2, 0.3, 0.5]), np.array([0.7, 0.1, -0.4, 0.2]), 0.9
    padded = np.array([0.0, *y, 0.0])
    drive = np.array([-2.0 * np.sin(1.7 * t + 0.4), 0.0, 0.0, 0.0])
    expected = np.diff(padded, 2) - y - y**3 - 0.3 * v + drive
    found = np.array(lattice.vector_field(t, np.concatenate([y, v]), lattice.nominal)).ravel()
    assert found == pytest.approx(np.concatenate([v, expected]), rel=1e-14)


def test_damping_alone_has_no_period() -> None:
    lattice = Lattice(3, [Site("a", "y", damping="-0.1*(1 - y^2)")], [Bond("a", "a", (1,))])
    assert not lattice.forced
    assert lattice.order == 1
    field = np.array(lattice.vector_field(0, [1, 2, 3, 4, 5, 6], [])).ravel()
    assert field[3] == pytest.approx(2 - 2 - 1 + 0.1 * (1 - 1) * 4)
    assert field[4] == pytest.approx(1 - 4 + 3 - 2 + 0.1 * (1 - 4) * 5)


def test_forcing_period_of_ones_own() -> None:
    site = Site("a", "y", damping="0.1", drive="cos(w*t) + cos(2*w*t)")
    lattice = Lattice(2, [site], parameters={"w": 2.0}, forcing_period="2*pi/w")
    assert lattice.forcing_period_at([2.0]) == pytest.approx(np.pi)


@pytest.mark.slow
def test_weak_damping_and_drive_approach_the_conservative_family() -> None:
    conservative = Lattice(SITES, [Site("a", "y + y^3")], [Bond("a", "a", (1,))])
    orbit = follow_family(conservative, mode=1, amplitude_max=1.0, at=(1.0,), tolerance=1e-11).at(S=1.0)
    times = np.linspace(0.0, orbit.period, 256, endpoint=False)
    series = np.fft.rfft(orbit.evaluate(times), axis=0) / 128
    harmonics = 1j * orbit.Omega * np.arange(64)

    def state(t: float) -> np.ndarray:
        waves = np.exp(harmonics * t)[:, None] * series[:64]
        return np.concatenate([waves.real.sum(axis=0), (harmonics[:, None] * waves).real.sum(axis=0)])

    v = np.array([state(t) for t in times])[:, SITES:]
    least = np.sum(v**2) / np.sum(-np.sin(orbit.Omega * times) * v[:, 0])  # of F/c that keeps the energy
    phase, deviations = -float(np.arccos(1 / 1.5)), []
    for c in (2e-3, 1e-3):
        lattice = driven(c, 1.5 * least * c, orbit.Omega, phase)
        response = find_orbit(lattice, state, tolerance=1e-9)
        deviations.append(np.max(np.abs(np.asarray(response.evaluate(0.0)).ravel() - state(0.0))))
    assert deviations[1] < 0.01
    assert deviations[0] / deviations[1] == pytest.approx(2.0, rel=0.1)


def test_the_linear_response_is_that_of_the_transfer_function() -> None:
    lattice = Lattice(
        3, [Site("a", "y", damping="c", drive="F*e*cos(omega*t)")], [Bond("a", "a", (1,), gain=("0.8", "1.2"))],
        "fixed", {"c": 0.2, "F": 1.0, "omega": 1.3, "e": [1.0, 0.0, 0.0]},
    )  # fmt: skip
    response = find_orbit(lattice, np.zeros(6), tolerance=1e-10)
    K = np.array([[3.0, -0.8, 0.0], [-1.2, 3.0, -0.8], [0.0, -1.2, 3.0]])
    amplitudes = np.linalg.solve(K - 1.3**2 * np.eye(3) + 1j * 1.3 * 0.2 * np.eye(3), [1.0, 0.0, 0.0])
    assert np.asarray(response.evaluate(0.0)).ravel()[:3] == pytest.approx(amplitudes.real, rel=1e-8)
    assert ca.jacobian(lattice.rhs, lattice.state).shape == (6, 6)
