"""The tasks of a scene beside its branches: time evolution, a design, exports, each planned, run, and put in words.

The files of the linear spectrum are written here, too.

What one of them alone needs is loaded when it is run: a scene that asks for none of them loads nothing of it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.closed_forms import Array
from casadi_skin.lattice.declaration import CELL_INDICES
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.results import figures
from casadi_skin.results.dataset import Dataset, write_columns, write_netcdf
from casadi_skin.results.figures.style import number
from casadi_skin.runs.branches import Branches
from casadi_skin.runs.directory import EXPORT_FOLDER
from casadi_skin.runs.output import Lines
from casadi_skin.runs.parts import mode_of, origin, picture
from casadi_skin.runs.request import Request, kind_and_number
from casadi_skin.runs.scene import DesignTable, DynamicsTable, ExportTable, Scene
from casadi_skin.search.design import ENGINE, Design

if TYPE_CHECKING:
    from casadi_skin.dynamics.evolution import Evolution
    from casadi_skin.dynamics.starts import Spreading
    from casadi_skin.follow.special_points import SpecialPoint

PER_PERIOD, FEWEST_TIMES, MOST_TIMES = 20, 401, 4001  # times that are written unless a number of them is given


class Task(ABC):
    """A part of a run that one table of the scene asks for."""

    table: ClassVar[str]

    def __init__(self, request: Request) -> None:
        self.request, self.asked = request, getattr(request.scene, self.table)

    @abstractmethod
    def plan(self) -> Lines:
        """Pairs (subject, text) that describe the work."""

    @abstractmethod
    def run(self, run: Branches, directory: Path, scene_text: str) -> None:
        """Do the work and write its files; failures go to those of the run."""

    @abstractmethod
    def words(self) -> list[str]:
        """The result in lines for a terminal."""


def tasks_of(request: Request) -> list[Task]:
    """The tasks of a scene beside its branches, in the order in which they are run."""
    return [kind(request) for kind in (Dynamics, BestDesign, Export) if request.scene.given(kind.table)]


def _at(S: float, mode: int | None, branches: Sequence[Branch]) -> Orbit:
    """The orbit where the family of a mode first passes S.

    Raises ValueError where the family does not reach S, ArithmeticError where no orbit is found there.
    """
    found = [branch for branch in branches if mode in (None, mode_of(branch))]
    if not found:
        raise ValueError(f"mode {mode}: its family was not computed")
    orbit: Orbit = found[0].at(S=S)
    return orbit


# Time evolution -------------------------------------------------------------------------------------------------------


class Dynamics(Task):
    """The time evolution of an orbit of the scene, or from near rest."""

    table = "dynamics"
    asked: DynamicsTable
    evolution: Evolution | None = None

    @property
    def alone(self) -> bool:
        """Whether the motion starts near rest."""
        return not self.request.scene.given("family", "orbit")

    def plan(self) -> Lines:
        """The orbit followed in time, and the method."""
        asked = self.asked
        kick = f"{asked.size:g} {_direction(asked)}" if asked.size is not None else ""
        end = f"t = {asked.duration:g}" if asked.duration is not None else f"{asked.periods:g} periods"
        samples = f"{asked.samples} times" if asked.samples is not None else "20 times a period, 401 to 4001 in all"
        start = "the last orbit"
        if self.alone:
            start = f"{'velocities' if asked.moving else 'displacements'} of {kick}, from rest"
        elif self.request.families:
            start = f"the orbit j = {asked.mode or self.request.families[0].mode}, S = {asked.S:g}"
        start += f", perturbed by {kick}" if kick and not self.alone else ""
        return [("dynamics", f"{start}, to {end}; {samples}; {asked.method}, tolerance {asked.tolerance:g}")]

    def run(self, run: Branches, directory: Path, scene_text: str) -> None:
        """Follow the motion as far as that can be done; of branches that were computed."""
        from casadi_skin.dynamics.evolution import EvolutionError

        if not (run.branches or self.alone):
            return
        run.progress.say("time evolution")
        orbit = None
        with run.named("[dynamics]: "):
            if not self.alone:
                S, mode = self.asked.S, self.asked.mode
                orbit = run.branches[0].orbits[-1] if S is None else _at(S, mode, run.branches)
            try:
                self.evolution = self._from_rest() if orbit is None else self._of(orbit)
            except EvolutionError as error:
                self.evolution = error.evolution
                raise
        if self.evolution is not None:
            run.progress.say("writing the time evolution")
            with interrupts_deferred():
                self._write(orbit, self.evolution, directory, scene_text)

    def words(self) -> list[str]:
        """How far it came."""
        return [] if self.evolution is None else [f"dynamics: {self.evolution.status}"]

    def _of(self, orbit: Orbit) -> Evolution:
        """The time evolution of an orbit, perturbed where the scene says so.

        Raises ValueError where the time is out of reach, EvolutionError where the integrator fails.
        """
        from casadi_skin.dynamics.evolve import simulate_orbit

        asked = self.asked
        kick = {"site": asked.site, "vector": asked.vector, "seed": asked.seed}
        how = {"method": asked.method, "tolerance": asked.tolerance}
        return simulate_orbit(orbit, sample_times(asked, orbit.period), asked.size or 0.0, **kick, **how)  # type: ignore[arg-type]

    def _from_rest(self) -> Evolution:
        """The time evolution of a scene without an orbit; raises as `_of`.

        Sampled by the period of the fastest linear mode, where there are such modes.
        """
        from casadi_skin.dynamics.evolution import equations_of_motion
        from casadi_skin.dynamics.evolve import evolve
        from casadi_skin.lattice.linear import lattice_modes
        from casadi_skin.runs.first_solution import start_near_rest

        asked, model, parameters = self.asked, self.request.model, self.request.model_parameters
        if self.request.scene.lattice is not None:
            fastest = float(np.max(lattice_modes(model, parameters).frequencies.real))
        else:
            fastest = (equations_of_motion(model, parameters).linear_frequencies or (0.0, 0.0))[1]
        times = sample_times(asked, 2.0 * np.pi / fastest if fastest > 0.0 else asked.duration or 1.0)
        given = *start_near_rest(self.request), times, asked.method, asked.tolerance
        return evolve(model, *given, parameters=parameters)

    def _write(self, orbit: Orbit | None, evolution: Evolution, directory: Path, scene_text: str) -> None:
        """dynamics.csv, dynamics.nc and the space-time picture; of a lattice also where its energy is."""
        from casadi_skin.dynamics.starts import spreading
        from casadi_skin.results.figures.evolutions import spacetime_figure
        from casadi_skin.results.tables import evolution_columns, evolution_variables

        asked, request = self.asked, self.request
        write_columns(directory / "dynamics.csv", evolution_columns(evolution))
        start, title = _origin_of(orbit, asked)
        how = {"method": evolution.method, "tolerance": evolution.tolerance, "coordinates": evolution.coordinates}
        attributes = {**origin(request, scene_text), **how, "step": evolution.step or 0.0, **start}
        write_netcdf(directory / "dynamics.nc", Dataset(evolution_variables(evolution), attributes))
        if asked.size is not None and orbit is not None:
            title += f", perturbed by ${number(asked.size)}$ {_direction(asked)}"
        near = orbit if asked.size is not None else None
        draw = partial(spacetime_figure, profile=True, energy=True, kicked_site=asked.site, orbit=near)
        picture(request.scene, directory / "dynamics", draw, evolution, title)
        if request.scene.lattice is not None and request.model.structure.energies is not None:
            _write_spreading(request.scene, spreading(evolution), request.model, directory)


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
        samples = max(FEWEST_TIMES, 1 + int(np.ceil(PER_PERIOD * end / period)))
    if samples > MOST_TIMES and dynamics.samples is None:
        intervals = np.arange(MOST_TIMES - 401, MOST_TIMES)
        half_periods = 2.0 * (end / period) * np.arange(1, 11)[:, None] / intervals
        apart = np.abs(half_periods - np.round(half_periods)).min(axis=0)
        samples = 1 + int(intervals[np.argmax(apart)])
    return np.linspace(0.0, end, samples)


def _origin_of(orbit: Orbit | None, dynamics: DynamicsTable) -> tuple[dict[str, float | str], str]:
    """Start of the motion: attributes, and words of a title."""
    if orbit is None:
        what, size = "velocities" if dynamics.moving else "displacements", dynamics.size or 0.0
        start: dict[str, float | str] = {"start_size": size, "start": f"{what} {_direction(dynamics)}"}
        return start, f"{what} of ${number(size)}$ {_direction(dynamics)}"
    start = {"orbit_Omega": orbit.Omega}
    space: Any = orbit.space
    if not space.is_family:
        return start, f"period ${number(orbit.period)}$"
    mode = space.coordinates.mode_number
    return {"orbit_mode": mode, "orbit_S": orbit.S, **start}, f"$j = {mode}$, $S = {number(orbit.S)}$"


def _write_spreading(scene: Scene, found: Spreading, lattice: Lattice, directory: Path) -> None:
    """spreading.csv, energies.csv and the picture of where the energy of a lattice is."""
    from casadi_skin.results.figures.evolutions import spreading_figure

    centres = {f"centre_{name}": values for name, values in zip(CELL_INDICES, found.centre.T, strict=False)}
    numbers = {"participation": found.participation, "second_moment": found.second_moment}
    write_columns(directory / "spreading.csv", {"t": found.t, "energy": found.total, **centres, **numbers})
    sites = [f"energy_{name.partition('_')[2]}" for name in lattice.state_names[: lattice.declaration.size]]
    energies = dict(zip(sites, found.energies.T, strict=True))
    write_columns(directory / "energies.csv", {"t": found.t, **energies})
    picture(scene, directory / "spreading", spreading_figure, found, lattice)


# Exports: C code in DIR/export and an FMU of the model, or of one of the orbits ---------------------------------------


class Export(Task):
    """C code and an FMU; those of a resumed run are kept."""

    table = "export"
    asked: ExportTable
    written: tuple[Path, ...] = ()

    def plan(self) -> Lines:
        """What is exported, and where."""
        asked, of = self.asked, "the chain" if self.request.scene.chain is not None else "the model"
        if asked.S is not None:
            of = f"the orbit j = {asked.mode or self.request.families[0].mode}, S = {asked.S:g}"
        elif self.request.scene.orbit is not None:
            of = "the last orbit"
        parts = "all parts that need libm only" if asked.c == "all" else ", ".join(asked.c or ())
        code = f"C code of {of} in {EXPORT_FOLDER}/: {parts}" if parts else ""
        fmu = f"FMU of {of} in {asked.fmu}: FMI {asked.fmi}, Model Exchange and Co-Simulation" if asked.fmu else ""
        return [("export", words) for words in (code, fmu) if words]

    def run(self, run: Branches, directory: Path, scene_text: str) -> None:
        """Write the exports."""
        from casadi_skin.export.c_code import export_c
        from casadi_skin.fmu.archive import export_fmu

        asked, target = self.asked, directory / EXPORT_FOLDER
        run.progress.say("exporting")
        with run.named("[export]: "):
            of = self._exported(run.branches)
            if asked.c is not None:
                if not (target.exists() and any(target.iterdir())):  # it is written whole or not at all
                    export_c(of, target, None if asked.c == "all" else asked.c)
                self.written += (target,)
            if asked.fmu is not None:
                options = {"tolerance": self.request.tolerance, "inputs": asked.inputs}
                self.written += (export_fmu(of, directory / asked.fmu, asked.fmi, **options),)  # type: ignore[arg-type]

    def words(self) -> list[str]:
        """Where the exports are."""
        return [f"exported to {path}" for path in self.written]

    def _exported(self, branches: Sequence[Branch]) -> Any:
        """The orbit at S of its family, or the last orbit of another branch, or the model."""
        if self.asked.S is not None:
            return _at(self.asked.S, self.asked.mode, branches)
        if self.request.scene.orbit is not None and branches:
            return branches[0].orbits[-1]
        return self.request.model


# A design -------------------------------------------------------------------------------------------------------------


class BestDesign(Task):
    """Parameters at which a quantity of orbits of a family, or of special points of the branch, is best."""

    table = "design"
    asked: DesignTable
    result: Design | None = None

    def plan(self) -> Lines:
        """What is optimised, over what, within what."""
        asked = self.asked
        bounds = [f"{low:g} <= {name} <= {high:g}" for name, (low, high) in asked.bounds.items()]
        held = [f"{c.quantity} = {c.equal:g}" for c in asked.subject_to if c.equal is not None]
        held += [f"{c.quantity} within bounds" for c in asked.subject_to if c.equal is None]
        where = f"of {', '.join(asked.of)}" if asked.of else f"of the orbits at S = {asked.S or 1.0}"
        return [
            ("design", f"{'largest' if asked.maximise else 'smallest'} {asked.quantity} {where}"),
            ("over", ", ".join(asked.over)),
            ("held", "; ".join((*bounds, *held)) or "nothing"),
            ("starts", f"{asked.starts}, seed {asked.seed}"),
            ("by", f"{ENGINE}, located again at every design; no nonlinear programme of the orbit is built"),
        ]

    def run(self, run: Branches, directory: Path, scene_text: str) -> None:
        """Optimise, and write design.csv, design_path.csv, design.nc and the picture."""
        from casadi_skin.results.figures.designs import design_figure
        from casadi_skin.results.tables import write_design
        from casadi_skin.search.designs import best_design

        scene, asked = self.request.scene, self.asked
        run.progress.say("designing")
        with run.named("[design]: "):
            points = [_special_point(name, run.branches) for name in asked.of]
            problem = self.request.designed(points)
            starts, say = problem.places(asked.starts, asked.seed), lambda where: run.progress.say(str(where))
            found = self.result = best_design(problem, starts, self.request.tolerance, say)
            if not found.found:
                run.failures.append(f"[design]: {found.reason}")
            with interrupts_deferred():
                write_design(found, directory, scene_text, scene.title or "")
                model = self.request.model
                name = f"$N = {model.sites}$" if scene.chain is not None else model.name
                picture(scene, directory / "design", design_figure, found, name)

    def words(self) -> list[str]:
        """The optima, each with its numbers."""
        result = self.result
        if result is None:
            return []
        lines = [f"design: {result.reason}"]
        for rank, one in enumerate((result, *result.others), start=1):
            named = ", ".join(f"{name} = {value:.10g}" for name, value in list(one.parameters.items())[:4])
            lines.append(f"{rank}: {one.quantity} = {one.value:.10g} at {named}{', ...' * (len(one.parameters) > 4)}")
        return lines


def _special_point(name: str, branches: Sequence[Branch]) -> SpecialPoint:
    """A special point of the first branch, by its kind and its number from 1; raises ValueError for others."""
    kind, number = kind_and_number(name)
    points = [point for branch in branches[:1] for point in branch.special_points]
    found = [point for point in points if point.kind == kind]
    if not 1 <= number <= len(found):
        known = ", ".join(dict.fromkeys(point.kind for point in points)) or "none"
        raise ValueError(f"of: given {name!r}; accepted: special points of the branch, whose kinds are: {known}")
    return found[number - 1]


# The linear spectrum; of a lattice also where modes live, bands of the cell, the skin effect -------------------------


def write_spectrum(request: Request, directory: Path) -> None:
    """spectrum.csv and the picture of the linear spectrum; of a lattice also where modes live, and its bands."""
    if request.scene.lattice is not None:
        _write_lattice_spectrum(request.scene, request.model, request.parameters, directory)
        return
    frequencies = request.model.linear_frequencies(request.parameters)
    write_columns(directory / "spectrum.csv", {"mode": np.arange(len(frequencies)) + 1, "omega": frequencies})
    picture(request.scene, directory / "spectrum", figures.spectrum_figure, request.model, request.parameters)


def _write_lattice_spectrum(scene: Scene, lattice: Lattice, parameters: Mapping[str, float], directory: Path) -> None:
    """spectrum.csv, where modes live, with pictures; where all cells are alike also bands and the skin effect."""
    from casadi_skin.lattice.linear import bands, brillouin_zone, lattice_modes, winding_numbers
    from casadi_skin.results.figures.bands import band_figure, skin_figure

    modes, alike = lattice_modes(lattice, parameters), not lattice.declaration.differing
    columns: dict[str, Any] = {"mode": np.arange(modes.frequencies.size) + 1}
    columns |= {"omega": modes.frequencies.real, "growth": modes.frequencies.imag}
    columns |= {"participation": modes.participation, "left_participation": modes.left_participation}
    for name, centre, decay in zip(CELL_INDICES, modes.centre.T, modes.decay.T, strict=False):
        columns |= {f"centre_{name}": centre, f"decay_{name}": decay}
    if alike and len(lattice.declaration.cells) == 1:
        columns["winding_number"] = winding_numbers(lattice, modes.squares, parameters)
        columns["beta"] = np.abs(brillouin_zone(lattice, modes.squares, parameters)).mean(axis=1)
        picture(scene, directory / "skin", skin_figure, lattice, parameters)
    write_columns(directory / "spectrum.csv", columns)
    if modes.real and lattice.order == 2:
        picture(scene, directory / "spectrum", figures.spectrum_figure, lattice, parameters)
    if alike:
        found = bands(lattice, parameters)
        columns = {f"k_{name}": k for name, k in zip(CELL_INDICES, found.wave_numbers.T, strict=False)}
        for b, squares in enumerate(found.squares.T, start=1):
            columns |= {f"omega_squared_{b}": squares.real, f"imaginary_part_{b}": squares.imag}
        write_columns(directory / "bands.csv", columns)
        picture(scene, directory / "bands", band_figure, lattice, parameters)
