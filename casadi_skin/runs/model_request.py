"""What a scene of a model asks for, with the model at hand: names and shapes checked before anything is solved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.statement import BoundaryValueProblem, named_values
from casadi_skin.bvp.symmetry import pinned_components, symmetry_class
from casadi_skin.models.declared import Expression
from casadi_skin.models.loading import ModelFileError, call, named, read_source, run_file
from casadi_skin.models.ode import OdeModel
from casadi_skin.orbits.find_orbit import PERIOD, UNFOLDING
from casadi_skin.orbits.guesses import Guess
from casadi_skin.scene.faults import SceneError, did_you_mean, nearest, refusal, toml_repr
from casadi_skin.scene.model_tables import CONSERVED, SELECTED, ModelScene, OrbitTable

KINDS = (OdeModel, BoundaryValueProblem)
Numbers = Sequence[float] | Mapping[str, float]


@dataclass(frozen=True, eq=False)
class ModelRequest:
    """A scene with its model, of first order where an orbit is asked for, or with its boundary-value problem.

    `path` and `source` are the file of the model and its text. `parameters` are the values of all parameters by name.
    `guess` is that of a boundary-value problem.
    """

    scene: ModelScene
    path: Path
    source: str
    model: OdeModel
    parameters: Mapping[str, float]
    problem: BoundaryValueProblem | None = None
    guess: Guess | None = None

    @property
    def orbit(self) -> OrbitTable:
        """The table [orbit]; raises ValueError where there is none."""
        if self.scene.orbit is None:
            raise ValueError("[orbit]: missing; accepted: a scene with an [orbit]")
        return self.scene.orbit

    @property
    def start(self) -> Array:
        """State that the simulation of an orbit starts from, shape (components,)."""
        return _state(self.orbit.start, self.model.state_names)

    def condition(self, given: Mapping[str, float] | None) -> tuple[Expression, float] | None:
        """The expression named by a table with one number, and the number."""
        if given is None:
            return None
        ((name, value),) = given.items()
        names = self.model.state_names
        if name in names:
            return self.model.state[names.index(name)], value
        return (self.model.hamiltonian if name == CONSERVED else self.model.outputs[name]), value


def bind(scene: ModelScene, scene_path: Path) -> ModelRequest:
    """Run or read the scene's file and check what the scene asks of the model in it.

    Raises SceneError, in one line with table and key, or with file and line where the user's code fails.
    """
    path = scene_path.parent / scene.model.file
    try:
        source = read_source(path)
        names: dict[str, Any] = {} if path.suffix == ".json" else run_file(path, source)
        found = OdeModel.read(path) if scene.model.name is None else named(path, names, scene.model.name, KINDS)
    except ModelFileError as error:
        raise SceneError(f"[model] {error}") from None
    except ValueError as error:  # of a damaged .json file
        raise SceneError(f"[model] {error}") from None
    if isinstance(found, BoundaryValueProblem):
        request = _bound_problem(scene, path, source, found, names)
    else:
        request = _bound_model(scene, path, source, found)
    _check_continuation(request)
    return request


def _values(model: OdeModel, given: Mapping[str, float]) -> dict[str, float]:
    for name in given:
        _check_known("[model] parameters", name, model.parameter_names)
    try:
        return named_values(model, given)
    except ValueError as error:
        raise SceneError(f"[model] {error}") from None


# Boundary-value problems ----------------------------------------------------------------------------------------------


def _bound_problem(
    scene: ModelScene, path: Path, source: str, problem: BoundaryValueProblem, names: Mapping[str, Any]
) -> ModelRequest:
    if scene.orbit is not None:
        given = f"with {scene.model.name}, a BoundaryValueProblem"
        raise refusal("[orbit]", given, "[solution], or an OdeModel")
    values = _values(problem.model, {**problem.parameters, **scene.model.parameters})
    try:
        problem = replace(problem, parameters=values)
    except ValueError as error:  # an interval that is empty at these values
        raise SceneError(f"[model] parameters: {error}") from None
    guess = None if scene.solution is None else _guess(scene.solution.guess, path, problem, names)
    return ModelRequest(scene, path, source, problem.model, values, problem, guess)


def _guess(given: str | Numbers, path: Path, problem: BoundaryValueProblem, names: Mapping[str, Any]) -> Guess:
    place, states = "[solution] guess", problem.model.state_names
    if not isinstance(given, str):
        _check_state(place, given, states)
        return _state(given, states)
    functions = [name for name, value in names.items() if callable(value) and not isinstance(value, type)]
    _check_known(place, given, [name for name in functions if not name.startswith("__")])

    def guess(t: float) -> Array:
        try:
            return np.asarray(call(path, given, names[given], t), dtype=float).ravel()
        except (TypeError, ValueError) as error:
            raise SceneError(f"{place}: {error}") from None

    start, _ = problem.span(np.array(list(problem.values.values())))
    count = guess(start).size
    if count != len(states):
        raise refusal(place, f"{given}, which returns {count} numbers", f"{len(states)}: {', '.join(states)}")
    return guess


# Orbits ---------------------------------------------------------------------------------------------------------------


def _bound_model(scene: ModelScene, path: Path, source: str, found: OdeModel) -> ModelRequest:
    if scene.solution is not None:
        given = f"with {scene.model.name}, an OdeModel"
        raise refusal("[solution]", given, "[orbit], or a BoundaryValueProblem")
    values = _values(found, scene.model.parameters)
    request = ModelRequest(scene, path, source, found.first_order(), values)
    if scene.orbit is not None:
        _check_state("[orbit] start", scene.orbit.start, request.model.state_names)
        (_check_forced if found.forced else _check_autonomous)(request.model, scene.orbit)
    return request


def _check_forced(model: OdeModel, orbit: OrbitTable) -> None:
    given = {"period": orbit.period, "select": orbit.select, "section": orbit.section, "symmetric": orbit.symmetric}
    for name, value in given.items():
        if value:
            raise refusal(f"[orbit] {name}", f"with {model.name}, which is forced", "start, transient and cycles")


def _check_autonomous(model: OdeModel, orbit: OrbitTable) -> None:
    for name in (PERIOD, UNFOLDING):
        if name in (*model.parameter_names, *model.state_names):
            raise refusal("[model]", f"{model.name} with a state or parameter called {name}", "other names")
    if orbit.cycles != 1:
        given = f"{orbit.cycles} with {model.name}, which is not forced"
        raise refusal("[orbit] cycles", given, "1, or a forced model")
    if orbit.period is None and orbit.transient is None:
        which = "" if orbit.symmetric else " or transient"
        raise SceneError(f"[orbit] period{which}: missing; accepted: with a model that is not forced a number > 0")
    family = orbit.symmetric or model.hamiltonian is not None
    names = (*model.state_names, *model.outputs)
    if orbit.select is not None:
        conserved = () if model.hamiltonian is None else (CONSERVED,)
        _check_known("[orbit] select", next(iter(orbit.select)), (*names, *conserved))
        if not family:
            raise refusal("[orbit] select", f"with {model.name}", "with a hamiltonian, or with symmetric = true")
    elif family:
        why = "symmetric" if orbit.symmetric else "conservative"
        raise SceneError(f"[orbit] select: missing; accepted: a table with one number: {why} orbits come in families")
    if orbit.section is not None:
        _check_known("[orbit] section", next(iter(orbit.section)), names)
    if orbit.symmetric:
        _check_symmetric(model, orbit)


def _check_symmetric(model: OdeModel, orbit: OrbitTable) -> None:
    if model.reversal is None:
        raise refusal("[orbit] symmetric", f"true with {model.name}", "true with a model that declares a reversal")
    try:
        first, _ = pinned_components(model, symmetry_class(model))
    except ValueError as error:
        raise SceneError(f"[orbit] symmetric: {error}") from None
    name = next(iter(orbit.select or {}))
    pinned = [model.state_names[i] for i in first]
    if name in pinned:
        accepted = f"a quantity that the reversal leaves free; it makes {', '.join(pinned)} vanish at phase zero"
        raise refusal("[orbit] select", toml_repr(name), accepted)


# What both have -------------------------------------------------------------------------------------------------------


def _check_continuation(request: ModelRequest) -> None:
    table, values = request.scene.continuation, dict(request.parameters)
    if table is None:
        return
    problem = request.problem
    if problem is not None and (problem.optimises or problem.bounds):
        what = "an objective" if problem.optimises else "bounds"
        raise refusal("[continuation]", f"with a problem that has {what}", "a problem without")
    if SELECTED not in values and request.scene.orbit is not None and request.scene.orbit.select is not None:
        values[SELECTED] = next(iter(request.scene.orbit.select.values()))
    free = () if problem is None else problem.free
    _check_known("[continuation] parameter", table.parameter, [name for name in values if name not in free])
    if table.to == values[table.parameter]:
        raise refusal("[continuation] to", f"{table.to!r}, where the branch starts", "another number")
    low, high = sorted((values[table.parameter], table.to))
    for item, value in enumerate(table.at, start=1):
        if not low <= value <= high:
            raise refusal("[continuation] at", f"{value!r} as item {item}", f"numbers from {low!r} to {high!r}")


def _state(given: Numbers, names: Sequence[str]) -> Array:
    return np.array([given.get(name, 0.0) for name in names] if isinstance(given, Mapping) else given, dtype=float)


def _check_state(place: str, given: Numbers, names: Sequence[str]) -> None:
    if isinstance(given, Mapping):
        for name in given:
            _check_known(place, name, names)
    elif len(given) != len(names):
        raise refusal(place, f"a list of {len(given)}", f"{len(names)} numbers: {', '.join(names)}")


def _check_known(place: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        near = nearest(name, known)
        hint = did_you_mean(near and toml_repr(near), ", ".join(known) or "none")
        raise SceneError(f"{place}: given {toml_repr(name)}{hint}")
