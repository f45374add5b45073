"""Time evolution of the chain from any start, and of a perturbed orbit (paper, Sec. III and Fig. 6); dimensionless.

The equations are integrated in the gauge y_n = rho_n eta_n, where the flow is Hamiltonian: in physical coordinates an
error at the far end is amplified by r^((N-1)/2) on its way to the edge that the modes lean to.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.integrators.cvodes import cvodes
from casadi_skin.integrators.dop853 import dop853
from casadi_skin.integrators.splitting import symplectic
from casadi_skin.integrators.trajectory import IntegrationError, Integrator, Trajectory
from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.theory.linear import Array

METHODS = ("cvodes", "dop853", "symplectic")
COORDINATES = ("gauge", "physical")
LONGEST_ENVELOPE = 700.0  # of -log rho: beyond, displacements at the far end are below the smallest double


@dataclass(frozen=True, eq=False)
class Evolution:
    """Displacements and velocities in physical coordinates, shape (time, site), at the times t.

    `method`, `tolerance` and `coordinates` tell how they were computed, with `evaluations` of the forces, and with a
    fixed `step` where the method has one.
    """

    chain: Chain
    t: Array
    displacements: Array
    velocities: Array
    method: str
    tolerance: float
    coordinates: str
    evaluations: int
    step: float | None = None

    @cached_property
    def energy(self) -> Array:
        """Hamiltonian of the gauge with rho = 1 at the edge that the modes lean to, shape (time,).

        Raises ValueError at |gamma| = 1 where sites off that edge move, which have no image in the gauge.
        """
        model = self.chain.gauge_model()
        hamiltonian = ca.Function("H", [model.state, model.velocity, model.parameters], [model.hamiltonian])
        eta, velocity = (_to_gauge(self.chain, x, "energy") for x in (self.displacements, self.velocities))
        return np.array(hamiltonian(eta.T, velocity.T, self.chain.g), dtype=float).ravel()

    @property
    def energy_drift(self) -> Array:
        """H(t) - H(first t), which the equations keep at 0, relative to |H(first t)|, shape (time,).

        It is relative to the largest kinetic energy where that is larger, as beside negative potential energies. Raises
        ValueError where `energy` does.
        """
        energy = self.energy
        kinetic = 0.5 * np.sum(_to_gauge(self.chain, self.velocities, "energy") ** 2, axis=1)
        return np.asarray((energy - energy[0]) / (max(abs(energy[0]), kinetic.max()) or 1.0))

    @property
    def status(self) -> str:
        """What was computed, how, and how well the energy was kept, in a sentence."""
        words = f"{self.method} in {self.coordinates} coordinates, tolerance {self.tolerance:.3g}"
        if self.step is not None:
            words += f", step {self.step:.4g}"
        words += f": t = {self.t[-1]:.6g} reached with {self.evaluations} evaluations"
        if self.coordinates == "gauge":
            words += f", energy kept to {np.abs(self.energy_drift).max():.1e}"
        return words


class EvolutionError(ArithmeticError):
    """A time evolution that could not be followed to its end: the message tells how far and why in one line.

    `evolution` is what was computed before, None where that is nothing.
    """

    def __init__(self, message: str, evolution: Evolution | None) -> None:
        super().__init__(message)
        self.evolution = evolution


def evolve(
    chain: Chain,
    positions: ArrayLike,
    velocities: ArrayLike | None,
    t: ArrayLike,
    method: str = "cvodes",
    tolerance: float = 1e-11,
    coordinates: str = "gauge",
    *,
    step: float | None = None,
) -> Evolution:
    """Solve the equations of motion (paper, Eq. 1) from displacements and velocities, shape (site,), at time 0.

    `t` holds the wanted times, ascending from 0 on; velocities None are zero. Methods: "cvodes" (SUNDIALS, Adams),
    "dop853" (the paper's), "symplectic" (order 6; for long runs: the energy oscillates and does not drift), whose
    fixed `step` follows from the tolerance unless given. `tolerance` is that of one step relative to the largest
    component of the start. Works at |gamma| = 1 in "physical" coordinates, or where the edge site alone moves. Raises
    ValueError for arguments out of range and EvolutionError where the integrator fails.
    """
    _check_choices(method, tolerance, coordinates, step)
    times, wanted = _times(t), chain.sites
    y = _vector("positions", positions, wanted)
    v = np.zeros(wanted) if velocities is None else _vector("velocities", velocities, wanted)
    if coordinates == "gauge":
        _check_envelope(chain)
        model, scale = chain.gauge_model(), chain.rho
        y, v = _to_gauge(chain, y, "positions"), _to_gauge(chain, v, "velocities")
    else:
        model, scale = chain.physical_model(), np.ones(wanted)
    start, later = np.concatenate([y, v]), times[times > 0]
    trajectory, failure = Trajectory(np.empty((0, 2 * wanted)), 0, step), None
    try:
        if later.size:
            parameters = np.array([chain.g], dtype=float)
            trajectory = _integrator(method, step)(model, parameters, start, later, tolerance)
    except IntegrationError as error:
        trajectory, failure = error.trajectory, error
    states = np.vstack([start[None]] * int(times[0] == 0) + [trajectory.states])
    displacements, rates = scale * states[:, :wanted], scale * states[:, wanted:]
    how = (method, tolerance, coordinates, trajectory.evaluations, trajectory.step)
    evolution = Evolution(chain, times[: len(states)], displacements, rates, *how)
    if failure is not None:
        escape = "; with g < 0 a large displacement leaves the well and runs to infinity in finite time"
        message = f"{failure}{escape if chain.g < 0 else ''}"
        raise EvolutionError(message, evolution if len(states) else None) from failure
    return evolution


def perturbed(
    orbit: Orbit,
    size: float,
    *,
    site: int | None = None,
    vector: ArrayLike | None = None,
    seed: int | None = None,
) -> tuple[Array, Array]:
    """Displacements and velocities, shape (site,) each, of the orbit at t = 0 plus `size` times a unit perturbation.

    The perturbation (paper, Fig. 6: size 0.005 at site 24 or 1) is one of: a displacement of one `site`, counted from
    1; a `vector` of N displacements or of these and N velocities, scaled to norm 1; random displacements of a `seed`,
    normally distributed and scaled to norm 1. Raises ValueError for other arguments.
    """
    sites = orbit.model.sites
    if not np.isfinite(size):
        raise ValueError(f"size: given {size!r}; accepted: a finite number")
    given = [name for name, value in (("site", site), ("vector", vector), ("seed", seed)) if value is not None]
    if len(given) != 1:
        raise ValueError(f"perturbation: given {' and '.join(given) or 'none'}; accepted: one of site, vector, seed")
    z = np.zeros(2 * sites)
    if site is not None:
        if not isinstance(site, int | np.integer) or not 1 <= site <= sites:
            raise ValueError(f"site: given {site!r}; accepted: 1..{sites}")
        z[site - 1] = 1.0
    elif vector is not None:
        direction = _vector("vector", vector, sites, 2 * sites)
        z[: direction.size] = direction
    else:
        z[:sites] = np.random.default_rng(seed).normal(size=sites)
    largest = np.abs(z).max()
    if largest == 0:
        raise ValueError("vector: given zeros; accepted: a vector with a direction")
    z /= largest * np.linalg.norm(z / largest)
    return orbit.profile + size * z[:sites], size * z[sites:]


def simulate_orbit(
    orbit: Orbit,
    t: ArrayLike,
    size: float = 0.0,
    *,
    site: int | None = None,
    vector: ArrayLike | None = None,
    seed: int | None = None,
    method: str = "cvodes",
    tolerance: float = 1e-11,
    coordinates: str = "gauge",
) -> Evolution:
    """Evolve an orbit from its phase zero, perturbed as by `perturbed` where a perturbation is given.

    Raises ValueError for arguments out of range and EvolutionError where the integrator fails.
    """
    start = (orbit.profile, np.zeros(orbit.model.sites))
    if size != 0 or site is not None or vector is not None or seed is not None:
        start = perturbed(orbit, size, site=site, vector=vector, seed=seed)
    return evolve(orbit.model, *start, t, method, tolerance, coordinates)


class CosineSeries(Protocol):
    """What a distance from an orbit asks of it, as an `Orbit` has it, or what was kept of one."""

    @property
    def S(self) -> float: ...
    @property
    def Omega(self) -> float: ...
    @property
    def harmonics(self) -> int: ...
    def coefficients(self, harmonics: int) -> Array: ...


def distance_from_orbit(orbit: CosineSeries, evolution: Evolution) -> Array:
    """Distance of (y, y'/Omega) to the nearest point of the orbit, relative to ||y(0)|| of the orbit, shape (time,).

    The nearest phase is sought among 128 and refined by Gauss-Newton steps; a shift of phase alone has no distance.
    """
    harmonics = orbit.harmonics
    order = 2 * np.arange(harmonics) + 1
    c = orbit.coefficients(harmonics)

    def points(theta: Array) -> tuple[Array, Array]:
        """Points (y, y'/Omega) of the orbit and their derivatives by the phase, shape (len(theta), 2N) each."""
        cosine, sine = np.cos(np.outer(theta, order)), np.sin(np.outer(theta, order))
        y, dy, ddy = cosine @ c, -(sine * order) @ c, -(cosine * order**2) @ c
        return np.hstack([y, dy]), np.hstack([dy, ddy])

    states = np.hstack([evolution.displacements, evolution.velocities / orbit.Omega])
    phases = 2.0 * np.pi * np.arange(128) / 128
    coarse, _ = points(phases)
    theta = phases[np.argmax(states @ coarse.T - 0.5 * np.sum(coarse**2, axis=1), axis=1)]
    nearest = np.full(len(states), np.inf)
    for _ in range(6):
        point, tangent = points(theta)
        nearest = np.minimum(nearest, np.linalg.norm(states - point, axis=1))
        move = np.sum((states - point) * tangent, axis=1) / np.sum(tangent**2, axis=1)
        theta = theta + np.clip(move, -np.pi / 128, np.pi / 128)
    return np.asarray(nearest / np.sqrt(orbit.S))


# Arguments ----------------------------------------------------------------------------------------------------------


def _check_choices(method: str, tolerance: float, coordinates: str, step: float | None) -> None:
    for name, value, accepted in (("method", method, METHODS), ("coordinates", coordinates, COORDINATES)):
        if value not in accepted:
            raise ValueError(f"{name}: given {value!r}; accepted: {', '.join(accepted)}")
    if not 1e-13 <= tolerance <= 1e-2:
        raise ValueError(f"tolerance: given {tolerance!r}; accepted: 1e-13 to 1e-2")
    if step is not None and method != "symplectic":
        raise ValueError(f"step: given {step!r} with {method}; accepted: with symplectic, whose step is fixed")
    if step is not None and not (np.isfinite(step) and step > 0):
        raise ValueError(f"step: given {step!r}; accepted: a finite number > 0")


def _times(t: ArrayLike) -> Array:
    times = np.atleast_1d(np.asarray(t, dtype=float))
    if times.ndim != 1 or times.size == 0:
        raise ValueError(f"t: given shape {times.shape}; accepted: one or more times")
    if not np.all(np.isfinite(times)) or times[0] < 0 or np.any(np.diff(times) <= 0):
        raise ValueError("t: given times that are not finite, not ascending or negative; accepted: ascending from 0 on")
    return times


def _vector(name: str, given: ArrayLike, *sizes: int) -> Array:
    vector = np.array(given, dtype=float)
    if vector.shape not in [(size,) for size in sizes]:
        accepted = " or ".join(f"({size},)" for size in sizes)
        raise ValueError(f"{name}: given shape {vector.shape}; accepted: shape {accepted}")
    if not np.all(np.isfinite(vector)):
        raise ValueError(f"{name}: given a value that is not finite at site {np.argmin(np.isfinite(vector)) + 1}")
    return vector


def _check_envelope(chain: Chain) -> None:
    if abs(chain.gamma) < 1 and -chain.log_rho.min() > LONGEST_ENVELOPE:
        raise ValueError(
            f"coordinates: given gauge with N = {chain.sites}, gamma = {chain.gamma!r}, whose envelope spans "
            f"exp({chain.log_rho.min():.4g}); accepted: (N - 1) artanh|gamma| <= {LONGEST_ENVELOPE:g}, or physical"
        )


def _to_gauge(chain: Chain, x: Array, name: str) -> Array:
    """eta = x/rho, last axis the site; raises ValueError where a site that moves has no image."""
    with np.errstate(divide="ignore", invalid="ignore"):
        eta = np.where(x == 0, 0.0, x / chain.rho)
    if not np.all(np.isfinite(eta)):
        raise ValueError(
            f"{name}: at |gamma| = 1 a site off the edge that the modes lean to has no image in the gauge; accepted: "
            'zero there, or coordinates = "physical", where no energy is kept'
        )
    return np.asarray(eta)


def _integrator(method: str, step: float | None) -> Integrator:
    if method == "symplectic":
        return partial(symplectic, step=step)
    return cvodes if method == "cvodes" else dop853
