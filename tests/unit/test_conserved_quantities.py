"""Orbits of models in which more than an energy is conserved, against closed forms."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.special import ellipk

from casadi_skin import Bond, Lattice, OdeModel, Site, find_orbit, follow_family
from casadi_skin.model.conserved import directions
from casadi_skin.model.saved import dumps, loads

PI_MODE = 2.3840110145512  # FPUT-beta, periodic, beta = 1, amplitude 1/2: 4 K(m)/sqrt(4 + 16 a^2)


def ring(sites: int) -> Lattice:
    return Lattice(sites, [Site("a", "0")], [Bond("a", "a", (1,), "d + d^3")], "periodic")


def pi_mode(t: float, sites: int) -> list[float]:
    signs, w = (-1.0) ** np.arange(sites), 2.0 * np.pi / 2.384
    return [*(0.5 * np.cos(w * t) * signs), *(-0.5 * w * np.sin(w * t) * signs)]


def body() -> tuple[OdeModel, dict[str, Any]]:
    """A free body with moments of inertia 1, 2, 3: the square of its spin is conserved and belongs to no symmetry."""
    spin, E, C = ca.SX.sym("s", 3), ca.SX.sym("E"), ca.SX.sym("C")
    turning = spin / ca.DM([1.0, 2.0, 3.0])
    energy, square = ca.dot(spin, turning) / 2, ca.sumsqr(spin)
    model = OdeModel(
        "body", spin, ca.cross(spin, turning), ca.vertcat(E, C), hamiltonian=energy, conserved={"spin": square}
    )
    return model, {"energy": energy - E, "both": [energy - E, square - C]}


def test_two_constants_without_a_symmetry_are_two_conditions() -> None:
    """Euler's body near its third axis: its period is 4 K(m)/lambda."""
    model, selects = body()
    E, C = 0.2, 1.0
    m = (2.0 * E * 3.0 - C) / (C - 2.0 * E)
    period = 4.0 * ellipk(m) / np.sqrt((C - 2.0 * E) / 6.0)
    angle = 2.0 * np.pi / period
    orbit = find_orbit(
        model, lambda t: [0.3 * np.cos(angle * t), -0.4 * np.sin(angle * t), 0.9], period,
        parameters={"E": E, "C": C}, select=selects["both"],
    )  # fmt: skip
    assert orbit.period == pytest.approx(period, rel=1e-10)
    assert orbit.floquet().trivial == 3
    assert abs(orbit.unfolding) < 1e-10
    with pytest.raises(ValueError, match="select: given 1 expressions; accepted: 2; spin belong to no symmetry"):
        find_orbit(model, [0.3, 0.0, 0.9], period, parameters={"E": E, "C": C}, select=selects["energy"])


@pytest.mark.slow
@pytest.mark.parametrize("symmetric", [False, True])
def test_the_pi_mode_of_a_ring_has_two_trivial_pairs(symmetric: bool) -> None:
    """The period is exact; below E = 0.5320603626 a ring of 8 is stable, above not (FPUT-beta, beta = 1)."""
    model = ring(8)
    assert list(model.conserved) == ["momentum"]
    way = np.array(ca.evalf(directions(model)["momentum"])).ravel()
    assert way == pytest.approx([*np.ones(8), *np.zeros(8)])
    orbit = find_orbit(
        model, lambda t: pi_mode(t, 8), 2.4, select=model.state[0] - model.state[1] - 1.0, symmetric=symmetric
    )
    assert orbit.floquet().trivial == 4
    assert not orbit.stable
    assert abs(orbit.unfolding) < 1e-9
    if symmetric:
        assert orbit.period == pytest.approx(PI_MODE, rel=1e-12)
        known = follow_family(model, 8, 2.0, stability=True).at(S=2.0)
        assert orbit.floquet().max_abs_multiplier == pytest.approx(known.floquet().max_abs_multiplier, rel=1e-7)


@pytest.mark.slow
def test_a_phase_that_moves_as_time_does_is_no_second_phase() -> None:
    """A standing wave of three coupled sites: moved by its own period it turns; its norm picks it. Kerr's equation.

    Where sites do not beat, psi = phi exp(i w t), energy and norm have parallel gradients: one pair is trivial.
    """
    a, b, N = ca.SX.sym("a", 3), ca.SX.sym("b", 3), ca.SX.sym("N")
    square = a**2 + b**2

    def beside(x: ca.SX) -> ca.SX:
        return ca.vertcat(x[1], x[0] + x[2], x[1])

    rhs = ca.vertcat(-beside(b) - square * b, beside(a) + square * a)
    energy = -(ca.dot(a[:2], a[1:]) + ca.dot(b[:2], b[1:])) - ca.sum1(square**2) / 4
    norm = ca.sum1(square)
    model = OdeModel("trimer", ca.vertcat(a, b), rhs, N, hamiltonian=energy, conserved={"norm": norm})
    profile, w = np.array([0.5, 2.0, 0.5]), 4.5
    orbit = find_orbit(
        model, lambda t: [*(profile * np.cos(w * t)), *(profile * np.sin(w * t))], 2.0 * np.pi / w,
        parameters={"N": 4.5}, select=norm - N,
    )  # fmt: skip
    assert orbit.floquet().trivial == 2
    states, found = orbit.evaluate(0.0), 2.0 * np.pi / orbit.period
    psi = states[:3] + 1j * states[3:]
    assert np.array([psi[1], psi[0] + psi[2], psi[1]]) + np.abs(psi) ** 2 * psi == pytest.approx(found * psi, abs=1e-7)


def test_what_is_declared_is_checked_and_saved() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    rhs = ca.vertcat(-y, x)
    with pytest.raises(ValueError, match="the declared conserved size is not conserved"):
        OdeModel("circle", ca.vertcat(x, y), rhs, conserved={"size": x**2 + 2 * y**2})
    with pytest.raises(ValueError, match="symmetries turn: turn is not among conserved; accepted: size"):
        OdeModel("circle", ca.vertcat(x, y), rhs, conserved={"size": x**2 + y**2}, symmetries={"turn": rhs})
    with pytest.raises(ValueError, match="the declared direction size is not that of a symmetry"):
        OdeModel("circle", ca.vertcat(x, y), rhs, conserved={"size": x**2 + y**2}, symmetries={"size": [x, 2 * y]})
    model = OdeModel("circle", ca.vertcat(x, y), rhs, conserved={"size": x**2 + y**2}, symmetries={"size": [x, y]})
    again = loads(dumps(model))
    assert float(again.function("I", again.conserved["size"])(0.0, [3.0, 4.0], [])) == 25.0
    assert np.array(again.function("g", again.symmetries["size"])(0.0, [3.0, 4.0], [])).ravel().tolist() == [3.0, 4.0]
