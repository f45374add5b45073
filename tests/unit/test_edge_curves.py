"""Edges of tongues in a parameter: folds, and edges that coincide, against shooting by scipy alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, newton, root

from casadi_skin import Bond, Chain, Lattice, Site, follow_family


class Shooting:
    """Orbits at rest at phase zero and odd about a quarter of the period, and multipliers, by Dormand-Prince alone."""

    def __init__(self, sites: int, alpha: float, gamma: float, g: float, positions: np.ndarray, period: float) -> None:
        n = sites
        self.n, self.g = n, g
        self.K = np.diag([1.0 + gamma] * (n - 1), -1) + np.diag([1.0 - gamma] * (n - 1), 1) - (2.0 + alpha) * np.eye(n)
        self.guess = np.append(positions, period)

    def flown(self, start: np.ndarray, time: float, with_matrix: bool) -> np.ndarray:
        n = self.n

        def field(_: float, x: np.ndarray) -> np.ndarray:
            rate = np.concatenate([x[n : 2 * n], self.K @ x[:n] - self.g * x[:n] ** 3])
            if not with_matrix:
                return rate
            X = x[2 * n :].reshape(2 * n, 2 * n)
            force = self.K - np.diag(3.0 * self.g * x[:n] ** 2)
            return np.concatenate([rate, np.vstack([X[n:], force @ X[:n]]).ravel()])

        matrix = np.eye(2 * n).ravel() if with_matrix else np.zeros(0)
        x = np.concatenate([start, np.zeros(n), matrix])
        return np.asarray(solve_ivp(field, (0.0, time), x, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1])

    def multipliers(self, S: float) -> np.ndarray:
        def off(u: np.ndarray) -> np.ndarray:
            end = self.flown(u[:-1], u[-1] / 4.0, False)[: self.n]
            return np.append(end, np.sum(u[:-1] ** 2) - S)

        self.guess = root(off, self.guess, tol=1e-13).x
        matrix = self.flown(self.guess[:-1], self.guess[-1], True)[2 * self.n :]
        return np.asarray(np.linalg.eigvals(matrix.reshape(2 * self.n, 2 * self.n)))


def angle_off(chain: Chain, S: float, near: float) -> Callable[[float], float]:
    """How far a multiplier of mode 5, by shooting, is from a third of the circle, as a function of S."""
    orbit = follow_family(chain, 5, 1.1 * S, tolerance=1e-10).at(S=near)
    shooting = Shooting(5, 0.5, chain.gamma, -1.0, orbit.evaluate(0.0)[:5], orbit.period)

    def off(at: float) -> float:
        found = shooting.multipliers(at)
        return float(np.angle(found[np.argmin(np.abs(found - np.exp(2j * np.pi / 3)))]) - 2.0 * np.pi / 3)

    return off


@pytest.mark.slow
def test_edges_that_coincide_at_a_crossing_are_followed_as_a_resonance() -> None:
    """Mode 1 of five sites crosses mode 5 run through three times, where two of its multipliers are cube roots of 1."""
    family = follow_family(Chain(5, 0.5, 0.2, -1.0), 1, 2.0, stability=True)
    diagram = family.stability_diagram
    (number,) = (k for k, edge in enumerate(diagram.further) if abs(edge.S - 0.968627) < 1e-5)
    assert len(diagram.windows) == 1  # without a width
    curve = family.edge(number, further=True).curve("gamma", 0.21)
    assert curve.complete
    assert curve.kind == "1:3 resonance"
    assert curve.S[0] == pytest.approx(diagram.further[number].S, abs=3.0 * diagram.further[number].error)
    last = curve.points[-1]
    found = np.exp(2j * np.pi / 3)
    assert np.min(np.abs(last.orbit.floquet("cvodes").multipliers - found)) < 1e-7
    known = newton(angle_off(Chain(5, 0.5, 0.21, -1.0), curve.S[-1], curve.S[-1]), curve.S[-1], x1=curve.S[-1] + 1e-5)
    assert abs(curve.S[-1] - known) <= 2e-12
    assert 0.0 < curve.errors[-1] < 2e-12


@pytest.mark.slow
def test_a_window_between_krein_collisions_closes_where_their_edge_folds() -> None:
    """Mode 2 of four sites: the discriminant of the pair, by shooting, has the maximum 0 there, over S."""
    edge = follow_family(Chain(4, 0.5, 0.38, 1.0), 2, 1.0, stability=True).edge(1)
    with pytest.raises(ValueError, match=r"gamma: given 1\.2; accepted: -1 <= gamma <= 1"):
        edge.curve("gamma", 1.2)
    curve = edge.curve("gamma", 0.39)
    (fold,) = curve.folds
    assert curve.kind == "complex"
    gamma = fold.parameters["gamma"]
    target = fold.edge.multiplier.real

    def highest(gamma: float) -> tuple[float, float]:
        orbit = fold.orbit
        shooting = Shooting(4, 0.5, gamma, 1.0, orbit.evaluate(0.0)[:4], orbit.period)
        S = fold.edge.S + 0.05 * np.cos(np.pi * (np.arange(7) + 0.5) / 7)
        found = []
        for multipliers in map(shooting.multipliers, S):
            cosines = 0.5 * (multipliers + 1.0 / multipliers)
            pair = np.sort_complex(cosines[np.argsort(np.abs(cosines - target))[:4]])
            found.append(((pair[0] - pair[-1]) ** 2).real)
        p = np.polynomial.Chebyshev.fit(S, found, 6)
        place = brentq(p.deriv(), S[-1], S[0])
        return float(p(place)), float(place)

    (here, place), (beside, _) = highest(gamma), highest(gamma - 1e-6)
    assert abs(here / (beside - here) * 1e-6) <= fold.parameter_error < 1e-10
    assert abs(place - fold.edge.S) <= fold.edge.error < 1e-6
    assert curve.S[-1] > fold.edge.S > curve.S[0]  # it comes back along the other edge


@pytest.mark.slow
def test_equal_multipliers_of_a_ring_are_followed_together() -> None:
    """Only S times the coefficient matters: both edges, of two equal multipliers each, go with its inverse."""
    ring = Lattice([8], [Site("a", onsite="0*y")], [Bond("a", "a", [1], "d + b*d^3")], "periodic", {"b": 1.0})
    family = follow_family(ring, 8, 3.0, stability=True)
    diagram = family.stability_diagram
    assert (len(diagram.changes), len(diagram.further)) == (1, 1)  # the edge of two is there once
    for further, S in ((False, diagram.changes[0].S), (True, diagram.further[0].S)):
        curve = family.edge(0, further).curve("b", 1.3)
        assert curve.complete
        assert curve.S * curve["b"] == pytest.approx(S, rel=1e-8)
