"""The time evolution that a scene asks for, in a run: which orbit, how long, sampled when, and its files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from casadi_skin import figures
from casadi_skin.dynamics import Evolution, simulate_orbit
from casadi_skin.figures.spacetime import spacetime_figure
from casadi_skin.figures.style import number
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.results.netcdf import write_evolution
from casadi_skin.results.tables import evolution_columns, evolution_rows, write_csv
from casadi_skin.scene import DynamicsTable, Scene
from casadi_skin.theory.linear import Array

PER_PERIOD, FEWEST, MOST = 20, 401, 4001


def scene_orbit(scene: Scene, branches: Sequence[Branch]) -> Orbit:
    """The orbit of the scene's [dynamics], where its branch first passes S.

    Raises ValueError where the branch does not reach S, ArithmeticError where no orbit is found there.
    """
    dynamics = _table(scene)
    found = [b for b in branches if dynamics.mode in (None, b.space.coordinates.mode_number)]
    if not found:
        raise ValueError(f"mode {dynamics.mode}: its family was not computed")
    return found[0].at(dynamics.S)


def evolve_scene(scene: Scene, orbit: Orbit) -> Evolution:
    """The time evolution of an orbit, perturbed where the scene says so.

    Raises ValueError where the time is out of reach, EvolutionError where the integrator fails.
    """
    dynamics = _table(scene)
    return simulate_orbit(
        orbit, sample_times(dynamics, orbit.period), dynamics.size or 0.0,
        site=dynamics.site, vector=dynamics.vector, seed=dynamics.seed,
        method=dynamics.method, tolerance=dynamics.tolerance,
    )  # fmt: skip


def _table(scene: Scene) -> DynamicsTable:
    if scene.dynamics is None:
        raise ValueError("scene: given one without [dynamics]; accepted: one with it")
    return scene.dynamics


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


def write_dynamics(scene: Scene, scene_text: str, orbit: Orbit, evolution: Evolution, directory: Path) -> None:
    """dynamics.csv, dynamics.nc and the space-time picture."""
    write_csv(directory / "dynamics.csv", evolution_columns(orbit.model.sites), evolution_rows(evolution))
    write_evolution(directory / "dynamics.nc", evolution, orbit, scene_text, scene.title or "")
    dynamics = _table(scene)
    title = f"$j = {orbit.space.coordinates.mode_number}$, $S = {number(orbit.S)}$"
    if dynamics.size is not None:
        title += f", perturbed by ${number(dynamics.size)}$" + (f" at site {dynamics.site}" if dynamics.site else "")
    figure = spacetime_figure(evolution, title, profile=True, energy=True, kicked_site=dynamics.site)
    figures.save(figure, directory / "dynamics")
