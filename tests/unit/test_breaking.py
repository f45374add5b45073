"""Orbits that leave a family of the chain where a real tongue opens or closes: Dormand-Prince closes them again."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from casadi_skin import Branch, Chain, Orbit, follow_family

CHAIN = Chain(sites=3, alpha=1.0, gamma=0.25, g=-1.0)


def flown(orbit: Orbit) -> np.ndarray:
    """The state after a period by the chain's equations, written out here."""
    coupling = np.diag([1.25, 1.25], -1) + np.diag([0.75, 0.75], 1) - 3.0 * np.eye(3)

    def field(_: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[3:], coupling @ x[:3] + x[:3] ** 3])

    start = orbit.evaluate(0.0)[0]
    return np.asarray(solve_ivp(field, (0.0, orbit.period), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1])


@pytest.mark.slow
def test_orbits_of_less_symmetry_leave_at_the_edges_of_a_real_tongue() -> None:
    family = follow_family(CHAIN, 1, 2.6, stability=True)
    points = family.special_points
    diagram = family.stability_diagram
    assert diagram is not None
    edges = [edge for edge in (*diagram.changes, *diagram.further) if edge.kind == "real"]
    real = [edge for edge in edges if edge.mu == 0.0]  # at mu = -1 the energy has an extremum
    assert sorted(point.parameters["S"] for point in points) == pytest.approx(sorted(edge.S for edge in real))
    opens, closes = points
    assert opens.lost == ("half-period symmetry", "reversal")
    assert closes.lost == ("half-period symmetry",)
    assert repr(closes).endswith("loses its half-period symmetry>")
    for point in points:
        S = point.parameters["S"]
        branch = point.follow("S", 1.1 * S, stability=True, max_points=6)
        assert isinstance(branch, Branch)
        assert branch.orbits[0].period == pytest.approx(family.at(S=S).period, rel=1e-8)
        last = branch.orbits[-1]
        y = last.evaluate(last.period * np.arange(16) / 16)[:, :3]
        assert flown(last) == pytest.approx(last.evaluate(0.0)[0], abs=1e-6)
        assert np.max(np.abs(y[8:] + y[:8])) > 1e-2  # no longer odd
        mirrored = np.max(np.abs(y[1:] - y[:0:-1]))
        assert (mirrored > 1e-2) == (point is opens)
        if point is opens:  # but odd about its quarter: y(T/2 - t) = -y(t)
            assert np.min([np.max(np.abs(np.roll(y[::-1], k, axis=0) + y)) for k in range(16)]) < 0.2 * mirrored
        assert np.sum(y[0] ** 2) == pytest.approx(last["S"], rel=1e-8)
        known = np.sort(np.abs(last.floquet("cvodes").others))
        assert np.sort(np.abs(last.floquet().others)) == pytest.approx(known, rel=1e-4, abs=1e-4)


@pytest.mark.slow
def test_an_extremum_of_the_energy_is_no_branch_point() -> None:
    """On the first family of 24 sites real instability begins there, at mu = -1, and no other branch leaves."""
    chain = Chain(sites=24, alpha=1.0, gamma=0.25, g=-1.0)
    family = follow_family(chain, 1, 0.5, stability=True)
    assert [edge.mu for edge in family.changes if edge.kind == "real"] == [-1.0]
    assert family.special_points == ()
