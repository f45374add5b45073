"""From a scene to a request: the file of its model is run or read, and names and shapes are checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import asdict

from casadi_skin.lattice.chain import Chain
from casadi_skin.model.conserved import pinned_components, symmetry_class
from casadi_skin.model.jumps import JumpError
from casadi_skin.model.loading import call, named, read_source, run_file
from casadi_skin.model.ode import OdeModel
from casadi_skin.runs.output import InputError
from casadi_skin.runs.request import Numbers, Request, check_state, lattice_of, state_of, values_of
from casadi_skin.runs.rules import SceneError, check_known, faults_at, refusal, toml_repr
from casadi_skin.runs.scene import (
    CONSERVED,
    SELECTED,
    TABLES,
    EquilibriumTable,
    LatticeTable,
    ModelTable,
    OrbitTable,
    Scene,
)
from casadi_skin.zero.guesses import Guess
from casadi_skin.zero.problem import Array
from casadi_skin.zero.statement import BoundaryValueProblem

IN_SCENES = {  # words of messages about arguments of find_orbit
    "an expression": "a table with one number",
    ", symmetric = True or free": " or symmetric = true",
    "cycles alone": "start, transient and cycles",
}


def _in_scenes(words: str) -> str:
    """A message about an argument of find_orbit, about the key of [orbit]."""
    for in_python, in_scenes in IN_SCENES.items():
        words = words.replace(in_python, in_scenes)
    return f"[orbit] {words}"


def _check_orbit(request: Request, orbit: OrbitTable) -> None:
    """Refuse states and conditions that the model does not have, or that an orbit cannot be closed with."""
    from casadi_skin.follow.find import check_orbit, rotations_of

    model = request.ode
    names = (*model.state_names, *model.outputs)
    check_state("[orbit] start", orbit.start, model.state_names)
    conserved = (*model.conserved, *(() if model.hamiltonian is None else (CONSERVED,)))
    for key, given, known in (("select", orbit.select, (*names, *conserved)), ("section", orbit.section, names)):
        if given is not None:
            check_known(f"[orbit] {key}", next(iter(given)), known)
    with faults_at(_in_scenes):
        check_orbit(model, orbit.period, orbit.select, orbit.section, orbit.symmetric, orbit.cycles)
        rotations_of(model, orbit.rotations, orbit.symmetric)
    if not model.forced and orbit.period is None and orbit.transient is None:
        which = "" if orbit.symmetric else " or transient"
        raise SceneError(f"[orbit] period{which}: missing; accepted: with a model that is not forced a number > 0")
    if orbit.symmetric:
        _check_symmetric(model, orbit)


def _check_symmetric(model: OdeModel, orbit: OrbitTable) -> None:
    with faults_at("[orbit] symmetric: "):
        first, _ = pinned_components(model, symmetry_class(model))
    name = next(iter(orbit.select or {}))
    pinned = [model.state_names[i] for i in first]
    if name in pinned:
        accepted = f"a quantity that the reversal leaves free; it makes {', '.join(pinned)} vanish at phase zero"
        raise refusal("[orbit] select", toml_repr(name), accepted)


def bound_problem(
    scene: Scene, table: ModelTable, path: Path, source: str, problem: BoundaryValueProblem, names: Mapping[str, Any]
) -> Request:
    """The request of a scene whose file states a boundary-value problem; raises SceneError."""
    for name in ("equilibrium", "orbit", "family", "spectrum", "export", "search"):
        if getattr(scene, name) is not None:
            given = f"with {table.name}, a BoundaryValueProblem"
            raise refusal(f"[{name}]", given, "[solution], or an OdeModel")
    values = values_of(problem.model, {**problem.parameters, **table.parameters})
    with faults_at("[model] parameters: "):  # an interval that is empty at these values
        problem = replace(problem, parameters=values)
    from casadi_skin.zero.closure import closure_of

    if scene.stability is not None and closure_of(problem) is None:
        raise refusal("[stability]", f"with {table.name}, which has other conditions", "x(end) = S x(start)")
    guess = None if scene.solution is None else _guess(scene.solution.guess, path, problem, names)
    return Request(scene, problem.model, values, path, source, problem, guess)


def _guess(given: str | Numbers, path: Path, problem: BoundaryValueProblem, names: Mapping[str, Any]) -> Guess:
    place, states = "[solution] guess", problem.model.state_names
    if not isinstance(given, str):
        check_state(place, given, states)
        return state_of(given, states)
    functions = [name for name, value in names.items() if callable(value) and not isinstance(value, type)]
    check_known(place, given, [name for name in functions if not name.startswith("__")])

    def guess(t: float) -> Array:
        with faults_at(f"{place}: "):
            return np.asarray(call(path, given, names[given], t), dtype=float).ravel()

    start, _ = problem.span()
    count = guess(start).size
    if count != len(states):
        raise refusal(place, f"{given}, which returns {count} numbers", f"{len(states)}: {', '.join(states)}")
    return guess


Files = dict[tuple[Path, str | None], tuple[str, dict[str, Any], Any]]  # text, names and model by file and name


def bind(scene: Scene, scene_path: Path, files: Files | None = None) -> Request:
    """Make the model of a scene and check the scene against it.

    `files` holds what files of models gave before, and is added to: scenes of one model share it with all that is built
    of it. Raises SceneError, in one line with table and key, or with file and line where the user's code fails.
    """
    if scene.model is not None:
        request = _bound_file(scene, scene.model, scene_path, {} if files is None else files)
    elif scene.lattice is not None:
        request = _bound_lattice(scene, scene.lattice)
    else:
        assert scene.chain is not None  # one of the three is there
        chain = asdict(scene.chain)
        request = Request(scene, Chain(**chain), {name: chain[name] for name in ("alpha", "gamma", "g")})
    if scene.orbit is not None:
        _check_orbit(request, scene.orbit)
    if scene.equilibrium is not None:
        _check_equilibrium(request, scene.equilibrium)
    _check_continuation(request)
    _check_jumps(request)
    _check_families(request)
    _check_perturbation(request)
    if scene.spectrum is not None:
        check_spectrum(request)
    return request


def _bound_lattice(scene: Scene, table: LatticeTable) -> Request:
    with faults_at("[lattice] "):
        lattice: Any = lattice_of(table)
    if table.long:
        return Request(scene, lattice, dict(lattice.parameters))
    return Request(scene, lattice, dict(zip(lattice.parameter_names, lattice.nominal or (), strict=True)))


def _bound_file(scene: Scene, table: ModelTable, scene_path: Path, files: Files) -> Request:
    from casadi_skin.model.saved import loads
    from casadi_skin.zero.statement import BoundaryValueProblem

    path, kinds = scene_path.parent / table.file, (OdeModel, BoundaryValueProblem)
    with faults_at("[model] "):
        if (path, table.name) not in files:
            source = read_source(path)
            names: dict[str, Any] = {} if path.suffix == ".json" else run_file(path, source)
            found = loads(source, str(path)) if table.name is None else named(path, names, table.name, kinds)
            files[path, table.name] = source, names, found
        source, names, found = files[path, table.name]
    if isinstance(found, BoundaryValueProblem):
        return bound_problem(scene, table, path, source, found, names)
    if scene.solution is not None:
        given = f"with {table.name}, an OdeModel"
        raise refusal("[solution]", given, "[orbit], or a BoundaryValueProblem")
    return Request(scene, found, values_of(found, table.parameters), path, source)


def _placed(message: str, table: str = "family") -> str:
    """A message about an argument of a family, with the table that it is in; one about the model with `table`."""
    argument, _, words = message.partition(": ")
    if argument in ("model", "lattice"):
        return f"[{table}]: {words}"
    if argument == "stability_sites":
        return f"[stability] sites: {words}"
    homes = ("family", "method", "accuracy", "chain", "model")
    home = next((name for name in homes if argument in TABLES[name].__struct_encode_fields__), "")
    return f"[{home}] {message}" if home else f"[{table}]: {message}"


def _check_families(request: Request) -> None:
    """Refuse families that cannot be followed, one requested twice, and orbits of families that are not followed."""
    scene = request.scene
    with faults_at(_placed):
        modes = [family.mode for family in request.families]
        if scene.accuracy.certify:
            from casadi_skin.certify.certify import provable
            from casadi_skin.follow.family import Family

            for family in request.families:
                provable(Family(family))  # refuses those that the theorem is not about, and all without python-flint
    if not modes:
        return
    for i, mode in enumerate(modes):
        if mode in modes[:i]:
            raise refusal("[family] mode", f"mode {mode} more than once", "each mode once")
    for name, table in (("dynamics", scene.dynamics), ("export", scene.export)):
        if table is not None and table.mode is not None and table.mode not in modes:
            raise refusal(f"[{name}] mode", str(table.mode), f"one of the modes of [family], {modes}")


def _check_jumps(request: Request) -> None:
    """Refuse equilibria and orbits of equations that jump along them; only of such equations they are sought here."""
    scene = request.scene
    if not scene.given("equilibrium", "orbit", "solution") or not request.ode.jumps.by_name:
        return
    from casadi_skin.runs.first_solution import first_solution

    try:
        first_solution(request)
    except JumpError as error:
        raise SceneError(f"[model] {error}") from None
    except (ArithmeticError, ValueError):  # none is found: the run says why
        return


def _check_perturbation(request: Request) -> None:
    """Refuse a perturbation that the states of the model do not have."""
    table, model, scene = request.scene.dynamics, request.model, request.scene
    if table is not None and scene.family is None and scene.orbit is None:
        from casadi_skin.runs.first_solution import start_near_rest

        with faults_at("[dynamics] "):
            start_near_rest(request)
        return
    if table is None or scene.chain is not None:
        return
    accepted = f"{model.size} numbers" if model.order == 1 else (
        f"{model.size} displacements, or these and {model.size} velocities")  # fmt: skip
    if table.vector is not None and len(table.vector) not in (model.size, model.full_size):
        raise refusal("[dynamics] vector", f"a list of {len(table.vector)}", accepted)
    if table.site is not None and not 1 <= table.site <= model.size:
        names = ", ".join(model.state_names[: model.size])
        raise refusal("[dynamics] site", str(table.site), f"whole numbers from 1 to {model.size} ({names})")


def check_spectrum(request: Request) -> None:
    """Raises SceneError where linear frequencies cannot be shown."""
    from casadi_skin.lattice.spectrum import linear_frequencies

    if request.scene.lattice is not None:  # frequencies that are not real are written as they are
        return
    chain = request.scene.chain
    place = partial(_placed, table="spectrum") if chain is None else f"[chain] alpha: given {chain.alpha:g}; "
    with faults_at(place):
        linear_frequencies(request.model, request.parameters)


def _check_equilibrium(request: Request, table: EquilibriumTable) -> None:
    model = request.equations
    if model.forced:
        raise refusal("[equilibrium]", f"with {model.name}, which is forced", "[orbit], or a model without time")
    check_state("[equilibrium] start", table.start, model.state_names)


def _check_continuation(request: Request) -> None:
    """Refuse parameters and values that a branch, or a curve in a second parameter, does not come to."""
    scene, table, values = request.scene, request.scene.continuation, dict(request.parameters)
    if table is None:
        return
    problem, family = request.problem, scene.family is not None
    if problem is not None and (problem.optimises or problem.bounds):
        what = "an objective" if problem.optimises else "bounds"
        raise refusal("[continuation]", f"with a problem that has {what}", "a problem without")
    if SELECTED not in values and scene.orbit is not None and scene.orbit.select is not None:
        values[SELECTED] = next(iter(scene.orbit.select.values()))
    if not family:
        free = () if problem is None else problem.free
        check_known("[continuation] parameter", table.parameter, [name for name in values if name not in free])
    if table.curve is not None:
        name, to = table.curve.parameter, table.curve.to
        check_known("[continuation] curve", name, [other for other in values if family or other != table.parameter])
        if to == values[name]:
            raise refusal("[continuation] curve", f"to = {to!r}, where it starts", "another number")
        if family and scene.chain is not None and name == "gamma" and abs(to) >= 1:
            raise refusal("[continuation] curve", f"to = {to!r} for gamma", "numbers between -1 and 1")
    if family:
        return
    start = values[table.parameter]
    if table.to == start:
        raise refusal("[continuation] to", f"{table.to!r}, where the branch starts", "another number")
    if scene.chain is not None and table.parameter == "gamma" and abs(table.to) > 1:
        raise refusal("[continuation] to", f"{table.to!r} for gamma", "numbers from -1 to 1")
    if table.back_to is not None and not (table.back_to - start) * (table.to - start) < 0.0:
        side = "below" if table.to > start else "above"
        raise refusal("[continuation] back_to", repr(table.back_to), f"a number {side} {start!r}, where it starts")
    low, high = sorted((start if table.back_to is None else table.back_to, table.to))
    for item, value in enumerate(table.at, start=1):
        if not low <= value <= high:
            raise refusal("[continuation] at", f"{value!r} as item {item}", f"numbers from {low!r} to {high!r}")


def bound(scene: Scene, path: Path) -> Request:
    """The request of a scene; raises SceneError and InputError that begin with its file."""
    try:
        request = bind(scene, path)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    if scene.search is not None:
        from casadi_skin.runs.tasks import Search

        try:
            Search(request).problem  # noqa: B018  made, and so checked
        except (ValueError, TypeError) as error:
            raise InputError(f"{path}: [search] {error}") from error
    return request
