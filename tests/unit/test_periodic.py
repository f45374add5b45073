"""Periodic orbits of any model against published periods, direct integration and each other."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from marks import slow
from programs import Program
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq
from scipy.special import ellipk
from small_models import van_der_pol

from casadi_skin.follow.find import find_orbit
from casadi_skin.follow.solution import Orbit
from casadi_skin.follow.space import BoundaryError
from casadi_skin.model.ode import OdeModel
from casadi_skin.stability.result import TrivialMultiplierWarning

Array = np.ndarray


def flow(field: Callable[[float, Array], Any], start: Array, time: float, method: str = "DOP853") -> Any:
    """An independent integration."""
    return solve_ivp(field, (0.0, time), start, method, rtol=1e-12, atol=1e-13, dense_output=True)


# Models ---------------------------------------------------------------------------------------------------------------


def circle(t: float) -> list[float]:
    return [2 * np.cos(t), -2 * np.sin(t)]


def duffing(**declared: Any) -> OdeModel:
    q, v, w, a, d, t = (ca.SX.sym(name) for name in ("q", "v", "omega", "a", "delta", "t"))
    rhs = ca.vertcat(v, -q - q**3 - d * v + a * ca.cos(w * t))
    return OdeModel(
        "Duffing", ca.vertcat(q, v), rhs, ca.vertcat(w, a, d), time=t, forcing_period=2 * ca.pi / w, **declared
    )  # fmt: skip


MOON = 0.0121505856  # of the mass of Earth and Moon
L1 = 0.8369151323  # rounded


def three_bodies(energy_parameter: bool = False) -> tuple[OdeModel, ca.SX, ca.SX]:
    """The planar circular restricted three-body problem in rotating coordinates; also its energy and x."""
    x, y, u, v, mu, energy = (ca.SX.sym(name) for name in ("x", "y", "u", "v", "mu", "E"))
    effective = (x**2 + y**2) / 2 + (1 - mu) / ca.sqrt((x + mu) ** 2 + y**2) + mu / ca.sqrt((x - 1 + mu) ** 2 + y**2)
    rhs = ca.vertcat(u, v, 2 * v + ca.gradient(effective, x), -2 * u + ca.gradient(effective, y))
    jacobi = (u**2 + v**2) / 2 - effective
    p = ca.vertcat(mu, energy) if energy_parameter else mu
    model = OdeModel("three bodies", ca.vertcat(x, y, u, v), rhs, p, reversal=(1, -1, -1, 1), hamiltonian=jacobi)
    return model, jacobi - energy if energy_parameter else jacobi, x


def lyapunov_by_shooting(x0: float) -> tuple[Any, float, float]:
    """The Lyapunov orbit through (x0, 0) that crosses the x axis at right angles twice: states, period, speed at x0."""
    mu = MOON

    def field(_: float, s: Array) -> Array:
        x, y, u, v = s
        r1, r2 = ((x + mu) ** 2 + y**2) ** 1.5, ((x - 1 + mu) ** 2 + y**2) ** 1.5
        return np.array(
            [u, v, 2 * v + x - (1 - mu) * (x + mu) / r1 - mu * (x - 1 + mu) / r2,
             -2 * u + y - (1 - mu) * y / r1 - mu * y / r2]
        )  # fmt: skip

    def crossing(_: float, s: Array) -> float:
        return float(s[1])

    crossing.terminal, crossing.direction = True, -1.0  # type: ignore[attr-defined]

    def half(speed: float) -> Any:
        start = [x0, 1e-300, 0.0, speed]
        return solve_ivp(field, (0.0, 3.0), start, "DOP853", events=crossing, rtol=1e-13, atol=1e-14)

    speed = brentq(lambda s: half(s).y[2, -1], 0.05, 0.12, xtol=1e-15)
    period = 2.0 * half(speed).t[-1]
    return flow(field, np.array([x0, 0.0, 0.0, speed]), period).sol, period, speed


# Autonomous -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("transcription", "corrector"),
    [("gauss", "newton"), ("radau", "ipopt"), slow("gauss", "ipopt"), slow("radau", "newton")],
)
def test_van_der_pol_at_1(transcription: str, corrector: str) -> None:
    """Period and amplitude to 28 digits: Hairer, Norsett and Wanner (1993), section I.16, exercise 1."""
    options = {"transcription": transcription, "corrector": corrector, "tolerance": 1e-10}
    orbit = find_orbit(van_der_pol(), circle, 6.6, parameters={"mu": 1.0}, **options)
    assert abs(orbit.period - 6.6632868593231301897) <= max(orbit.period_error, 1e-14)
    assert orbit.period_error < 1e-9
    assert abs(orbit.evaluate(np.linspace(0, orbit.period, 20001))[:, 0].max() - 2.00861986087484313651) < 1e-7
    # Liouville: the other multiplier is the exponential of the integral of the divergence.
    divergence, _ = quad(lambda t: 1 - orbit.evaluate(t)[0] ** 2, 0.0, orbit.period, epsabs=1e-12, limit=200)
    for by in ("collocation", "cvodes"):
        found = orbit.floquet(by)
        assert found.trivial == 1
        assert found.stable
        assert abs(found.others[0] / np.exp(divergence) - 1) < (1e-8 if by == "collocation" else 1e-3)
        assert found.trivial_deviation < 1e-8


def test_an_orbit_that_repels_strongly_has_the_reciprocal_multiplier() -> None:
    """Time runs backwards: exp of the integral of mu (x^2 - 1), 1e37, of which maps over intervals keep no digit."""
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    reversed_time = OdeModel("van der Pol reversed", ca.vertcat(x, y), ca.vertcat(-y, mu * (x**2 - 1) * y + x), mu)
    first = find_orbit(reversed_time, lambda t: [2 * np.cos(t), 2 * np.sin(t)], 6.6, parameters={"mu": 1.0})
    orbit = first.follow("mu", 5.0, at=[5.0]).at(mu=5.0)
    growth, _ = quad(lambda t: 5.0 * (orbit.evaluate(t)[0] ** 2 - 1), 0.0, orbit.period, epsabs=1e-9, limit=500)
    other = orbit.floquet().others[0]
    assert growth > 80.0
    assert other.imag == 0.0
    assert abs(np.log(other.real) - growth) < 1e-6


def test_a_section_in_place_of_the_phase_condition() -> None:
    model = van_der_pol()
    free = find_orbit(model, circle, 6.6, parameters={"mu": 1.0}, tolerance=1e-10)
    cut = find_orbit(model, circle, 6.6, parameters={"mu": 1.0}, section=model.state[1], tolerance=1e-10)
    assert abs(free.period - cut.period) < 1e-9
    assert abs(cut.evaluate(0.0)[1]) < 1e-12
    assert abs(abs(cut.evaluate(0.0)[0]) - 2.00861986087484313651) < 1e-9


@pytest.mark.parametrize("phase", [0.0, 1.0, 3.0])
def test_the_phase_follows_the_guess(phase: float) -> None:
    turned = find_orbit(van_der_pol(), lambda t: circle(t + phase), 2 * np.pi, parameters={"mu": 0.1})
    assert abs(turned.period - 2 * np.pi * (1 + 0.1**2 / 16)) < 1e-5  # Lindstedt and Poincare
    np.testing.assert_allclose(turned.evaluate(0.0), circle(phase), atol=0.12)


def test_multipliers_that_are_sought_where_the_mesh_is_coarse_warn() -> None:
    """The trivial multiplier tells that the others are not to be trusted, and so does `trivial_deviation`."""
    coarse = find_orbit(van_der_pol(), circle, 6.6, parameters={"mu": 1.0}, tolerance=1e-2, degree=2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = coarse.floquet()
    assert 1e-8 < found.trivial_deviation < found.allowed_deviation
    judged = replace(coarse, space=replace(coarse.space, tolerance=1e-12))  # type: ignore[type-var]
    with pytest.warns(TrivialMultiplierWarning, match="the trivial multiplier is off by .*; try a smaller tolerance"):
        judged.floquet()


# Forced ---------------------------------------------------------------------------------------------------------------


def test_the_amplitude_of_a_forced_orbit_by_harmonic_balance() -> None:
    """First and third harmonic by Newton's method in numpy, at a small force where higher ones are below 1e-7."""
    orbit = find_orbit(duffing(), [0.0, 0.0], parameters={"omega": 1.6, "a": 0.02, "delta": 0.1}, tolerance=1e-10)
    theta = 2 * np.pi * np.arange(64) / 64
    basis = np.stack([np.cos(theta), np.sin(theta), np.cos(3 * theta), np.sin(3 * theta)])
    k = np.array([1.0, 1.0, 3.0, 3.0]) * 1.6

    def residual(c: Array) -> Array:
        q = c @ basis
        rate = np.array([c[1], -c[0], c[3], -c[2]]) * k @ basis
        force = -(c * k**2) @ basis + q + q**3 + 0.1 * rate - 0.02 * np.cos(theta)
        return np.asarray(basis @ force / 32)

    c = np.zeros(4)
    for _ in range(20):
        jacobian = np.stack([(residual(c + h) - residual(c - h)) / 2e-6 for h in 1e-6 * np.eye(4)], axis=1)
        c = c - np.linalg.solve(jacobian, residual(c))
    t = theta / 1.6
    np.testing.assert_allclose(orbit.evaluate(t)[:, 0], c @ basis, atol=1e-9)


# Conservative and reversible ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lyapunov() -> tuple[Any, float, float]:
    return lyapunov_by_shooting(L1 - 0.01)


@pytest.mark.slow
def test_a_lyapunov_orbit_both_ways(lyapunov: tuple[Any, float, float]) -> None:
    """Half of it by symmetry; all of it with unfolding, by section or phase, selected by x or energy: one period."""
    guess, period, speed = lyapunov
    model, jacobi, x = three_bodies()
    x0, given = L1 - 0.01, {"parameters": {"mu": MOON}, "tolerance": 1e-11}
    half = find_orbit(model, guess, period, select=x - x0, symmetric=True, **given)  # type: ignore[arg-type]
    cut = find_orbit(model, guess, period, select=x - x0, section=model.state[1], **given)  # type: ignore[arg-type]
    energy = float(ca.Function("J", [model.state, model.parameters], [jacobi])(half.evaluate(0.0), MOON))
    whole = find_orbit(model, guess, period, select=jacobi - energy, **given)  # type: ignore[arg-type]
    assert abs(half.period - period) < 1e-10
    assert abs(cut.period - half.period) < 1e-10
    assert abs(whole.period - half.period) < 1e-10
    assert abs(cut.unfolding) < 1e-10
    assert abs(whole.unfolding) < 1e-10
    assert abs(half.evaluate(0.0)[3] - speed) < 1e-9
    t = np.linspace(-period, 2 * period, 41)  # the symmetric half is unfolded to all times
    np.testing.assert_allclose(half.evaluate(t), cut.evaluate(t), atol=1e-8)
    largest = [orbit.floquet(by).others[0].real for orbit in (half, cut, whole) for by in ("collocation", "cvodes")]
    np.testing.assert_allclose(largest, largest[0], rtol=1e-7)
    for orbit in (half, cut, whole):
        found = orbit.floquet()
        assert found.trivial == 2
        assert not found.stable
        assert abs(found.others[0] * found.others[-1] - 1) < 1e-6  # reciprocal pairs
        assert found.trivial_deviation < 1e-5


def test_a_family_of_lyapunov_orbits_in_its_energy(lyapunov: tuple[Any, float, float]) -> None:
    """E is a parameter that only `select` knows; every orbit has it, and the last agrees with shooting."""
    guess, period, _ = lyapunov
    model, excess, _ = three_bodies(energy_parameter=True)
    at_guess = ca.Function("J", [model.state, model.parameters], [excess])
    energy = float(at_guess(guess(0.0), [MOON, 0.0]))
    first = find_orbit(
        model, guess, period, select=excess, symmetric=True, parameters={"mu": MOON, "E": energy}, tolerance=1e-9
    )
    branch = first.follow("E", energy + 0.002)
    assert branch.complete
    for orbit in branch.solutions:
        assert abs(float(at_guess(orbit.evaluate(0.0), [MOON, orbit.parameters["E"]]))) < 1e-9
    last = branch.solutions[-1]
    _, other, _ = lyapunov_by_shooting(float(last.evaluate(0.0)[0]))
    assert abs(last.period - other) < 1e-8
    assert np.all(np.diff([o.period for o in branch.solutions if isinstance(o, Orbit)]) > 0)


@pytest.mark.parametrize("symmetric", [True, False])
def test_a_pendulum_has_its_period(symmetric: bool) -> None:
    """4 K(sin^2(a/2)); a quarter is unknown where reversal and half-period symmetry are declared."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = OdeModel(
        "pendulum", q, -ca.sin(q), order=2, velocity=v, reversal=(1, -1), half_period=(-1, -1),
        hamiltonian=v**2 / 2 - ca.cos(q),
    )  # fmt: skip
    orbit = find_orbit(
        model, lambda t: [2 * np.cos(t * 2 * np.pi / 8), 0], 8.0, select=q - 2.0, symmetric=symmetric,
        section=None if symmetric else v, tolerance=1e-11,
    )  # fmt: skip
    exact = 4 * ellipk(np.sin(1.0) ** 2)
    assert abs(orbit.period - exact) <= max(orbit.period_error, 1e-13)
    assert orbit.mesh[-1] == pytest.approx(exact / 4 if symmetric else exact)
    assert orbit.interval == (0.0, orbit.period)
    assert orbit.floquet().trivial == 2
    assert orbit.floquet().stable
    assert abs(np.linalg.det(orbit.floquet().monodromy) - 1) < 1e-9


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_an_unfolding_that_does_not_vanish_is_told_in_any_unit(unit: float) -> None:
    """A damped oscillator that claims to conserve its energy: only with the damping undone is there an orbit."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    energy, guess = ((q / unit) ** 2 + (v / unit) ** 2) / 2, lambda t: [unit * np.cos(t), -unit * np.sin(t)]
    for damping in (0.01, 0.0):
        model = OdeModel("liar", ca.vertcat(q, v), ca.vertcat(v, -q - damping * v), hamiltonian=energy, checked=False)
        if damping:
            with pytest.raises(BoundaryError, match=r"the unfolding parameter is .* of 0: the hamiltonian is not"):
                find_orbit(model, guess, 6.28, select=q / unit - 1, section=v / unit)
        else:
            orbit = find_orbit(model, guess, 6.28, select=q / unit - 1, section=v / unit)
            assert orbit.period == pytest.approx(2 * np.pi)


# What is refused ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "arguments", "words"),
    [
        (van_der_pol, {"period": None}, "period: given None; accepted: a number > 0"),
        (van_der_pol, {"period": 6.6, "cycles": 2}, "cycles: given 2 for van der Pol, which is autonomous"),
        (van_der_pol, {"period": 6.6, "select": ca.SX(0)}, "select: given for van der Pol"),
        (van_der_pol, {"period": 6.6, "parameters": {"nu": 1.0}}, "parameters: given 'nu'"),
        (duffing, {"period": 1.0}, "period: given for Duffing, which is forced; accepted: cycles, after which it"),
        (duffing, {"symmetric": True}, "symmetric: given for Duffing, which is forced"),
        (lambda: three_bodies()[0], {"period": 2.7}, "select: given none; accepted: a value at phase zero, for"),
        (van_der_pol, {"period": 6.6, "guess": [0.0, 0.0]}, "guess: given a state that does not move; accepted: one"),
        (van_der_pol, {"period": 6.6, "select": ca.SX(0), "symmetric": True},
         "symmetric: given for van der Pol, which declares no reversal; accepted: with one"),
    ],
)  # fmt: skip
def test_arguments_that_do_not_fit_the_model_are_refused(
    make: Callable[[], OdeModel], arguments: dict[str, Any], words: str
) -> None:
    model = make()
    given = {"parameters": dict.fromkeys(model.parameter_names, 1.0)} | arguments
    with pytest.raises((ValueError, TypeError)) as error:
        find_orbit(model, **({"guess": [0.1] * model.full_size} | given))  # type: ignore[arg-type]
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_forcing_period_after_which_the_equations_do_not_repeat_is_refused() -> None:
    """A number for 2 pi / omega holds at one omega: an orbit is found there, and nothing at another one."""
    q, v, w, t = (ca.SX.sym(name) for name in ("q", "v", "omega", "t"))
    rhs = ca.vertcat(v, -q - q**3 - 0.1 * v + 0.5 * ca.cos(w * t))
    model = OdeModel(
        "Duffing", ca.vertcat(q, v), rhs, w, time=t, forcing_period=2.0 * np.pi / 1.7, nominal=(1.7,)
    )  # fmt: skip
    orbit = find_orbit(model, [0.0, 0.0])
    words = "Duffing: forcing_period: given 3.69599 at omega = 1.5, after which equations do not repeat"
    with pytest.raises(ValueError, match=words):
        find_orbit(model, [0.0, 0.0], parameters={"omega": 1.5})
    with pytest.raises(ValueError, match=words):
        orbit.follow("omega", 1.5)


def test_another_way_to_multipliers_is_refused() -> None:
    orbit = find_orbit(van_der_pol(), circle, 6.6, parameters={"mu": 1.0})
    with pytest.raises(ValueError, match="flow: given 'hand'; accepted: collocation, cvodes"):
        orbit.floquet("hand")


# Programs -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_orbit_through_a_program_with_its_own_derivatives_is_found_and_followed() -> None:
    x, nu, s, mu = ca.SX.sym("s", 2), ca.SX.sym("mu"), ca.MX.sym("s", 2), ca.MX.sym("mu")
    field = Program(ca.Function("field", [x, nu], [ca.vertcat(x[1], nu * (1 - x[0] ** 2) * x[1] - x[0])]))
    model = OdeModel("program", s, field(s, mu), mu)
    orbit = find_orbit(model, circle, 6.6, parameters={"mu": 1.0}, tolerance=1e-9)
    symbolic = find_orbit(van_der_pol(), circle, 6.6, parameters={"mu": 1.0}, tolerance=1e-9)
    assert abs(orbit.period - 6.6632868593231301897) < 1e-9
    for by in ("collocation", "cvodes"):
        np.testing.assert_allclose(orbit.floquet(by).multipliers, symbolic.floquet(by).multipliers, atol=1e-8)
    last = orbit.follow("mu", 1.2).solutions[-1]
    assert abs(last.period - find_orbit(van_der_pol(), last, parameters={"mu": 1.2}).period) < 1e-7
