"""Verdicts by the error of each multiplier, and multipliers beside those that what is conserved puts at 1."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from casadi_skin import OdeModel, Orbit, find_orbit
from casadi_skin.stability.result import Floquet, reversible_floquet

Array = np.ndarray


def forced(matrix: Array, units: Array | float = 1.0) -> OdeModel:
    """x = units y with y' = A (y - cos t) - sin t: the multipliers are those of exp(2 pi A)."""
    n, t = len(matrix), ca.SX.sym("t")
    x = ca.SX.sym("x", n)
    rhs = ca.DM(matrix) @ (x / units - ca.cos(t)) - ca.sin(t) * np.ones(n)
    return OdeModel("forced", x, units * rhs, time=t, forcing_period=2.0 * np.pi)


def response(model: OdeModel, units: Array | float = 1.0, **options: object) -> Orbit:
    return find_orbit(model, lambda t: np.cos(t) * np.ones(model.full_size) * units, **options)


def assert_within_errors(floquet: Floquet, known: Array, largest: float) -> None:
    """Every known multiplier is one of the others, but for its error."""
    assert floquet.others.size == len(known)
    for value in known:
        distances = np.abs(floquet.others - value)
        nearest = int(np.argmin(distances))
        assert distances[nearest] <= floquet.other_errors[nearest] <= largest


# Verdicts -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
@pytest.mark.parametrize("size", [1.0752, 1.001, 0.999])
def test_a_multiplier_is_outside_or_inside_by_its_own_error(size: float, tolerance: float) -> None:
    rate = np.log(size) / (2.0 * np.pi)
    orbit = response(forced(np.array([[rate, 0.3], [-0.3, rate]])), tolerance=tolerance)
    floquet = orbit.floquet()
    assert orbit.stable == (size < 1.0)
    assert floquet.unstable_complex == 2 * (size > 1.0)
    assert not floquet.on_circle.any()
    assert_within_errors(floquet, size * np.exp([0.6j * np.pi, -0.6j * np.pi]), 1e-6)


def test_multipliers_that_nearly_meet_have_the_error_of_the_pair() -> None:
    """1 and 1 + 1e-6 times e^-0.1 with a Jordan block but for that: the root of what is off, and no more than that."""
    matrix = np.array([[-0.1, 1.0, 0.0], [0.0, -0.1 + 1e-6, 0.0], [0.2, 0.1, -0.3]])
    floquet = response(forced(matrix), tolerance=1e-8).floquet()
    assert_within_errors(floquet, np.exp(2.0 * np.pi * np.diag(matrix)), 1e-6)


def test_errors_of_multipliers_from_mu_go_with_the_root_of_mu_near_the_circle() -> None:
    found = reversible_floquet(np.array([-0.5, 1e-4, 1e-12 + 0j]), np.array([1e-9, 1e-9, 1e-10]), 0.0, 2)
    slope = abs(np.diff([(np.sqrt(m) + np.sqrt(1 + m)) ** 4 for m in (1e-4, 1e-4 + 1e-9)])[0])
    assert found.other_errors.shape == found.others.shape
    assert found.other_errors[0] == pytest.approx(4e-9, rel=1e-3)
    assert found.other_errors[2] == pytest.approx(slope, rel=1e-3)
    assert found.other_errors[4] == pytest.approx(4.0 * np.sqrt(1e-10), rel=0.2)


# What is conserved ----------------------------------------------------------------------------------------------------


def dimer() -> tuple[OdeModel, ca.SX]:
    """i u' = -v - |u|^2 u and the same for v, with its norm in place of a phase."""
    state, N = ca.SX.sym("x", 4), ca.SX.sym("N")
    a, b, c, d = ca.vertsplit(state)
    first, second = a**2 + b**2, c**2 + d**2
    rhs = ca.vertcat(-d - first * b, c + first * a, -b - second * d, a + second * c)
    energy = -(a * c + b * d) - (first**2 + second**2) / 4
    model = OdeModel("dimer", state, rhs, N, hamiltonian=energy, conserved={"norm": first + second})
    return model, first + second - N


@pytest.mark.parametrize("beyond", [0.3, 1e-3, 1e-6, 1e-8])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_pair_of_a_dimer_moves_through_1_where_the_symmetric_state_breaks(sign: int, beyond: float) -> None:
    """At norm 2; the pair is exp(+- i w T), w^2 = 2 (2 - N), beside those of energy and norm, which are parallel."""
    model, select = dimer()
    N = 2.0 * (1.0 + sign * beyond)
    A, w = np.sqrt(N / 2.0), 1.0 + N / 2.0
    orbit = find_orbit(
        model, lambda t: [A * np.cos(w * t), A * np.sin(w * t)] * 2, 2.0 * np.pi / w, parameters={"N": N}, select=select
    )
    floquet, angle = orbit.floquet(), np.sqrt(complex(2.0 * (2.0 - N))) * 2.0 * np.pi / w
    assert floquet.trivial == 2
    assert orbit.stable == (sign < 0)
    assert_within_errors(floquet, np.exp([1j * angle, -1j * angle]), 1e-8)


def test_directions_that_are_the_same_along_a_circle_are_one() -> None:
    """|q|^4/4 in the plane: the turn is the flow on a circle, of which the epicycle is exp(+- i sqrt(6) 2 pi)."""
    x, y, u, v, L = (ca.SX.sym(name) for name in ("x", "y", "u", "v", "L"))
    square = x**2 + y**2
    model = OdeModel(
        "centre", ca.vertcat(x, y, u, v), ca.vertcat(u, v, -square * x, -square * y), L,
        hamiltonian=(u**2 + v**2) / 2 + square**2 / 4, conserved={"spin": x * v - y * u},
    )  # fmt: skip
    circle = lambda t: [np.cos(t), np.sin(t), -np.sin(t), np.cos(t)]  # noqa: E731
    orbit = find_orbit(model, circle, 2.0 * np.pi, parameters={"L": 1.0}, select=x * v - y * u - L)
    floquet = orbit.floquet()
    assert floquet.trivial == 2
    assert_within_errors(floquet, np.exp([2j * np.pi * np.sqrt(6.0), -2j * np.pi * np.sqrt(6.0)]), 1e-8)
    line = find_orbit(model, lambda t: [np.cos(t), 0, -np.sin(t), 0], 6.0, parameters={"L": 1.0}, select=x - L)
    assert line.floquet().trivial == 4


def toda() -> tuple[OdeModel, ca.SX]:
    """A ring of three with exponential bonds, its momentum and its third integral (Henon 1974)."""
    q, p, a = ca.SX.sym("q", 3), ca.SX.sym("p", 3), ca.SX.sym("a")
    bonds = [ca.exp(q[(k + 2) % 3] - q[k]) for k in range(3)]  # between k - 1 and k
    rhs = ca.vertcat(p, *(bonds[k] - bonds[(k + 1) % 3] for k in range(3)))
    energy = ca.sumsqr(p) / 2 + sum(bonds)
    third = p[0] * p[1] * p[2] - sum(p[k] * bonds[(k + 2) % 3] for k in range(3))
    conserved = {"momentum": ca.sum1(p), "third": third}
    return OdeModel("Toda", ca.vertcat(q, p), rhs, a, hamiltonian=energy, conserved=conserved), q[0] - q[1] - a


def test_an_integrable_ring_has_no_multipliers_but_those_of_what_it_conserves() -> None:
    """Three constants and the directions that belong to them, in a ring of three: all six multipliers are 1."""
    model, select = toda()
    w = np.sqrt(3.0)

    def guess(t: float) -> list[float]:
        q, p = 0.2 * np.cos(w * t), -0.2 * w * np.sin(w * t)
        return [q, -q, 0.0, p, -p, 0.0]

    orbit = find_orbit(model, guess, 2.0 * np.pi / w, parameters={"a": 0.4}, select=select)
    floquet = orbit.floquet()
    assert floquet.trivial == 6
    assert floquet.others.size == floquet.other_errors.size == 0
    assert floquet.multipliers == pytest.approx(np.ones(6), abs=1e-6)
    assert orbit.stable
