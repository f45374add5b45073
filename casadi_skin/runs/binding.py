"""From a scene to a request: its model is made, or read from its file, and all is checked before it is solved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec.structs import asdict

from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.lattice import Bond, Lattice, LongLattice, Site, Uniform
from casadi_skin.model.arguments import check_way
from casadi_skin.model.conserved import pinned_components, symmetry_class
from casadi_skin.model.jumps import JumpError
from casadi_skin.model.loading import call, named, read_source, run_file
from casadi_skin.model.ode import OdeModel
from casadi_skin.runs.request import Numbers, Request, state_of
from casadi_skin.runs.rules import (
    KICKS,
    Rules,
    check_known,
    check_rules,
    faults_at,
    in_file,
    placed,
    refusal,
    toml_repr,
)
from casadi_skin.runs.scene import CONSERVED, SELECTED, LatticeTable, ModelTable, Scene, UniformTable
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from casadi_skin.zero.orbit import Guess
    from casadi_skin.zero.statement import BoundaryValueProblem

Files = dict[tuple[Path, str | None], tuple[str, dict[str, Any], Any]]  # text, names and model by file and name


def bound(scene: Scene, path: Path) -> Request:
    """The request of a scene; raises SceneError that begins with its file."""
    with in_file(path):
        return bind(scene, path)


def bind(scene: Scene, scene_path: Path, files: Files | None = None) -> Request:
    """Make the model of a scene and check the scene against it.

    `files` holds what files of models gave before, and is added to: scenes of one model share it with all that is built
    of it. Raises SceneError, in one line with table and key, or with file and line where the user's code fails.
    """
    if scene.model is not None:
        request = _bound_file(scene, scene.model, scene_path, {} if files is None else files)
    elif scene.lattice is not None:
        with faults_at("[lattice] "):
            model: Any = lattice_of(scene.lattice)
        long = scene.lattice.long
        values = model.parameters if long else zip(model.parameter_names, model.nominal or (), strict=True)
        request = Request(scene, model, dict(values))
    else:
        assert scene.chain is not None  # one of the three is there
        chain = asdict(scene.chain)
        request = Request(scene, Chain(**chain), {name: chain[name] for name in ("alpha", "gamma", "g")})
    for rules in (_of_solutions, _of_continuation, _of_jumps, _of_families):
        check_rules(scene, rules(request))
    _check_perturbation(request)
    if scene.map is not None:
        from casadi_skin.runs.map_grid import axes_of

        axes_of(scene)
    if scene.spectrum is not None:
        check_spectrum(request)
    if scene.design is not None:
        with faults_at("[design] "):
            request.check_design()
    return request


def lattice_of(table: LatticeTable) -> Lattice | LongLattice:
    """The lattice of a scene, with a linear tail where the table has one.

    Raises ValueError and TypeError, with the place in the table.
    """
    sites: list[Any] = [Site(**asdict(site)) for site in table.site]
    bonds: list[Any] = [Bond(**asdict(bond)) for bond in table.bond]
    values: dict[str, Any] = {
        name: Uniform(**asdict(value)) if isinstance(value, UniformTable) else value
        for name, value in table.parameters.items()
    }
    cells: Any = table.cells
    if not table.long:
        return Lattice(cells, sites, bonds, table.boundary, values, forcing_period=table.forcing_period)
    cells = cells[0] if isinstance(cells, tuple) and len(cells) == 1 else cells
    boundary: Any = table.boundary[0] if isinstance(table.boundary, tuple) else table.boundary
    return LongLattice(cells, sites, bonds, boundary, values, table.edge)


def _bound_file(scene: Scene, table: ModelTable, scene_path: Path, files: Files) -> Request:
    """The request of a scene whose file makes a model, or states a boundary-value problem; raises SceneError."""
    from casadi_skin.model.saved import loads
    from casadi_skin.zero.stated_problem import closure_of
    from casadi_skin.zero.statement import BoundaryValueProblem

    path, kinds = scene_path.parent / table.file, (OdeModel, BoundaryValueProblem)
    with faults_at("[model] "):
        if (path, table.name) not in files:
            source = read_source(path)
            names: dict[str, Any] = {} if path.suffix == ".json" else run_file(path, source)
            found = loads(source, str(path)) if table.name is None else named(path, names, table.name, kinds)
            files[path, table.name] = source, names, found
        source, names, found = files[path, table.name]
    if not isinstance(found, BoundaryValueProblem):
        if scene.solution is not None:
            raise refusal("[solution]", f"with {table.name}, an OdeModel", "[orbit], or a BoundaryValueProblem")
        return Request(scene, found, _values_of(found, table.parameters), path, source)
    for name in scene.given("equilibrium", "orbit", "family", "spectrum", "export", "design"):
        raise refusal(f"[{name}]", f"with {table.name}, a BoundaryValueProblem", "[solution], or an OdeModel")
    values = _values_of(found.model, {**found.parameters, **table.parameters})
    with faults_at("[model] parameters: "):  # an interval that is empty at these values
        problem = replace(found, parameters=values)
    if scene.stability is not None and closure_of(problem) is None:
        raise refusal("[stability]", f"with {table.name}, which has other conditions", "x(end) = S x(start)")
    guess = None if scene.solution is None else _guess(scene.solution.guess, path, problem, names)
    return Request(scene, problem.model, values, path, source, problem, guess)


def _values_of(model: OdeModel, given: Mapping[str, float]) -> dict[str, float]:
    """Values of all parameters of a model by name; raises SceneError."""
    from casadi_skin.zero.statement import named_values

    for name in given:
        check_known("[model] parameters", name, model.parameter_names)
    if model.order == 2 and model.normalisation is not None:  # the amplitude's parameter needs no value
        return dict(given)
    with faults_at("[model] "):
        return named_values(model, given)


def _guess(given: str | Numbers, path: Path, problem: BoundaryValueProblem, names: Mapping[str, Any]) -> Guess:
    place, states = "[solution] guess", problem.model.state_names
    if not isinstance(given, str):
        return state_of(given, states, place)
    functions = [name for name, value in names.items() if callable(value) and not isinstance(value, type)]
    check_known(place, given, [name for name in functions if not name.startswith("__")])

    def guess(t: float) -> Array:
        with faults_at(f"{place}: "):
            return np.asarray(call(path, given, names[given], t), dtype=float).ravel()

    count = guess(problem.span()[0]).size
    if count != len(states):
        raise refusal(place, f"{given}, which returns {count} numbers", f"{len(states)}: {', '.join(states)}")
    return guess


# Rules of a scene with its model at hand, as those of runs.rules without it -------------------------------------------


def _of_solutions(request: Request) -> Rules:
    """States and conditions that the model has, and that an orbit can be closed with."""
    orbit, equilibrium = request.scene.orbit, request.scene.equilibrium
    if equilibrium is not None:
        model = request.equations
        forced = model.forced and f"with {model.name}, which is forced"
        yield "equilibrium", forced, "[orbit], or a model without time"
        state_of(equilibrium.start, model.state_names, "[equilibrium] start")
    if orbit is None:
        return
    from casadi_skin.follow.find import check_orbit, rotations_of

    model = request.ode
    names = (*model.state_names, *model.outputs)
    state_of(orbit.start, model.state_names, "[orbit] start")
    conserved = (*model.conserved, *(() if model.hamiltonian is None else (CONSERVED,)))
    for key, known in (("select", (*names, *conserved)), ("section", names)):
        for name in getattr(orbit, key) or ():
            check_known(f"[orbit] {key}", name, known)
    with faults_at("[orbit] "):
        check_orbit(model, orbit.period, orbit.select, orbit.section, orbit.symmetric, orbit.cycles)
        rotations_of(model, orbit.rotations, orbit.symmetric)
    if not model.forced and orbit.period is None and orbit.transient is None:
        which = "period" if orbit.symmetric else "period or transient"
        yield f"[orbit] {which}: missing; accepted: with a model that is not forced a number > 0"
    if orbit.symmetric:
        with faults_at("[orbit] symmetric: "):
            pinned = [model.state_names[i] for i in pinned_components(model, symmetry_class(model))[0]]
        name = next(iter(orbit.select or {}))
        accepted = f"a quantity that the reversal leaves free; it makes {', '.join(pinned)} vanish at phase zero"
        yield "orbit select", name in pinned and toml_repr(name), accepted


def _of_continuation(request: Request) -> Rules:
    """Parameters and values that a branch, or a curve in a second parameter, comes to."""
    scene, table, values = request.scene, request.scene.continuation, dict(request.parameters)
    if table is None:
        return
    problem, family, limits = request.problem, scene.family is not None, scene.chain is not None
    if problem is not None:
        what = "an objective" if problem.optimises else "bounds" if problem.bounds else ""
        yield "continuation", what and f"with a problem that has {what}", "a problem without"
    if SELECTED not in values and scene.orbit is not None and scene.orbit.select is not None:
        values[SELECTED] = next(iter(scene.orbit.select.values()))
    if not family:
        free = () if problem is None else problem.free
        check_known("[continuation] parameter", table.parameter, [name for name in values if name not in free])
    if table.curve is not None:
        name, to = table.curve.parameter, table.curve.to
        check_known("[continuation] curve", name, [other for other in values if family or other != table.parameter])
        yield "continuation curve", to == values[name] and f"to = {to!r}, where it starts", "another number"
        beyond = family and limits and name == "gamma" and abs(to) >= 1
        yield "continuation curve", beyond and f"to = {to!r} for gamma", "numbers between -1 and 1"
    if family:
        return
    forced = table.period_max is not None and scene.orbit is not None and request.ode.forced
    yield "continuation period_max", forced and f"{table.period_max!r} with a forced model", "one that is not forced"
    state_of(table.monitors or {}, request.equations.state_names, "[continuation] monitors")
    beyond = limits and table.parameter == "gamma" and abs(table.to) > 1
    yield "continuation to", beyond and f"{table.to!r} for gamma", "numbers from -1 to 1"
    with faults_at("[continuation] "):
        check_way(values[table.parameter], table.to, table.back_to, table.at)


def _of_jumps(request: Request) -> Rules:
    """No equations that jump along an equilibrium or an orbit; only of equations with jumps they are sought here."""
    if request.scene.given("equilibrium", "orbit", "solution") and request.ode.jumps.by_name:
        from casadi_skin.runs.first_solution import first_solution

        try:
            first_solution(request)
        except JumpError as error:
            yield f"[model] {error}"
        except (ArithmeticError, ValueError):  # none is found: the run says why
            return


def _of_families(request: Request) -> Rules:
    """Families that can be followed, each once, and orbits of families that are followed."""
    scene = request.scene
    with faults_at(placed):
        modes = [family.mode for family in request.families]
        if scene.accuracy.certify:
            from casadi_skin.certify.certify import provable
            from casadi_skin.follow.family import Family

            for family in request.families:
                provable(Family(family))  # refuses those that the theorem is not about, and all without python-flint
    for i, mode in enumerate(modes):
        yield "family mode", mode in modes[:i] and f"mode {mode} more than once", "each mode once"
    for name, table in (("dynamics", scene.dynamics), ("export", scene.export)):
        other = modes and table is not None and table.mode not in modes
        yield f"{name} mode", other, f"one of the modes of [family], {modes}"


def _check_perturbation(request: Request) -> None:
    """Raises SceneError for a start, or a perturbation, that the states of the model do not have."""
    table, kicks = request.scene.dynamics, {key: getattr(request.scene.dynamics, key, None) for key in KICKS}
    if table is None:
        return
    with faults_at("[dynamics] "):
        if not request.scene.given("family", "orbit"):
            from casadi_skin.runs.first_solution import start_near_rest

            start_near_rest(request)
        elif any(kick is not None for kick in kicks.values()):
            from casadi_skin.dynamics.evolve import unit_direction

            unit_direction("perturbation", request.equations.state_names, request.equations.size, kicks)


def check_spectrum(request: Request) -> None:
    """Raises SceneError where linear frequencies cannot be shown; those of a lattice are written as they are."""
    if request.scene.lattice is None:
        chain = request.scene.chain
        place = partial(placed, table="spectrum") if chain is None else f"[chain] alpha: given {chain.alpha:g}; "
        with faults_at(place):
            request.model.linear_frequencies(request.parameters)
