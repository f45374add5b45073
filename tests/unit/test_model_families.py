"""Families of any model of second order against closed forms, harmonic balance and integrations of their own.

Whatever is compared is typed out again in numpy: forces, stiffnesses, energies, and harmonic balance.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from marks import slow
from numpy.typing import NDArray
from scipy.integrate import quad, solve_ivp
from scipy.optimize import linear_sum_assignment
from scipy.special import ellipk
from small_models import fput, lattice, pendulums

from casadi_skin import Branch, Chain, OdeModel, Orbit, find_orbit, follow_family
from casadi_skin.zero.family import family_request

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def second_order(name: str, q: ca.SX, force: ca.SX, *parameters: ca.SX, odd: bool = True, **more: Any) -> OdeModel:
    """A model of second order that is reversible, and odd unless told otherwise."""
    n = q.numel()
    signs: dict[str, Any] = {"reversal": (1,) * n + (-1,) * n, "half_period": (-1,) * (2 * n) if odd else None}
    velocity = more.pop("velocity", ca.SX.sym("v", n))
    return OdeModel(name, q, force, ca.vertcat(ca.SX(0, 1), *parameters), 2, velocity, **(signs | more))


# What is compared with -----------------------------------------------------------------------------------------------


def apart(found: ComplexArray, expected: ComplexArray) -> float:
    """Largest distance of values that are not in the same order."""
    assert found.shape == expected.shape
    distances = np.abs(found[:, None] - expected)
    return float(np.max(distances[linear_sum_assignment(distances)], initial=0.0))


@dataclass(frozen=True)
class Typed:
    """The equations q'' = force(q) typed out in numpy; their derivative by a complex step, to rounding."""

    force: Callable[[Any], Any]

    def derivative(self, q: Array) -> Array:
        return np.stack([self.force(q + 1e-30j * row).imag / 1e-30 for row in np.eye(q.size)], axis=1)

    def flow(self, start: Array, time: float, columns: int = 0) -> tuple[Array, Array]:
        """State after a time by DOP853, and the first columns of the transition matrix."""
        n = start.size // 2

        def field(_: float, x: Array) -> Array:
            q, v, V = x[:n], x[n : 2 * n], x[2 * n :].reshape(2 * n, columns)
            return np.concatenate([v, self.force(q), V[n:].ravel(), (self.derivative(q) @ V[:n]).ravel()])

        whole = np.concatenate([start, np.eye(2 * n)[:, :columns].ravel()])
        end = solve_ivp(field, (0.0, time), whole, "DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        return end[: 2 * n], end[2 * n :].reshape(2 * n, columns)

    def check(self, orbit: Orbit, tolerance: float = 1e-8, vectors: bool = False) -> ComplexArray:
        """Closure, rest at half a period, multipliers and vectors of an orbit; returns the multipliers by DOP853."""
        n = orbit.profile.size
        start = np.concatenate([orbit.profile, np.zeros(n)])
        end, monodromy = self.flow(start, orbit.period, 2 * n)
        size = np.max(np.abs(start))
        np.testing.assert_allclose(end, start, atol=tolerance * size * max(1.0, np.linalg.norm(monodromy, 2)))
        half, _ = self.flow(start, orbit.period / 2)
        np.testing.assert_allclose(half[:n], orbit.evaluate(orbit.period / 2), atol=1e3 * tolerance * size)
        assert np.max(np.abs(half[n:])) < 1e3 * tolerance * size

        found, values = orbit.floquet().multipliers, np.linalg.eigvals(monodromy)
        np.testing.assert_array_equal(found[:2], 1.0)
        rest = np.delete(values, np.argsort(np.abs(values - 1.0))[:2])  # split by the root of the error
        assert apart(found[2:], rest) < 1e-6
        if vectors:
            W = orbit.floquet_vectors()
            np.testing.assert_allclose(np.max(np.abs(W), axis=0), 1.0, rtol=1e-12)
            np.testing.assert_allclose(monodromy @ W[:, 2:], W[:, 2:] * found[2:], atol=1e-6)
        return np.concatenate([found[:2], rest])


def typed_lattice(bond: float, onsite: bool, gamma: float = 0.0) -> Typed:
    """Bonds d + bond d^3 between walls, gains 1 - gamma to the right and 1 + gamma to the left; pendulums or none."""

    def force(q: Array) -> Array:
        d = np.diff(q, prepend=0.0, append=0.0)
        pull = d + bond * d**3
        return (1 - gamma) * pull[1:] - (1 + gamma) * pull[:-1] - (np.sin(q) if onsite else 0.0)

    return Typed(force)


def harmonic_balance(typed: Typed, mode: Array, omega: float, amplitudes: Array, harmonics: int) -> tuple[float, Array]:
    """Omega and coefficients of the odd cosines at the last of ascending S, from a linear mode, by Newton's method."""
    n, odd = mode.size, 2 * np.arange(harmonics) + 1
    theta = (np.arange(4 * harmonics) + 0.5) * np.pi / (8 * harmonics)
    C = np.cos(np.outer(theta, odd))
    mean = C.T / (2 * harmonics)
    c = np.zeros((harmonics, n))
    c[0] = mode
    for S in amplitudes:
        c *= np.sqrt(S / np.sum(np.sum(c, axis=0) ** 2))
        for _ in range(30):
            q, at_rest = C @ c, np.sum(c, axis=0)
            residual = (odd**2 * omega**2)[:, None] * c + mean @ np.array([typed.force(x) for x in q])
            stiffness = np.array([typed.derivative(x) for x in q])
            J = np.zeros((harmonics * n + 1, harmonics * n + 1))
            J[:-1, :-1] = np.einsum("ki,il,iab->kalb", mean, C, stiffness).reshape(harmonics * n, -1)
            J[:-1, :-1] += np.diag(np.repeat(odd**2 * omega**2, n))
            J[:-1, -1] = ((2 * omega * odd**2)[:, None] * c).ravel()
            J[-1, :-1] = np.tile(2 * at_rest, harmonics)
            step = np.linalg.solve(J, -np.append(residual.ravel(), at_rest @ at_rest - S))
            c, omega = c + step[:-1].reshape(harmonics, n), omega + step[-1]
            if np.max(np.abs(step)) < 1e-13:
                break
        else:
            raise AssertionError(f"harmonic balance does not converge at S = {S}")
    return float(omega), c


# Hamiltonian lattices -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sites", "mode", "S", "harmonics"), [(8, 1, 1.5, 10), (24, 24, 0.1, 6), slow(24, 1, 1.5, 12), slow(8, 8, 1.5, 10)]
)
def test_fput_by_harmonic_balance_and_by_integration(sites: int, mode: int, S: float, harmonics: int) -> None:
    """FPUT-beta with fixed ends, omega_j = 2 sin(j pi/(2 (N + 1)))."""
    branch = follow_family(fput(sites), mode, 2.0 * S, at=(S,), tolerance=1e-10, corrector="newton")
    assert branch.complete
    orbit, typed = branch.at(S), typed_lattice(1.0, False)
    angle = mode * np.pi / (sites + 1)
    shape = np.sin(angle * np.arange(1, sites + 1))
    exact, c = harmonic_balance(typed, shape, 2 * np.sin(angle / 2), np.linspace(S / 12, S, 12), harmonics)
    assert abs(orbit.Omega - exact) <= orbit.Omega_error + 1e-13
    found = orbit.coefficients(harmonics)
    np.testing.assert_allclose(found * np.sign(found[0] @ c[0]), c, atol=1e-9)
    assert orbit.Omega_shift == pytest.approx(orbit.Omega - 2 * np.sin(angle / 2), rel=1e-12)

    typed.check(orbit)
    d = np.diff(orbit.profile, prepend=0.0, append=0.0)
    assert orbit.energy == pytest.approx(np.sum(d**2 / 2 + d**4 / 4), rel=1e-12)
    assert branch.space.coordinates.symplectic
    assert orbit.parameters == {"bond": 1.0}


def pendulum() -> OdeModel:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    return second_order("pendulum", q, -ca.sin(q), velocity=v, hamiltonian=v**2 / 2 + 1 - ca.cos(q))


def between_walls(name: str, potential: Callable[[ca.SX], ca.SX], odd: bool) -> OdeModel:
    """Three sites between walls with a potential of their four bonds."""
    q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
    V = ca.sum1(potential(ca.vertcat(q, 0) - ca.vertcat(0, q)))
    return second_order(name, q, -ca.gradient(V, q), odd=odd, velocity=v, hamiltonian=v.T @ v / 2 + V)


def pulled(pull: Callable[[Any], Any], q: Any) -> Any:
    """Forces on sites between walls by the pull of a bond of extension d."""
    return np.diff(pull(np.diff(q, prepend=0.0, append=0.0)))


M, K, Q3 = np.array([1.0, 4.0, 0.25]), np.array([1.0, 2.0, 3.0]), ca.SX.sym("q", 3)
BONDS = ca.vertcat(Q3, 0) - ca.vertcat(0, Q3)
TODA = between_walls("Toda", lambda d: ca.exp(d) - d - 1, odd=False)
ALPHA = between_walls("alpha", lambda d: d**2 / 2 + d**3 / 12, odd=False)
MASSES = second_order("masses", Q3, -ca.gradient(ca.sumsqr(BONDS) / 2 + ca.sum1(BONDS**4) / 4, Q3) / M)
ONE_SIDED = 0.3 * (BONDS[1:] - BONDS[:-1]) - K * Q3 - Q3**3 - ca.vertcat(0, Q3[1] * Q3[2] ** 2, 0)
GAIN = BONDS[1:] - BONDS[:-1] + 0.8 * BONDS[1:] ** 3 - 1.2 * BONDS[:-1] ** 3


def one_sided(x: Any) -> Any:
    return 0.3 * pulled(lambda d: d, x) - K * x - x**3 - np.array([0, x[1] * x[2] ** 2, 0])


def gained(x: Any) -> Any:
    d = np.diff(x, prepend=0.0, append=0.0)
    return np.diff(d) + 0.8 * d[1:] ** 3 - 1.2 * d[:-1] ** 3


@pytest.mark.parametrize(
    ("model", "force", "mode", "S", "symplectic", "log_scale"),
    [
        # neither odd nor polynomials: half a period, by Gauss collocation
        (TODA, lambda x: pulled(np.exp, x), 1, 0.5, True, np.zeros(3)),
        # V = d^2/2 + d^3/12 has even harmonics too: half a period, and stability over half of it
        (ALPHA, lambda x: pulled(lambda d: d + d**2 / 4, x), 1, 0.3, True, np.zeros(3)),
        # M q'' = -grad V: D = M^(-1/2), and the flow is Hamiltonian in these coordinates
        (MASSES, lambda x: pulled(lambda d: d + d**3, x) / M, 2, 0.7, True, 0.5 * np.log(0.25 / M)),
        # bonds with one gain are Hamiltonian in their gauge
        (lattice("gain", 5, 1.0, False, 0.3), typed_lattice(1.0, False, 0.3).force, 5, 1.0, True, np.arctanh(0.3)),
        # -q_2 q_3^2 acts on site 2 alone: the linear part is symmetric as it is, and no coordinates do more
        (second_order("one-sided", Q3, ONE_SIDED), one_sided, 2, 1.2, False, np.zeros(3)),
        # linear bonds act both ways alike, cubic ones by 0.8 to the right and 1.2 to the left
        (second_order("gain", Q3, GAIN), gained, 2, 2.0, False, np.zeros(3)),
    ],
)
def test_any_forces_by_integration(
    model: OdeModel, force: Callable[[Any], Any], mode: int, S: float, symplectic: bool, log_scale: Any
) -> None:
    branch = follow_family(model, mode, S, at=(S,), tolerance=1e-10, corrector="newton")
    assert branch.complete
    coordinates, orbit = branch.space.coordinates, branch.at(S)
    Typed(force).check(orbit, vectors=True)
    assert coordinates.symplectic == symplectic
    if np.ndim(log_scale):
        np.testing.assert_allclose(
            coordinates.log_scale - coordinates.log_scale[0], log_scale - log_scale[0], atol=1e-13
        )
    else:
        np.testing.assert_allclose(np.diff(coordinates.log_scale), log_scale, rtol=1e-13)
    assert np.sum(orbit.profile**2) == pytest.approx(S, rel=1e-14)


def test_families_without_odd_harmonics_alone() -> None:
    branch = follow_family(ALPHA, 1, 0.3, at=(0.3,), tolerance=1e-9, stability=True, corrector="newton")
    assert branch.space.request.method.transcription == "gauss"
    orbit = branch.at(0.3)
    mean = np.mean(orbit.evaluate(np.arange(64) / 64 * orbit.period), axis=0)
    assert np.max(np.abs(mean)) > 1e-3  # an odd orbit would have none
    with pytest.raises(ValueError, match="the orbit is no sum of odd cosines"):
        orbit.coefficients(8)
    with pytest.raises(ValueError, match=r"^transcription: given trigonometric; accepted: gauss, radau or shooting"):
        follow_family(ALPHA, 2, 0.5, transcription="trigonometric")
    assert follow_family(TODA, 1, 0.5, at=(0.5,), tolerance=1e-9).at(0.5).floquet().stable  # it is integrable


# The paper's chain, written by hand -----------------------------------------------------------------------------------


def chain_by_hand(sites: int) -> OdeModel:
    y, alpha, gamma, g = ca.SX.sym("y", sites), ca.SX.sym("alpha"), ca.SX.sym("gamma"), ca.SX.sym("g")
    left, right = ca.vertcat(0, y[:-1]), ca.vertcat(y[1:], 0)
    force = (1 + gamma) * left - 2 * y + (1 - gamma) * right - alpha * y - g * y**3
    return second_order("by hand", y, force, alpha, gamma, g)


@pytest.mark.parametrize(
    ("sites", "gamma", "g", "mode", "S"), [(24, 0.25, -1.0, 1, 1.0), (48, 0.6, 1.0, 48, 3.0), (6, -0.25, 1.0, 2, 1.0)]
)
def test_the_chain_by_hand_has_the_numbers_of_the_chain(
    sites: int, gamma: float, g: float, mode: int, S: float
) -> None:
    chain, values = Chain(sites, 1.0, gamma, g), {"alpha": 1.0, "gamma": gamma, "g": g}
    options: dict[str, Any] = {"at": (0.2, S), "tolerance": 1e-10, "corrector": "newton"}
    one = follow_family(chain, mode, S, **options)
    other = follow_family(chain_by_hand(sites), mode, S, parameters=values, **options)
    np.testing.assert_allclose(other.space.coordinates.log_scale, chain.log_rho, atol=1e-13 * sites)
    assert other.space.request.method == one.space.request.method
    for where in (0.2, S):
        a, b = one.at(where), other.at(where)
        assert b.Omega == pytest.approx(a.Omega, rel=1e-12)
        assert b.Omega_shift == pytest.approx(a.Omega_shift, rel=1e-9)
        np.testing.assert_allclose(b.profile, a.profile, atol=1e-11)
        np.testing.assert_allclose(b.log10_profile, a.log10_profile, atol=1e-8)
        np.testing.assert_array_equal(b.profile_sign, a.profile_sign)
        assert apart(b.floquet().mu, a.floquet().mu) < 1e-8
        assert b.floquet().stable == a.floquet().stable
        assert b.floquet().max_abs_multiplier == pytest.approx(a.floquet().max_abs_multiplier, rel=1e-7)
    if sites == 24 and g == -1.0:
        assert other.at(1.0).Omega == pytest.approx(1.018532435491958, abs=1e-12)


# Reversible, but not Hamiltonian in any diagonal coordinates ---------------------------------------------------------


def test_cubic_bonds_with_a_gain_lose_stability() -> None:
    """Six sites; without Hamiltonian coordinates there is neither an energy nor growth by their map."""
    q = ca.SX.sym("q", 6)
    d = ca.vertcat(q, 0) - ca.vertcat(0, q)
    force = d[1:] - d[:-1] + 0.8 * d[1:] ** 3 - 1.2 * d[:-1] ** 3
    branch = follow_family(second_order("gain", q, force), 3, 3.0, at=(0.3, 3.0), tolerance=1e-9, corrector="newton")
    for S, stable in ((0.3, True), (3.0, False)):
        orbit = branch.at(S)
        values = Typed(gained).check(orbit, vectors=True)
        assert orbit.floquet().stable == (np.max(np.abs(values)) < 1 + 1e-6) == stable
        with pytest.raises(ValueError, match="energy: gain declares no hamiltonian"):
            _ = orbit.energy
        with pytest.raises(ValueError, match="transient_growth: needs"):
            orbit.transient_growth()
    assert apart(orbit.floquet("cvodes").multipliers, orbit.floquet().multipliers) < 1e-6


def test_couplings_that_act_one_way() -> None:
    """Site 1 drives site 2 and feels nothing: no diagonal coordinates make the linear part symmetric."""
    q = ca.SX.sym("q", 2)
    model = second_order("one way", q, ca.vertcat(-q[0] - q[0] ** 3, -2 * q[1] + 0.5 * q[0] - q[1] ** 3))
    typed = Typed(lambda x: np.array([-x[0] - x[0] ** 3, -2 * x[1] + 0.5 * x[0] - x[1] ** 3]))
    for mode, S in ((1, 1.0), (2, 1.0)):
        branch = follow_family(model, mode, S, at=(S,), tolerance=1e-10)
        assert not branch.space.coordinates.symplectic
        orbit = branch.at(S)
        typed.check(orbit, vectors=True)
        if mode == 2:  # site 2 alone
            amplitude, stiffness = np.sqrt(S), 2.0
        else:  # site 1 moves as if it were alone
            amplitude, stiffness = orbit.profile[0], 1.0
        m = amplitude**2 / (2 * (stiffness + amplitude**2))
        assert orbit.Omega == pytest.approx(np.pi * np.sqrt(stiffness + amplitude**2) / (2 * ellipk(m)), rel=1e-10)


# A normalisation of one's own -----------------------------------------------------------------------------------------


def springs(normalisation: Callable[[ca.SX, ca.SX], ca.SX] | None = None) -> OdeModel:
    """Three sites with springs q + k q^3, and S by a normalisation where one is given."""
    q, k, S = ca.SX.sym("q", 3), ca.SX.sym("k"), ca.SX.sym("amplitude")
    d = ca.vertcat(q, 0) - ca.vertcat(0, q)
    force = d[1:] - d[:-1] - q - k * q**3
    if normalisation is None:
        return second_order("springs", q, force, k)
    return second_order("springs", q, force, k, S, normalisation=normalisation(q, S))


@pytest.mark.parametrize("spelled", [lambda q, S: q[0] ** 2 - S, lambda q, S: -(S - 0.5 * q[0] ** 2) + 0.5 * q[0] ** 2])
def test_the_amplitude_may_be_that_of_one_site(spelled: Callable[[ca.SX, ca.SX], ca.SX]) -> None:
    by_site = follow_family(springs(spelled), 1, 0.5, at=(0.2,), parameters={"k": 1.0}, tolerance=1e-10)
    orbit = by_site.at(0.2)
    assert orbit.profile[0] == pytest.approx(np.sqrt(0.2), rel=1e-14)
    by_all = follow_family(springs(), 1, 2.0, parameters={"k": 1.0}, tolerance=1e-10)
    same = by_all.at(float(np.sum(orbit.profile**2)))
    assert orbit.Omega == pytest.approx(same.Omega, rel=1e-12)
    np.testing.assert_allclose(orbit.profile, same.profile, atol=1e-11)
    assert orbit.parameters == {"k": 1.0}


@pytest.mark.parametrize(
    ("spelled", "words"),
    [
        (
            lambda q, S: q[0] - S,
            "given a normalisation that fixes no amplitude of families; accepted: a quadratic",
        ),
        (lambda q, S: (q[0] - S) * (q[0] + S), "given a normalisation that fixes no amplitude"),
        (lambda q, S: ca.sin(q[0]) ** 2 - S, "given a normalisation that fixes no amplitude"),
        (
            lambda q, S: q[1] ** 2 - S,
            r"^normalisation: given a normalisation by which mode 2 of springs has no",
        ),
    ],
)
def test_normalisations_that_fix_no_amplitude(spelled: Callable[[ca.SX, ca.SX], ca.SX], words: str) -> None:
    with pytest.raises(ValueError, match=words) as error:
        follow_family(springs(spelled), 2, 0.5, parameters={"k": 1.0})
    assert "\n" not in str(error.value)


# Refusals -------------------------------------------------------------------------------------------------------------

Q, V, P, T = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("p"), ca.SX.sym("t")
ROUGH = -Q - ca.sqrt(ca.fabs(Q)) * Q
CUBIC = ca.vertcat(-Q[0], -2 * Q[1]) - Q**3
ONE_LINE = 300  # characters
KIND = "accepted for families: a model"
AT_REST = "pair: its families grow from rest at 0; accepted: forces that are finite and vanish there"


def pair(force: ca.SX, **changes: Any) -> OdeModel:
    """Two sites; reversible unless changed."""
    declared: dict[str, Any] = {"reversal": (1, 1, -1, -1), "nominal": (1.0,), "checked": False}
    return OdeModel("pair", Q, force, P, 2, V, **(declared | changes))


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (OdeModel("first", Q, ca.vertcat(Q[1], -Q[0])), f"{KIND} of second order, with positions as its state"),
        (pair(CUBIC + ca.cos(T), time=T, forcing_period=6.0), f"model: given pair; {KIND} without forcing"),
        (pair(CUBIC, reversal=None), f"{KIND} with a declared reversal that keeps positions and turns velocities"),
        (pair(CUBIC, half_period=(-1, 1, -1, 1)), f"{KIND} with half_period = -1 for every component, or none"),
        (pair(CUBIC + 0.1), AT_REST),
        (pair(ROUGH), "pair: the force on q_0 is not smooth at rest: its derivative by q_0 is not finite"),
        (pair(-Q - np.inf * Q**3), "pair: the force on q_0 is not finite at rest; accepted: forces that are finite"),
        (pair(CUBIC + ca.vertcat(2 * Q[0], 0)), "mode: mode 1 of pair does not oscillate: omega^2 = -1; accepted: a"),
        (pair(-Q - Q**3), "mode: modes 1, 2 of pair have the same frequency: no family belongs to one of them alone"),
        (pair(ca.vertcat(-Q[0] - Q[1], Q[0] - Q[1])), "j of a linear mode is complex; accepted: real ones"),
        (pair(CUBIC, nominal=None), "parameters: given none for p; accepted: a number for each, or nominal values"),
    ],
)
def test_models_without_families_are_refused_in_one_line(model: OdeModel, words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)) as error:
        family_request(model, 1, 1.0)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < ONE_LINE


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"parameters": {"k": 1.0}}, "parameters: given 'k'; accepted: p"),
        ({"mode": 3}, "mode: given 3; accepted: 1..2, first, last"),
        ({"tail": "full"}, "tail: given 'full'; accepted: with a chain alone"),
        ({"amplitude_max": -1.0}, "amplitude_max: given -1.0; accepted: a finite number > 0"),
        ({"intervals": 4}, "intervals: given 4; accepted for families: none, the tolerance decides"),
        ({"flow": "collocation"}, "flow: given 'collocation'; accepted: splitting, cvodes"),
        ({"walker": "series", "transcription": "gauss"}, 'walker: given "series"; accepted with gauss: arclength'),
        ({"period_max": 1.0}, "period_max: given 1.0; accepted: a finite number > 6.28318530718 (the period of linear"),
    ],
)
def test_options_that_families_do_not_have_are_refused_in_one_line(options: dict[str, Any], words: str) -> None:
    with pytest.raises((ValueError, TypeError), match=re.escape(words)) as error:
        family_request(**({"model": pair(CUBIC), "mode": 1, "amplitude_max": 1.0} | options))
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < ONE_LINE


def test_a_coupling_too_steep_for_doubles_is_refused() -> None:
    with pytest.raises(ValueError, match=r"positions whose scales differ by exp\(.*\); accepted: up to exp\(230\)"):
        family_request(chain_by_hand(200), 1, 1.0, parameters={"alpha": 1.0, "gamma": 0.9, "g": 1.0})


def test_what_rounding_leaves_at_rest_is_nothing() -> None:
    """0.1 + 0.2 - 0.3 is 6e-17: the family is that of the cubic spring all the same."""
    q = ca.SX.sym("q")
    branch = follow_family(second_order("rounded", q, -q - (0.1 + 0.2 - 0.3) - q**3), 1, 1.0, tolerance=1e-10)
    m = branch.S / (2 * (1 + branch.S))
    np.testing.assert_allclose(branch.Omega, np.pi * np.sqrt(1 + branch.S) / (2 * ellipk(m)), rtol=1e-10)


@pytest.mark.parametrize("unit", [1e-9, 1e6])
@pytest.mark.parametrize("polynomial", [True, False])
def test_positions_may_have_any_unit(unit: float, polynomial: bool) -> None:
    """The same oscillator, and its Omega to all digits that the tolerance asks for."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    soft = (lambda x: x - x**3 / 6) if polynomial else ca.sin
    plain = second_order("plain", q, -soft(q), velocity=v)
    scaled = second_order("scaled", q, -unit * soft(q / unit), velocity=v)
    S = np.array([0.3, 1.0])
    one = follow_family(plain, 1, 1.0, at=S, tolerance=1e-10, stability=True)
    other = follow_family(scaled, 1, unit**2, at=S * unit**2, tolerance=1e-10, stability=True)
    assert other.complete
    for here, there in zip(S, S * unit**2, strict=True):
        assert other.at(there).Omega == pytest.approx(one.at(here).Omega, rel=1e-12)
        assert other.at(there).profile[0] == pytest.approx(unit * np.sqrt(here), rel=1e-14)
        assert other.at(there).S_error == 0.0


# Along the branch -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def soft() -> Branch:
    """Pendulums: Omega falls along the family."""
    return follow_family(pendulums(3), 1, 6.0, at=(1.0,), tolerance=1e-9)


def test_a_family_ends_where_it_is_told_to(soft: Branch) -> None:
    seen: list[float] = []
    stopped = follow_family(
        pendulums(3), 1, 6.0, tolerance=1e-9, stability=True, until=lambda o: o.S > 0.5,
        progress=lambda o: seen.append(o.S),
    )  # fmt: skip
    assert stopped.complete
    assert stopped.reason == "stopped where the condition holds"
    assert stopped.orbits[-1].S > 0.5 >= stopped.orbits[-2].S
    assert seen == list(stopped.S)
    longest = soft.at(4.0).period
    ended = follow_family(pendulums(3), 1, 6.0, tolerance=1e-9, period_max=longest, at_period=(5.2,), at_Omega=(1.22,))
    assert ended.complete
    assert ended.orbits[-1].period == longest
    assert pytest.approx(4.0, rel=1e-6) == ended.orbits[-1].S
    assert 1.22 in ended.Omega
    assert 5.2 in ended.period
    beyond = follow_family(pendulums(3), 1, 1.0, tolerance=1e-9, at_period=(7.0,))
    assert not beyond.complete
    assert beyond.misses == {"period": (7.0,)}
    assert beyond.reason.startswith("no orbit was found at period = 7: the family was followed from ")


def test_a_fold_is_where_the_family_leaves_at_right_angles() -> None:
    """Beside a fold the start moves along the kernel of d(q(T/4))/d(q(0), T), which DOP853 knows as well."""
    values = {"alpha": 1.0, "gamma": 0.2, "g": -1.0}
    branch = follow_family(
        chain_by_hand(4), 1, 8.0, tolerance=1e-8, parameters=values, max_points=90, corrector="newton"
    )
    first = branch.special_points[0]
    assert first.kind == "fold"
    assert first.parameters["S"] == first.solution.S
    assert first.parameters["gamma"] == 0.2
    assert first.solution in branch.folds
    assert abs(first.solution.S - np.max(branch.S)) < 2e-2
    assert np.max(branch.S[: len(branch) // 2]) <= first.solution.S
    A = 1.2 * np.eye(4, k=-1) + 0.8 * np.eye(4, k=1) - 3 * np.eye(4)
    typed = Typed(lambda y: A @ y + y**3)
    start, orbit = np.append(first.solution.profile, np.zeros(4)), first.solution
    end, columns = typed.flow(start, orbit.period / 4, 4)
    np.testing.assert_allclose(end[:4], 0.0, atol=1e-7)
    system = np.column_stack([columns[:4], end[4:] / 4])
    along = np.linalg.svd(system)[2][-1][:4]
    assert abs(along @ start[:4]) / np.linalg.norm(along) / np.linalg.norm(start) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "mode", "name", "to"),
    [
        slow(Chain(3, 1.0, 0.1, -1.0), 1, "gamma", 0.4),
        slow(Chain(3, 1.0, 0.3, 1.0), 3, "g", 0.4),
        (fput(3), 2, "bond", 0.4),
        slow(pendulums(2), 2, "bond", 0.7),
    ],
)
def test_an_orbit_is_followed_in_a_parameter_of_its_model(
    model: Chain | OdeModel, mode: int, name: str, to: float
) -> None:
    S = 0.6
    orbit = follow_family(model, mode, S, at=(S,), tolerance=1e-9, corrector="newton").at(S)
    branch = orbit.follow(name, to, stability=True)
    assert branch.complete
    last = branch.orbits[-1]
    if isinstance(model, Chain):
        there = follow_family(replace(model, **{name: to}), mode, S, at=(S,), tolerance=1e-9).at(S)  # type: ignore[arg-type]
    else:
        there = follow_family(model, mode, S, at=(S,), tolerance=1e-9, parameters={name: to}).at(S)
    assert last.parameters[name] == to
    assert last.Omega == pytest.approx(there.Omega, rel=1e-8)
    assert pytest.approx(S, rel=1e-12) == last.S
    n = there.profile.size
    np.testing.assert_allclose(last.evaluate([0.3, 1.0])[:, :n], there.evaluate([0.3, 1.0]), atol=1e-7)
    assert [o.floquet().stable for o in (branch.orbits[0], last)] == [orbit.floquet().stable, there.floquet().stable]
    assert apart(last.floquet().others, there.floquet().others) < 1e-6


@pytest.mark.slow
def test_an_orbit_is_followed_in_its_amplitude_as_its_family_goes() -> None:
    for model, name in ((springs(), "S"), (springs(lambda q, S: q[0] ** 2 - S), "amplitude")):
        values = {"k": 1.0}
        family = follow_family(model, 1, 0.3, at=(0.2,), parameters=values, tolerance=1e-8, corrector="newton")
        last = family.at(0.2).follow(name, 0.3).orbits[-1]
        assert last.Omega == pytest.approx(family.at(0.3).Omega, rel=1e-8)
        assert pytest.approx(0.3, rel=1e-9) == last.S
    long = follow_family(Chain(10**5, 1.0, 0.5, 1.0), "last", 0.1, at=(0.1,), tolerance=1e-6).at(0.1)
    with pytest.raises(ValueError, match=r"^sites: given 100000; an orbit followed in a parameter is that of all"):
        long.follow("gamma", 0.4)
    with pytest.raises(ValueError, match=r"^parameter: given 'kk'; did you mean k\? accepted: k, amplitude"):
        family.at(0.2).follow("kk", 1.0)


# Changes of stability of other orbits ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_entrained_oscillator_loses_its_stability_to_a_torus() -> None:
    """Van der Pol's, driven: |multiplier|^2 = exp(mu int (1 - x^2)) by Liouville, 1 where the mean of x^2 is 1."""
    x, y, F, t = (ca.SX.sym(name) for name in ("x", "y", "F", "t"))
    rhs = ca.vertcat(y, 0.4 * (1 - x**2) * y - x + F * ca.cos(1.6 * t))
    model = OdeModel("driven", ca.vertcat(x, y), rhs, F, time=t, forcing_period=2 * np.pi / 1.6)
    large = find_orbit(
        model, lambda s: [-2 * np.cos(1.6 * s), 3.2 * np.sin(1.6 * s)], parameters={"F": 4.0}, tolerance=1e-9
    )
    branch = large.follow("F", 1.0, stability=True)
    (change,) = branch.changes
    assert change.kind == "complex"
    assert change.stable_before
    assert not change.stable_after
    assert change.error < 1e-5
    orbit = branch.at(change.value)
    square, _ = quad(lambda s: orbit.evaluate(s)[0] ** 2, 0.0, orbit.period, epsabs=1e-11)
    assert square / orbit.period == pytest.approx(1.0, abs=1e-6)
    assert abs(orbit.floquet().multipliers[0].imag) > 0.1
