"""The time evolution of a scene, in a run: from which orbit or start, how long, and its files."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from casadi_skin.dynamics import Evolution, evolve, simulate_orbit
from casadi_skin.dynamics.equations import equations_of_motion
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.lattice.declaration import INDICES
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.linear import lattice_modes
from casadi_skin.lattice.long_lattice import LongLattice
from casadi_skin.lattice.spreading import Spreading, spreading
from casadi_skin.lattice.starts import initial_state
from casadi_skin.lattice.uniform_chain import Array
from casadi_skin.model.ode import OdeModel
from casadi_skin.results.dataset import Dataset, write_csv, write_netcdf
from casadi_skin.results.evolution import evolution_columns, evolution_rows, evolution_variables
from casadi_skin.results.figures.spacetime import spacetime_figure
from casadi_skin.results.figures.spreading import spreading_figure
from casadi_skin.results.figures.style import number
from casadi_skin.runs.pictures import picture
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import Scene
from casadi_skin.runs.task_tables import DynamicsTable
from casadi_skin.runs.writing import mode_of, origin

PER_PERIOD, FEWEST, MOST = 20, 401, 4001


def scene_orbit(request: Request, branches: Sequence[Branch]) -> Orbit:
    """The orbit of the scene's [dynamics]: where its family first passes S, or the last of another branch.

    Raises ValueError where the branch does not reach S, ArithmeticError where no orbit is found there.
    """
    dynamics = _table(request)
    if not isinstance(branches[0].space, Family):
        return branches[0].orbits[-1]
    found = [b for b in branches if dynamics.mode in (None, mode_of(b))]
    if not found or dynamics.S is None:
        raise ValueError(f"mode {dynamics.mode}: its family was not computed")
    orbit: Orbit = found[0].at(S=dynamics.S)
    return orbit


def evolve_scene(request: Request, orbit: Orbit) -> Evolution:
    """The time evolution of an orbit, perturbed where the scene says so.

    Raises ValueError where the time is out of reach, EvolutionError where the integrator fails.
    """
    dynamics = _table(request)
    return simulate_orbit(
        orbit, sample_times(dynamics, orbit.period), dynamics.size or 0.0,
        site=dynamics.site, vector=dynamics.vector, seed=dynamics.seed,
        method=dynamics.method, tolerance=dynamics.tolerance,
    )  # fmt: skip


def start_near_rest(request: Request) -> tuple[Array, Array | None]:
    """The state that a scene without an orbit starts from; raises ValueError for one that the model does not have."""
    dynamics = _table(request)
    parameters = request.parameters if isinstance(request.model, OdeModel) else None
    return initial_state(
        request.model, dynamics.size or 0.0, mode=dynamics.mode, site=dynamics.site, vector=dynamics.vector,
        seed=dynamics.seed, moving=dynamics.moving, parameters=parameters,
    )  # fmt: skip


def evolve_from_rest(request: Request) -> Evolution:
    """The time evolution of a scene without an orbit; raises as `evolve_scene`.

    Sampled by the period of the fastest linear mode, where there are such modes.
    """
    dynamics, model = _table(request), request.model
    if isinstance(model, LongLattice):
        raise ValueError("lattice: given one with a linear tail; accepted: all its cells, without edge")
    parameters = request.parameters if isinstance(model, OdeModel) else None
    if isinstance(model, Lattice):
        fastest = float(np.max(lattice_modes(model, parameters).frequencies.real))
    else:
        fastest = (equations_of_motion(model, parameters).linear_frequencies or (0.0, 0.0))[1]
    times = sample_times(dynamics, 2.0 * np.pi / fastest if fastest > 0.0 else dynamics.duration or 1.0)
    start = start_near_rest(request)
    return evolve(model, *start, times, dynamics.method, dynamics.tolerance, parameters=parameters)


def _table(request: Request) -> DynamicsTable:
    if request.scene.dynamics is None:
        raise ValueError("scene: given one without [dynamics]; accepted: one with it")
    return request.scene.dynamics


def _direction(dynamics: DynamicsTable) -> str:
    """The direction of the perturbation in words."""
    if dynamics.mode is not None and dynamics.S is None:
        return f"in linear mode {dynamics.mode}"
    if dynamics.site is not None:
        return f"at site {dynamics.site}"
    return "along the vector given" if dynamics.vector is not None else f"at random (seed {dynamics.seed})"


def sample_times(dynamics: DynamicsTable, period: float) -> Array:
    """Equidistant times from 0 to the end, the wanted number of them.

    Where none is wanted, 20 a period, 401 to 4001 in all. In runs too long for that the number is such that the
    samples fall on all phases of the period, and do not make a slow beat out of the oscillation.
    """
    end = dynamics.duration if dynamics.duration is not None else (dynamics.periods or 1.0) * period
    samples = dynamics.samples
    if samples is None:
        samples = max(FEWEST, 1 + int(np.ceil(PER_PERIOD * end / period)))
    if samples > MOST and dynamics.samples is None:
        intervals = np.arange(MOST - 401, MOST)
        half_periods = 2.0 * (end / period) * np.arange(1, 11)[:, None] / intervals
        apart = np.abs(half_periods - np.round(half_periods)).min(axis=0)
        samples = 1 + int(intervals[np.argmax(apart)])
    return np.linspace(0.0, end, samples)


def write_dynamics(
    request: Request, scene_text: str, orbit: Orbit | None, evolution: Evolution, directory: Path
) -> None:
    """dynamics.csv, dynamics.nc and the space-time picture; of a lattice also where its energy is."""
    dynamics = _table(request)
    write_csv(directory / "dynamics.csv", evolution_columns(evolution), evolution_rows(evolution))
    start, title = _origin_of(orbit, dynamics)
    how = {"method": evolution.method, "tolerance": evolution.tolerance, "coordinates": evolution.coordinates}
    attributes = {**origin(request, scene_text), **how, "step": evolution.step or 0.0, **start}
    write_netcdf(directory / "dynamics.nc", Dataset(evolution_variables(evolution), attributes))
    if dynamics.size is not None and orbit is not None:
        title += f", perturbed by ${number(dynamics.size)}$ {_direction(dynamics)}"
    near = orbit if dynamics.size is not None else None
    draw = partial(spacetime_figure, profile=True, energy=True, kicked_site=dynamics.site, orbit=near)
    picture(request.scene, directory / "dynamics", draw, evolution, title)
    if isinstance(request.model, Lattice) and request.model.structure.energies is not None:
        _write_spreading(request.scene, spreading(evolution), request.model, directory)


def _origin_of(orbit: Orbit | None, dynamics: DynamicsTable) -> tuple[dict[str, float | str], str]:
    """Start of the motion: attributes, and words of a title."""
    if orbit is None:
        what = "velocities" if dynamics.moving else "displacements"
        start: dict[str, float | str] = {"start_size": dynamics.size or 0.0, "start": f"{what} {_direction(dynamics)}"}
        return start, f"{what} of ${number(dynamics.size or 0.0)}$ {_direction(dynamics)}"
    start = {"orbit_Omega": orbit.Omega}
    if not isinstance(orbit.space, Family):
        return start, f"period ${number(orbit.period)}$"
    mode = orbit.space.coordinates.mode_number
    return {"orbit_mode": mode, "orbit_S": orbit.S, **start}, f"$j = {mode}$, $S = {number(orbit.S)}$"


def _write_spreading(scene: Scene, found: Spreading, lattice: Lattice, directory: Path) -> None:
    """spreading.csv, energies.csv and the picture of where the energy of a lattice is."""
    centres = [f"centre_{name}" for name in INDICES[: found.centre.shape[1]]]
    columns = ["t", "energy", *centres, "participation", "second_moment"]
    table = np.column_stack([found.t, found.total, found.centre, found.participation, found.second_moment])
    write_csv(directory / "spreading.csv", columns, (dict(zip(columns, row, strict=True)) for row in table.tolist()))
    sites = [f"energy_{name.partition('_')[2]}" for name in lattice.state_names[: lattice.declaration.size]]
    rows = np.column_stack([found.t, found.energies]).tolist()
    write_csv(directory / "energies.csv", ["t", *sites], (dict(zip(["t", *sites], row, strict=True)) for row in rows))
    picture(scene, directory / "spreading", spreading_figure, found, lattice)
