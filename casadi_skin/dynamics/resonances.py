"""Driven and damped lattices beside their conservative families: energy balance, and where responses cross these.

With weak damping and drive a response lies near an orbit of the conservative lattice on which the drive, at its best
phase, gives as much energy in a period as the damping takes. Where the most that it can give crosses what is lost,
drive and velocity are in quadrature (phase resonance): a curve of responses passes there. The second, third, ...
crossing of one family may lie on closed curves apart from the others, isolas, which no frequency sweep meets
(Hill, Neild and Cammarano 2016; Cenedese and Haller 2020).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import brentq

from casadi_skin.follow.family import Family
from casadi_skin.follow.find import find_orbit
from casadi_skin.follow.follow import follow_family
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.declaration import Array
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.linear import ComplexArray
from casadi_skin.model.arguments import check_instance, check_name
from casadi_skin.model.result import in_turn
from casadi_skin.points.gradient import Gradient
from casadi_skin.solve.watch import one_thread
from casadi_skin.zero.family import family_request
from casadi_skin.zero.settings import Point

SAMPLES_PER_PERIOD = 512  # a period
GUESS_HARMONICS = 48  # of a guess
CROSSING_S_RTOL = 1e-10  # relative accuracy of S at a crossing


@dataclass(frozen=True)
class EnergyBalance:
    """Energy that a period brings, with the weights of the gauge where there is one: `work` of drives minus `loss`.

    In a periodic response of a lattice with a gauge both are equal.
    """

    work: float
    loss: float


@dataclass(frozen=True, eq=False)
class Resonance:
    """An orbit of the conservative lattice on which the drive can just make up for the damping.

    Attributes:
        lattice: the damped and driven lattice.
        parameters: values of its parameters, the frequency's among them.
        S, Omega: of the conservative orbit.
        orbit: the conservative orbit.
        delay: time by which it comes after the phase at which the drive gives most.
        rising: whether the drive's best gains on the loss as S grows.
    """

    lattice: Lattice
    parameters: dict[str, float]
    S: float
    Omega: float
    orbit: Orbit
    delay: float
    rising: bool

    def guess(self, t: float) -> Array:
        """State at a time, positions and velocities, shape (components,): a guess for `find_orbit`."""
        waves = np.exp(1j * self.Omega * np.arange(len(self._series)) * (t - self.delay))
        rates = 1j * self.Omega * np.arange(len(self._series))
        return np.concatenate([(waves @ self._series).real, ((waves * rates) @ self._series).real])

    @cached_property
    def _series(self) -> ComplexArray:
        """Fourier coefficients of the positions, shape (harmonics, sites)."""
        return np.asarray(_series(self.orbit)[:GUESS_HARMONICS])

    def response(self, **options: Any) -> Orbit:
        """The response of the damped and driven lattice near the conservative orbit; options as for `find_orbit`."""
        return find_orbit(self.lattice, self.guess, parameters=self.parameters, **options)


@in_turn
def conservative_part(lattice: Lattice) -> Lattice:
    """The same lattice without damping and drives."""
    check_instance("lattice", lattice, Lattice)
    declared = lattice.declaration
    sites = [replace(site, damping="0", drive="0") for site in declared.sites]
    return Lattice(declared.cells, sites, declared.bonds, declared.boundary, declared.parameters, lattice.name)


@in_turn
def energy_balance(lattice: Lattice, orbit: Orbit) -> EnergyBalance:
    """Energy that drives supply and damping takes in one period.

    Arguments:
        lattice: damped and driven.
        orbit: a response of it, or an orbit of its conservative part.

    Returns:
        Work and loss.

    Raises:
        ValueError: the model of the orbit has other components.
    """
    check_instance("lattice", lattice, Lattice)
    check_instance("orbit", orbit, Orbit)
    drive, damping, v = _weighted_forces(lattice, orbit, orbit.parameters)
    power = [float(np.mean((force * v).sum(axis=1))) for force in (drive, damping)]
    return EnergyBalance(orbit.period * power[0], orbit.period * power[1])


@in_turn
def resonances(
    lattice: Lattice, mode: int | str, amplitude_max: float, frequency: str, **options: Any
) -> tuple[Resonance, ...]:
    """Orbits of a conservative family that curves of responses cross; later ones may lie on isolas.

    Arguments:
        lattice: damped and driven.
        mode: linear mode of its conservative part, by ascending frequency.
        amplitude_max: largest S of the family.
        frequency: name of the parameter that is the frequency of the drives.
        options: as for `follow_family`.

    Returns:
        The crossings in the order of the family.

    Raises:
        ValueError: the lattice has no drive or no damping, or its conservative part no such family.
    """
    check_instance("lattice", lattice, Lattice)
    check_name("frequency", frequency, tuple(lattice.declaration.scalars))
    if not (lattice.equations.damped and lattice.equations.driven):
        raise ValueError("lattice: given one without damping or without a drive; accepted: with both")
    branch = follow_family(conservative_part(lattice), mode=mode, amplitude_max=amplitude_max, **options)
    known = [_excess(lattice, frequency, orbit) for orbit in branch.orbits]
    found = []
    for k in range(1, len(known)):
        if known[k - 1][0] * known[k][0] < 0.0:
            low, high = branch.S[k - 1], branch.S[k]

            def excess(S: float) -> float:
                return _excess(lattice, frequency, branch.at(S=S))[0]

            S = float(brentq(excess, low, high, rtol=CROSSING_S_RTOL)) if low != high else float(low)
            orbit = branch.at(S=S)
            parameters = {**lattice.declaration.scalars, frequency: orbit.Omega}
            delay = _excess(lattice, frequency, orbit)[1]
            found.append(Resonance(lattice, parameters, S, orbit.Omega, orbit, delay, known[k][0] > known[k - 1][0]))
    return tuple(found)


def _times(orbit: Orbit) -> Array:
    return np.asarray(orbit.period * np.arange(SAMPLES_PER_PERIOD) / SAMPLES_PER_PERIOD)


def _series(orbit: Orbit) -> ComplexArray:
    """Coefficients of e^(i k Omega t), k >= 0, of which the real part is the positions, shape (harmonics, sites)."""
    series = np.fft.rfft(orbit.evaluate(_times(orbit)), axis=0) / SAMPLES_PER_PERIOD
    return np.asarray(np.where(np.arange(len(series))[:, None] == 0, 1.0, 2.0) * series)


def _weighted_forces(lattice: Lattice, orbit: Orbit, parameters: Mapping[str, float]) -> tuple[Array, Array, Array]:
    """Drives and damping forces over a period, with the weights of the gauge, 1 without one, and velocities.

    Shape (times, sites) each.
    """
    sites, times, equations = lattice.declaration.size, _times(orbit), lattice.equations
    states = np.atleast_2d(orbit.evaluate(times))
    if states.shape[1] not in (sites, 2 * sites):
        raise ValueError(f"orbit: given one of {states.shape[1]} components; accepted: {sites} or {2 * sites}")
    y, v = states[:, :sites], states[:, sites:]
    if not v.size:
        series = _series(orbit)
        rates = 1j * orbit.Omega * np.arange(len(series))
        v = (np.exp(np.outer(times, rates)) @ (rates[:, None] * series)).real
    known = {**lattice.declaration.scalars, **parameters}
    values = np.tile([[known[name]] for name in lattice.declaration.scalars], times.size)
    forces = [ca.densify(equations.of_sites("drive")), ca.densify(equations.of_sites("damping") * equations.v)]
    symbols = [equations.t, equations.y, equations.v, equations.parameters]
    drive, damping = ca.Function("forces", symbols, forces).map(times.size)(times[None], y.T, v.T, values)
    logs = lattice.structure.log_weights
    weights = np.ones(sites) if logs is None else np.exp(logs)
    return weights * np.array(drive).T, weights * np.array(damping).T, v


def _excess(lattice: Lattice, frequency: str, orbit: Orbit) -> tuple[float, float]:
    """The most that the drives can give in a period minus the loss, over the loss; and the delay of the orbit there."""
    drive, damping, v = _weighted_forces(lattice, orbit, {frequency: orbit.Omega})
    loss = float(np.mean((damping * v).sum(axis=1)))
    spectra = np.fft.fft(drive, axis=0) * np.fft.fft(v, axis=0).conj()
    work = np.fft.ifft(spectra.sum(axis=1)).real / SAMPLES_PER_PERIOD  # by delay
    best = int(np.argmax(work))
    before, here, after = work[best - 1], work[best], work[(best + 1) % SAMPLES_PER_PERIOD]
    bend = before - 2.0 * here + after
    shift = 0.5 * (before - after) / bend if bend else 0.0
    most = here - 0.25 * (before - after) * shift
    return (most - loss) / abs(loss), (best + shift) * orbit.period / SAMPLES_PER_PERIOD


# The threshold of the end breather of a long chain: the amplitude at which its frequency leaves the band --------------

BALANCE_TOLERANCE = 1e-12
LARGEST_S = 1e4  # up to which a threshold is looked for
COMPLEX_STEP = 1e-30  # imaginary: derivatives without subtraction
# Sites and harmonics beyond those of an orbit at a threshold, and times what they change in derivatives: their error.
MORE_TERMS, MORE_TERMS_SAFETY = 4, 8.0


@in_turn
def threshold(chain: Chain) -> float:
    """S_c at which the end breather of the infinite chain is born: Omega leaves the band edge that it was pinned to.

    Depends on alpha, gamma and g alone. Raises ValueError where there is no such family (see `chain_coordinates`), and
    ArithmeticError where it is not found.
    """
    coordinates, point = _born(chain)
    return float(coordinates.S_of(point.parameter))


@in_turn
def threshold_gradient(chain: Chain) -> Gradient:
    """The derivatives of the threshold by alpha, gamma and g, with their errors.

    It is proportional to 1/|g|. With alpha and gamma it solves F(x, alpha, gamma) = 0 of `_balance`: dx = -F_x^-1 F_p.
    The errors are what more sites and harmonics change, as a sample of rounding too.

    Returns:
        {parameter: derivative} with `errors`.

    Raises:
        ValueError, ArithmeticError: as `threshold`.
    """
    coordinates, point = _born(chain)
    S, found = float(coordinates.S_of(point.parameter)), []
    y = coordinates.scale[:, None] * point.problem.coefficients(point.z)
    y = np.sqrt(S) / np.linalg.norm(np.sum(y, axis=1)) * (y[::-1] if coordinates.lattice.at_last else y)
    p = np.array([chain.alpha, -abs(chain.gamma)])
    for more in (0, MORE_TERMS):
        terms = np.pad(y, (0, more))
        x, shape = np.append(terms.ravel(), S), terms.shape
        for _ in range(2):  # of Newton's method, and quadratic
            F_x = _slopes(partial(_balance, g=chain.g, shape=shape, p=p), x)
            x = x - np.linalg.solve(F_x, _balance(x, p, chain.g, shape))
        F_p = _slopes(partial(_balance, x, g=chain.g, shape=shape), p)
        found.append(-np.linalg.solve(F_x, F_p)[-1])
    by_alpha, by_gamma = found[1] * [1.0, -math.copysign(1.0, chain.gamma)]
    slopes = {"alpha": float(by_alpha), "gamma": float(by_gamma), "g": -S / chain.g}
    off = MORE_TERMS_SAFETY * np.abs(found[1] - found[0]) + BALANCE_TOLERANCE * S
    errors = {"alpha": float(off[0]), "gamma": float(off[1]), "g": BALANCE_TOLERANCE * S / abs(chain.g)}
    return Gradient("S at the threshold", S, slopes, errors, "all other parameters")


def _balance(x: ComplexArray | Array, p: ComplexArray | Array, g: float, shape: tuple[int, int]) -> Any:
    """The equations of an endless chain of gamma < 0 whose breather is born, Omega at an edge of the band.

    For y_n = sum_k a_nk cos(k Omega t), k odd, of sites from the edge on, as far as forces are nonlinear:

        (2 + alpha - k^2 Omega^2) a_n - (1 + gamma) a_(n-1) - (1 - gamma) a_(n+1) + g (y_n^3)_k = 0,  S = sum y_n(0)^2,

    with Omega^2 = 2 + alpha + 2 s sign(g) and s^2 = 1 - gamma^2. Beyond, amplitudes in the gauge fall by beta a site,
    s (beta + 1/beta) = 2 + alpha - k^2 Omega^2; those of k = 1 stay the same, but for their sign.

    Arguments:
        x: the a_nk and S, shape (sites harmonics + 1,).
        p: alpha and gamma.
        shape: (sites, harmonics).
    """
    (alpha, gamma), a, k, side = p, x[:-1].reshape(shape), 2.0 * np.arange(shape[1]) + 1.0, math.copysign(1.0, g)
    s, phases = np.sqrt(1.0 - gamma**2), 0.25 * np.pi * (np.arange(2 * k.size) + 0.5) / k.size
    apart = 2.0 + alpha - k**2 * (2.0 + alpha + 2.0 * s * side)
    middle = 0.5 * apart[1:] / s
    beta = np.append(-side, 1.0 / (middle - np.sqrt(middle**2 - 1.0)))
    beyond = np.sqrt((1.0 + gamma) / (1.0 - gamma)) * beta * a[-1:]
    waves = np.cos(np.outer(k, phases))
    forces = apart * a + g * (a @ waves) ** 3 @ waves.T / k.size
    forces = forces - (1.0 + gamma) * np.vstack([0.0 * beyond, a[:-1]]) - (1.0 - gamma) * np.vstack([a[1:], beyond])
    return np.append(forces.ravel(), np.sum(np.sum(a, axis=1) ** 2) - x[-1])


def _slopes(function: Callable[[ComplexArray], ComplexArray], x: Array) -> Array:
    """Derivatives by all variables."""
    return np.stack([function(x + 1j * COMPLEX_STEP * e).imag / COMPLEX_STEP for e in np.eye(x.size)], axis=1)


def _born(chain: Chain) -> tuple[Any, Point]:
    """The coordinates of a family of the infinite chain, and its orbit at the threshold."""
    if chain.g == 0:
        raise ValueError("g: given 0; accepted: not 0 (frequencies of a linear chain do not move)")
    amplitude_max = 1.0
    while amplitude_max <= LARGEST_S:
        found = _born_below(chain, amplitude_max / abs(chain.g))
        if found is not None:
            return found
        amplitude_max *= 10.0
    raise ArithmeticError(f"threshold: the frequency does not leave the band up to |g| S = {LARGEST_S:g}")


def _born_below(chain: Chain, amplitude_max: float) -> tuple[Any, Point] | None:
    """The same, or None where S_c is not below `amplitude_max`."""
    infinite = replace(chain, sites=math.inf)  # type: ignore[arg-type]
    mode = infinite.mode_number("last" if chain.g > 0 else "first")
    family = Family(family_request(infinite, mode, amplitude_max, tolerance=BALANCE_TOLERANCE, corrector="newton"))
    last = family.start
    coordinates: Any = family.coordinates  # of a core with its tail
    edge = replace(coordinates.edge_mode.place, off=0.0)
    born = coordinates.parameter(2).at(coordinates.tail.angle(edge))
    with one_thread():
        for point in family.continuation((family.start,)):
            if point.walked and (point.z[point.problem.Omega_index] - born) * (coordinates.start_unknown - born) < 0.0:
                return coordinates, _held(family, last, point, born)
            last = point if point.walked else last
    return None


def _held(family: Family, before: Point, after: Point, u: float) -> Point:
    """Where the parameter of the tail is u, between two points; ArithmeticError where it is not found."""
    problem, point_solver = after.problem, family.point_solver
    curve, length = point_solver.curve(before, after)
    ((place, _),) = curve.crossings(problem.Omega_index, [u])
    row = np.zeros(problem.size)
    row[problem.Omega_index] = sense = 1.0 if after.z[problem.Omega_index] > u else -1.0  # in which u changes
    correction = point_solver.correct(problem, curve.at(place), row, sense * u, length)
    point = None if correction is None else point_solver.refined(problem, correction, row, held=None)
    if point is None:
        raise ArithmeticError("threshold: no orbit is found where the frequency leaves the band")
    return point
