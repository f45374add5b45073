"""Time evolution of an orbit of any model, perturbed or not (paper, Sec. III and Fig. 6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.dynamics.equations import EquationsOfMotion, equations_of_motion
from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.dynamics.evolve import checked_vector, evolve
from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.orbit import Orbit
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.problem import Array


def orbit_equations(orbit: Orbit) -> EquationsOfMotion:
    """The equations of an orbit, in the model's own coordinates, at the values of its parameters."""
    space, model = orbit.space, orbit.model
    if isinstance(space, BoundarySpace) and space.periodic is not None:
        model = space.periodic.given
    if not isinstance(model, OdeModel):
        return equations_of_motion(model)
    # The parameter for S in the normalisation of a family is none of its orbits, and not in the equations.
    values = {name: orbit.parameters.get(name, 0.0) for name in model.parameter_names}
    return equations_of_motion(model, values)


def orbit_start(orbit: Orbit, equations: EquationsOfMotion) -> Array:
    """State of an orbit at phase zero in the components of its equations, shape (component,)."""
    return np.append(orbit.profile, np.zeros(equations.size - orbit.profile.size))  # an orbit of a family rests there


def perturbed(
    orbit: Orbit,
    size: float,
    *,
    site: int | None = None,
    vector: ArrayLike | None = None,
    seed: int | None = None,
) -> tuple[Array, Array]:
    """A state near an orbit: that at phase zero plus `size` times a perturbation of norm 1 (paper, Fig. 6).

    Arguments:
        orbit: any orbit.
        size: of the perturbation; the paper's is 0.005.
        site: number of the one position that is displaced, from 1; in a model of first order of the component.
        vector: direction, shape (position,) or (component,): displacements, then velocities.
        seed: of random displacements, normally distributed; in a model of first order of all components.

    Returns:
        Displacements and velocities, shape (position,) each; of a model of first order the state, and no velocities.

    Raises:
        ValueError: not one of site, vector and seed is given, or the argument does not fit the model.
    """
    equations = orbit_equations(orbit)
    state, n = orbit_start(orbit, equations), equations.positions or equations.size
    if not np.isfinite(size):
        raise ValueError(f"size: given {size!r}; accepted: a finite number")
    given = [name for name, value in (("site", site), ("vector", vector), ("seed", seed)) if value is not None]
    if len(given) != 1:
        raise ValueError(f"perturbation: given {' and '.join(given) or 'none'}; accepted: one of site, vector, seed")
    z = np.zeros(state.size)
    if site is not None:
        if not isinstance(site, int | np.integer) or not 1 <= site <= n:
            raise ValueError(f"site: given {site!r}; accepted: 1..{n}")
        z[site - 1] = 1.0
    elif vector is not None:
        direction = checked_vector("vector", vector, equations.names, *sorted({n, state.size}))
        z[: direction.size] = direction
    else:
        z[:n] = np.random.default_rng(seed).normal(size=n)
    largest = np.abs(z).max()
    if largest == 0:
        raise ValueError("vector: given zeros; accepted: a vector with a direction")
    z /= largest * np.linalg.norm(z / largest)
    return state[:n] + size * z[:n], state[n:] + size * z[n:]


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
    coordinates: str | None = None,
) -> Evolution:
    """Evolve an orbit from its phase zero, perturbed where a perturbation is given.

    Arguments:
        orbit: any orbit: of a family, or forced or dissipative of `find_orbit`.
        t: the wanted times, ascending from 0 on.
        size: of the perturbation.
        site: see `perturbed`, as for `vector` and `seed`.
        vector: direction of the perturbation.
        seed: of a random perturbation.
        method: see `evolve`, as for `tolerance` and `coordinates`.
        tolerance: of one step.
        coordinates: "gauge" or "physical".

    Returns:
        States at the times, in the coordinates of the model.

    Raises:
        ValueError: an argument is out of range.
        EvolutionError: the integrator fails.
    """
    equations = orbit_equations(orbit)
    state, n = orbit_start(orbit, equations), equations.positions or equations.size
    start = (state[:n], state[n:])
    if size != 0 or site is not None or vector is not None or seed is not None:
        start = perturbed(orbit, size, site=site, vector=vector, seed=seed)
    parameters = equations.parameters if isinstance(equations.model, OdeModel) else None
    return evolve(equations.model, *start, t, method, tolerance, coordinates, parameters=parameters)
