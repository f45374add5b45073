"""What becomes of multipliers and frequencies in physical coordinates, against the same computation in the gauge.

Both sides take the same orbit, the same steps and the same eigenvalue routine; the coordinates alone differ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.trigonometric import cosine_matrix, second_derivative_matrix
from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.follow import follow_family
from casadi_skin.orbits.orbit import Orbit

RELATIVE = 1e-12  # local tolerance of DOP853
HARMONICS = 6  # of the orbit that is found the usual way
AMPLITUDES = 4  # steps in S to it
ITERATIONS = 30
GAMMAS = (0.1, 0.25, 0.5, 0.7)
SIZES = (4, 8, 12, 16, 24, 32, 40, 48, 60, 80)
QUICK_SIZES = (4, 12, 24, 48)
AMPLITUDE = 0.05
EPSILON = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Comparison:
    """Errors of one chain in physical coordinates and in the gauge, each computed in the same way.

    `multiplier_*`: distance of the largest |multiplier| of a stable orbit from 1; `mu_error` is what the package
    estimates of that orbit. `frequency_*`: largest relative error of a linear frequency. `orbit_*`: the largest
    relative error of Omega of three orbits at the same S, found from computed linear modes (first, middle, last);
    infinite where one is not found. `law` is
    0.1 eps r^((N-1)/2).
    """

    sites: int
    gamma: float
    S: float
    Omega: float
    law: float
    multiplier_physical: float
    multiplier_gauge: float
    mu_error: float
    frequency_physical: float
    frequency_gauge: float
    orbit_physical: float
    orbit_gauge: float


@dataclass(frozen=True)
class _Equations:
    """x'' = -D x - g w x^3, with x the displacements, or those of the gauge."""

    chain: Chain
    physical: bool

    @property
    def below(self) -> float:
        """Coupling to the site before."""
        return 1.0 + self.chain.gamma if self.physical else self.chain.coupling

    @property
    def above(self) -> float:
        """Coupling to the site behind."""
        return 1.0 - self.chain.gamma if self.physical else self.chain.coupling

    @property
    def scale(self) -> Array:
        """Displacements over x, shape (sites,)."""
        return np.ones(self.chain.sites) if self.physical else self.chain.rho

    @property
    def matrix(self) -> Array:
        """D, dense."""
        n = self.chain.sites
        return np.asarray(
            (2.0 + self.chain.alpha) * np.eye(n) - self.below * np.eye(n, k=-1) - self.above * np.eye(n, k=1)
        )


def compare(sites: int, gamma: float) -> Comparison | None:
    """The comparison for mode 1 with g = -1 at a small S, or None where that orbit is not stable."""
    chain = Chain(sites, 1.0, gamma, -1.0)
    found = [_orbit(chain, mode) for mode in (1, sites // 2, sites)]
    orbit = found[0]
    known = orbit.floquet()
    if not known.stable:
        return None
    law = 0.1 * EPSILON * float(np.exp((sites - 1) * np.arctanh(gamma)))
    errors: dict[str, float] = {}
    for label, equations in (("physical", _Equations(chain, True)), ("gauge", _Equations(chain, False))):
        errors[f"multiplier_{label}"] = _off_the_circle(orbit, equations)
        errors[f"frequency_{label}"] = _frequency_error(equations, chain.linear_frequencies())
        errors[f"orbit_{label}"] = max(_orbit_error(each, equations) for each in found)
    return Comparison(sites, gamma, orbit.S, orbit.Omega, law, mu_error=known.error, **errors)


def _orbit(chain: Chain, mode: int) -> Orbit:
    return follow_family(chain, mode, AMPLITUDE, at=(AMPLITUDE,), tolerance=1e-12, corrector="newton").at(S=AMPLITUDE)


def _frequency_error(equations: _Equations, exact: Array) -> float:
    """Largest distance of a computed frequency from that of its rank, over the largest frequency."""
    found = np.sqrt(np.linalg.eigvals(equations.matrix).astype(complex))
    found = found[np.argsort(found.real)]
    return float(np.max(np.abs(found - exact)) / np.max(exact))


def _off_the_circle(orbit: Orbit, equations: _Equations) -> float:
    """Distance of the largest |multiplier| from 1, which it is for a stable orbit; the two nearest 1 left out."""
    from scipy.integrate import solve_ivp

    chain, n = orbit.model, orbit.model.sites

    def rates(t: float, flat: Array) -> Array:
        x, v = flat.reshape(2, n, 2 * n)
        force = -(2.0 + chain.alpha + 3.0 * chain.g * orbit.evaluate(t)[0][:, None] ** 2) * x
        force[1:] += equations.below * x[:-1]
        force[:-1] += equations.above * x[1:]
        return np.concatenate([v.ravel(), force.ravel()])

    start = np.eye(2 * n).ravel()
    found = solve_ivp(rates, (0.0, orbit.period), start, "DOP853", rtol=RELATIVE, atol=RELATIVE)
    values = np.linalg.eigvals(found.y[:, -1].reshape(2 * n, 2 * n))
    rest = values[np.argsort(np.abs(values - 1.0))[2:]]
    return float(abs(np.max(np.abs(rest)) - 1.0))


# Orbits the usual way -----------------------------------------------------------------------------------------------


def _orbit_error(orbit: Orbit, equations: _Equations) -> float:
    """Relative error of Omega of the orbit that Newton's method finds, in steps of S from the computed linear mode."""
    values, vectors = np.linalg.eig(equations.matrix)
    place = int(np.argsort(values.real)[orbit.space.coordinates.mode_number - 1])
    mode = np.real(vectors[:, place])
    mode = mode / np.linalg.norm(equations.scale * mode)
    V = cosine_matrix(HARMONICS)
    x, Omega = np.outer(mode, V[:, 0]), float(np.sqrt(abs(values[place].real)))
    for S in orbit.S * np.linspace(1.0 / AMPLITUDES, 1.0, AMPLITUDES):
        x *= np.sqrt(S) / np.linalg.norm(equations.scale * (x @ V).sum(axis=1) * 2.0 / HARMONICS)
        try:
            x, Omega = _newton(equations, float(S), x, Omega)
        except np.linalg.LinAlgError:
            return math.inf
        if not math.isfinite(Omega):
            return math.inf
    return abs(abs(Omega) - orbit.Omega) / orbit.Omega


def _newton(equations: _Equations, S: float, x: Array, Omega: float) -> tuple[Array, float]:
    """Node values (sites, harmonics) and Omega at S; Omega is NaN where the method does not converge."""
    chain, H, D = equations.chain, HARMONICS, equations.matrix
    second, at_zero = second_derivative_matrix(H), (2.0 / H) * cosine_matrix(H).sum(axis=0)
    w, linear = equations.scale[:, None] ** 2, np.kron(D, np.eye(H))
    for _ in range(ITERATIONS):
        start = x @ at_zero
        residual = Omega**2 * x @ second.T + D @ x + chain.g * w * x**3
        J = np.kron(np.eye(chain.sites), Omega**2 * second) + linear + np.diag((3.0 * chain.g * w * x**2).ravel())
        column = (2.0 * Omega * x @ second.T).reshape(-1, 1)
        row = np.outer(2.0 * w[:, 0] * start, at_zero).reshape(1, -1)
        right = np.append(residual.ravel(), w[:, 0] @ start**2 - S)
        step = np.linalg.solve(np.block([[J, column], [row, np.zeros((1, 1))]]), right)
        x, Omega = x - step[:-1].reshape(x.shape), Omega - float(step[-1])
        if not np.all(np.isfinite(step)):
            break
        if np.max(np.abs(step[:-1])) <= 1e-12 * np.max(np.abs(x)) and abs(step[-1]) <= 1e-13 * abs(Omega):
            return x, Omega
    return x, math.nan
