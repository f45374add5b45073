"""Checks of a scene's orbits and boundary-value problems of a model: names, shapes and symmetries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from casadi_skin.follow.find import rotations_of
from casadi_skin.model.loading import call
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.symmetry import pinned_components, symmetry_class
from casadi_skin.runs.faults import SceneError, check_known, refusal, toml_repr
from casadi_skin.runs.model_tables import CONSERVED, ModelTable, OrbitTable
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import Scene
from casadi_skin.runs.states import Numbers, check_state, state_of, values_of
from casadi_skin.solve.guesses import Guess
from casadi_skin.zero.boundary_value_problem import BoundaryValueProblem
from casadi_skin.zero.closure import closure_of
from casadi_skin.zero.orbit_statement import UNFOLDING
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import PERIOD


def check_orbit(request: Request, orbit: OrbitTable) -> None:
    """Raises SceneError for states and parameters that the model does not have, or cannot be closed with."""
    check_state("[orbit] start", orbit.start, request.ode.state_names)
    (_check_forced if request.ode.forced else _check_autonomous)(request, orbit)
    try:
        rotations_of(request.ode, orbit.rotations, orbit.symmetric)
    except ValueError as error:
        raise SceneError(f"[orbit] {error}") from None


def _check_forced(request: Request, orbit: OrbitTable) -> None:
    given = {"period": orbit.period, "select": orbit.select, "section": orbit.section, "symmetric": orbit.symmetric}
    for name, value in given.items():
        if value:
            words = f"with {request.ode.name}, which is forced"
            raise refusal(f"[orbit] {name}", words, "start, transient and cycles")


def _check_autonomous(request: Request, orbit: OrbitTable) -> None:
    model = request.ode
    for name in (PERIOD, UNFOLDING):
        if name in (*model.parameter_names, *model.state_names):
            raise refusal("[model]", f"{model.name} with a state or parameter called {name}", "other names")
    if orbit.cycles != 1:
        given = f"{orbit.cycles} with {model.name}, which is not forced"
        raise refusal("[orbit] cycles", given, "1, or a forced model")
    if orbit.period is None and orbit.transient is None:
        which = "" if orbit.symmetric else " or transient"
        raise SceneError(f"[orbit] period{which}: missing; accepted: with a model that is not forced a number > 0")
    family = orbit.symmetric or model.hamiltonian is not None or bool(model.conserved)
    names = (*model.state_names, *model.outputs)
    if orbit.select is not None:
        conserved = (*model.conserved, *(() if model.hamiltonian is None else (CONSERVED,)))
        check_known("[orbit] select", next(iter(orbit.select)), (*names, *conserved))
        if not family:
            raise refusal("[orbit] select", f"with {model.name}", "with a hamiltonian, or with symmetric = true")
    elif family:
        why = "symmetric" if orbit.symmetric else "conservative"
        raise SceneError(f"[orbit] select: missing; accepted: a table with one number: {why} orbits come in families")
    if orbit.section is not None:
        check_known("[orbit] section", next(iter(orbit.section)), names)
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


def bound_problem(
    scene: Scene, table: ModelTable, path: Path, source: str, problem: BoundaryValueProblem, names: Mapping[str, Any]
) -> Request:
    """The request of a scene whose file states a boundary-value problem; raises SceneError."""
    for name in ("equilibrium", "orbit", "family", "spectrum", "export", "search"):
        if getattr(scene, name) is not None:
            given = f"with {table.name}, a BoundaryValueProblem"
            raise refusal(f"[{name}]", given, "[solution], or an OdeModel")
    values = values_of(problem.model, {**problem.parameters, **table.parameters})
    try:
        problem = replace(problem, parameters=values)
    except ValueError as error:  # an interval that is empty at these values
        raise SceneError(f"[model] parameters: {error}") from None
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
        try:
            return np.asarray(call(path, given, names[given], t), dtype=float).ravel()
        except (TypeError, ValueError) as error:
            raise SceneError(f"{place}: {error}") from None

    start, _ = problem.span(np.array(list(problem.values.values())))
    count = guess(start).size
    if count != len(states):
        raise refusal(place, f"{given}, which returns {count} numbers", f"{len(states)}: {', '.join(states)}")
    return guess
