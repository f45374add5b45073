"""The time evolution of a scene, in a run: from which orbit or start, how long, and its files."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from casadi_skin.dynamics import Evolution, evolve, simulate_orbit
from casadi_skin.dynamics.motion import equations_of_motion
from casadi_skin.dynamics.starts import Spreading, spreading
from casadi_skin.export.c_code import export_c
from casadi_skin.fmu.archive import export_fmu
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.closed_forms import Array
from casadi_skin.lattice.declaration import INDICES
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.linear import lattice_modes
from casadi_skin.lattice.long_lattice import LongLattice
from casadi_skin.model.ode import OdeModel
from casadi_skin.optimise.families import ChainFamily, ModelFamily
from casadi_skin.optimise.family_search import FamilyNlp, FamilySearch
from casadi_skin.optimise.search import SearchResult, SearchStatus, search
from casadi_skin.optimise.search_problem import Ending
from casadi_skin.results.branch_records import OutcomeRecord, data_of, value_of
from casadi_skin.results.dataset import Dataset, write_csv, write_netcdf
from casadi_skin.results.figures.evolutions import spacetime_figure, spreading_figure
from casadi_skin.results.figures.search import search_figure
from casadi_skin.results.figures.style import number
from casadi_skin.results.journal import Journal
from casadi_skin.results.tables import evolution_columns, evolution_rows, evolution_variables, write_search
from casadi_skin.runs.directory import EXPORT
from casadi_skin.runs.first_solution import dynamics_table, start_near_rest
from casadi_skin.runs.parts import mode_of, origin, picture
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import DynamicsTable, ExportTable, Scene, SearchTable

PER_PERIOD, FEWEST, MOST = 20, 401, 4001


def scene_orbit(request: Request, branches: Sequence[Branch]) -> Orbit:
    """The orbit of the scene's [dynamics]: where its family first passes S, or the last of another branch.

    Raises ValueError where the branch does not reach S, ArithmeticError where no orbit is found there.
    """
    dynamics = dynamics_table(request)
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
    dynamics = dynamics_table(request)
    return simulate_orbit(
        orbit, sample_times(dynamics, orbit.period), dynamics.size or 0.0,
        site=dynamics.site, vector=dynamics.vector, seed=dynamics.seed,
        method=dynamics.method, tolerance=dynamics.tolerance,
    )  # fmt: skip


def evolve_from_rest(request: Request) -> Evolution:
    """The time evolution of a scene without an orbit; raises as `evolve_scene`.

    Sampled by the period of the fastest linear mode, where there are such modes.
    """
    dynamics, model = dynamics_table(request), request.model
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
    dynamics = dynamics_table(request)
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


# The exports of a run: C code in DIR/export and an FMU of its model, or of one of its orbits --------------------------


def export_scene(request: Request, branches: Sequence[Branch], directory: Path) -> tuple[Path, ...]:
    """Write the exports of a scene, and return their place; those of a resumed run are kept.

    Raises ValueError where the branch does not reach S or a part cannot be exported, ArithmeticError where no orbit is
    found.
    """
    export = _exported(request)
    target, written = directory / EXPORT, []
    of = exported(request, branches)
    if export.c is not None:
        if not (target.exists() and any(target.iterdir())):  # it is written whole or not at all
            export_c(of, target, None if export.c == "all" else export.c)
        written.append(target)
    if export.fmu is not None:
        target = directory / export.fmu
        written.append(export_fmu(of, target, export.fmi, tolerance=request.tolerance, inputs=export.inputs))
    return tuple(written)


def exported(request: Request, branches: Sequence[Branch]) -> Chain | OdeModel | Orbit:
    """The model, the orbit at S where its family first passes it, or the last orbit of another branch."""
    export = _exported(request)
    if export.S is not None:
        found = [branch for branch in branches if export.mode in (None, mode_of(branch))]
        if not found:
            raise ValueError(f"mode {export.mode}: its family was not computed")
        orbit: Orbit = found[0].at(S=export.S)
        return orbit
    if request.scene.orbit is not None and branches:
        return branches[0].orbits[-1]
    assert not isinstance(request.model, LongLattice)
    return request.model


def plan_export(request: Request) -> list[tuple[str, str]]:
    """Pairs (subject, text) that describe the export."""
    export, of = _exported(request), "the chain" if isinstance(request.model, Chain) else "the model"
    if export.S is not None:
        of = f"the orbit j = {export.mode or request.families[0].mode}, S = {export.S:g}"
    elif request.scene.orbit is not None:
        of = "the last orbit"
    lines = []
    if export.c is not None:
        parts = "all parts that need libm only" if export.c == "all" else ", ".join(export.c)
        lines.append(("export", f"C code of {of} in {EXPORT}/: {parts}"))
    if export.fmu is not None:
        lines.append(("export", f"FMU of {of} in {export.fmu}: FMI {export.fmi}, Model Exchange and Co-Simulation"))
    return lines


def _exported(request: Request) -> ExportTable:
    if request.scene.export is None:
        raise ValueError("scene: given one without [export]; accepted: one with it")
    return request.scene.export


# The search of a scene: its request, its run with a journal of starts, and its files ----------------------------------

COMPLETE = (SearchStatus.FOUND, SearchStatus.ON_BOUND)


def search_table(scene: Scene) -> SearchTable:
    """The table [search]; raises ValueError where there is none."""
    if scene.search is None:
        raise ValueError("[search]: missing; accepted: a scene with a [search]")
    return scene.search


def family_search(request: Request) -> FamilySearch:
    """The search of the scene's [search]; raises ValueError or TypeError for values that are not accepted."""
    table, model = search_table(request.scene), request.model
    constraints = [
        (held.quantity, *((held.equal, held.equal) if held.equal is not None else (held.lower, held.upper)))
        for held in table.constraints
    ]
    if isinstance(model, Chain):
        family: ChainFamily | ModelFamily = ChainFamily.of(model, table.mode)
    else:
        assert isinstance(model, OdeModel)
        family = ModelFamily.of(model, table.mode, request.parameters)
    return FamilySearch.of(
        family, S=table.S, objective=table.objective, free=table.free,
        bounds=table.bounds, constraints=constraints, maximise=table.maximise,
        tolerance=request.scene.accuracy.relative_tolerance,
    )  # fmt: skip


def run_search(request: Request, journal: Path, progress: Progress) -> SearchResult:
    """Run the search, each start kept in the journal as it ends; starts that the journal holds are not run again."""
    problem, table = family_search(request), search_table(request.scene)
    progress.say("building")
    with Journal(journal, msgspec.msgpack.Decoder(OutcomeRecord)) as file:
        if file.fault:
            progress.report(f"{journal}: {file.fault}; what follows it is dropped and computed again")
        known = [value_of(record.outcome) for record in file.records]
        return search(
            problem,
            problem.starts(table.starts, table.seed),
            deflate=table.deflate,
            known=[outcome for outcome in known if outcome.ending is not Ending.INTERRUPTED],
            keep=lambda outcome: file.append(OutcomeRecord(data_of(outcome))),
            progress=lambda where: progress.say(str(where)),
            workers=table.workers,
        )


def write_results(request: Request, scene_text: str, result: SearchResult, directory: Path) -> None:
    """search.csv, starts.csv, search.nc and the picture."""
    scene = request.scene
    table = search_table(scene)
    write_search(result, directory, scene_text, scene.title or "")
    if result.optima or result.others:
        picture(scene, directory / "search", search_figure, result, table.objective)


def check_search(request: Request) -> None:
    """Raises ValueError or TypeError where the scene's search cannot be meant."""
    family_search(request)


def summary_lines(result: SearchResult, request: Request) -> list[str]:
    """The result in lines for a terminal."""
    objective = search_table(request.scene).objective
    lines = [f"search: {result.reason}"]
    for rank, optimum in enumerate((*result.optima, *result.others), start=1):
        named = ", ".join(f"{name} = {value:.10g}" for name, value in list(optimum.parameters.items())[:4])
        more = ", ..." if len(optimum.parameters) > 4 else ""
        words = ", on another family" if optimum.on_family is False else ""
        held = f"; on {', '.join(optimum.active)}" if optimum.active else ""
        found = f"{objective} = {optimum.objective:.10g} at {named}{more}; Omega = {optimum.Omega:.10g}"
        lines.append(f"{rank}: {found}{held}{words}")
    if result.nearest is not None and result.nearest.solution is not None:
        near = result.nearest
        lines.append(f"nearest: from start {near.start.number}, {near.worst} off by {near.gap:.3g}")
    return lines


def plan_search(request: Request) -> list[tuple[str, str]]:
    """Pairs (subject, text) that describe the search of a scene, with the nonlinear programme of one start measured."""
    table, problem = search_table(request.scene), family_search(request)
    started = time.perf_counter()
    problem = problem.prepared(problem.starts(1, table.seed)[0])
    nlp = FamilyNlp(problem, problem.harmonics)
    building = time.perf_counter() - started
    limits = zip(problem.free, problem.bounds, strict=True)
    bounds = ", ".join(f"{low:g} <= {name} <= {high:g}" for name, (low, high) in limits)
    held = [f"{c.name} = {c.upper:g}" if c.equality else f"{c.lower:g} <= {c.name} <= {c.upper:g}"
            for c in problem.conditions]  # fmt: skip
    where = f"j = {problem.family.mode}" + ("" if "S" in problem.free else f", S = {problem.amplitudes[0]:g}")
    tangent = " and those of its tangent" if nlp.has_tangent else ""
    return [
        ("search", f"{'largest' if table.maximise else 'smallest'} {table.objective} on the family {where}"),
        ("free", bounds),
        ("held", "; ".join(held) or "nothing"),
        ("tolerance", f"{problem.tolerance:g}, relative, of objective and Omega"),
        ("starts", f"{table.starts}, seed {table.seed}, {table.workers} process{'' if table.workers == 1 else 'es'}"),
        ("unknowns", f"{nlp.size} on {nlp.harmonics} odd cosines; more harmonics where the tolerance asks for it"),
        ("built", f"the orbit's equations{tangent}, their exact first and second derivatives, Ipopt"),
        ("not built", "families beyond the starts and checks" + ("" if tangent else ", the tangent")),
        ("expected cost", f"{building:.1g} s to build (measured now); starts and checks are not estimated"),
    ]
