"""The first orbit or solution of a scene: simulated, cut to a cycle, corrected."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from casadi_skin.dynamics.evolution import PHYSICAL, Cycle, Evolution, equations_of_motion
from casadi_skin.dynamics.evolve import simulate
from casadi_skin.dynamics.starts import initial_state
from casadi_skin.follow.find import find_orbit
from casadi_skin.follow.rest_space import find_equilibrium
from casadi_skin.follow.solution import Orbit, Solution
from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel
from casadi_skin.results.branch_records import BranchRecord, CycleRecord, data_of, value_of
from casadi_skin.results.store import DAMAGED_FILE_ERRORS
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import SELECTED
from casadi_skin.zero.problem import Array

CYCLE_SAMPLES = 801  # of the cycle that is the guess
TRANSIENT_SAMPLES = 20_001  # of a transient whose cycle is not known before


def first_solution(request: Request, simulated: Cycle | None = None) -> Solution:
    """The equilibrium, the orbit or the solution of a scene; an orbit from its simulated cycle.

    Raises EquilibriumError and BoundaryError where none is found, IntegrationError and ValueError where `cycle` does,
    ValueError where the guess is none.
    """
    if (table := request.scene.equilibrium) is not None:
        how: dict[str, Any] = {"transient": table.transient, "tolerance": request.tolerance}
        return find_equilibrium(request.equations, table.start, parameters=request.parameters, **how)
    if request.problem is not None:
        assert request.guess is not None  # as the scene has a [solution]
        solution: Solution = request.problem.solve(request.guess, **request.options)
        return solution
    return _orbit(request, simulated or cycle(request), request.options)


def _orbit(request: Request, guess: Cycle, options: dict[str, Any]) -> Orbit:
    orbit, model, values = request.scene.orbit, request.equations, dict(request.parameters)
    assert orbit is not None
    if orbit.rotations:
        guess = replace(guess, turns=turns_of(orbit.rotations, model))
        options |= {"rotations": orbit.rotations}
    if model.forced:
        return find_orbit(model, guess, parameters=values, cycles=orbit.cycles, **options)
    select, section = request.condition(orbit.select), request.condition(orbit.section)
    followed = request.scene.continuation
    if followed is not None and followed.parameter == SELECTED and SELECTED not in values:
        ((name, values[SELECTED]),) = (orbit.select or {}).items()
        model, expression = model.with_parameter(SELECTED, request.quantity(name))
        select = expression - model.parameters[-1]
    options |= {"select": select, "section": section, "symmetric": orbit.symmetric}
    return find_orbit(model, guess, guess.period, parameters=values, **options)


def cycle(request: Request) -> Cycle:
    """A stretch of a simulation that is the guess of an orbit.

    A forced model starts it at a multiple of its period after the transient, an autonomous one where the section is
    crossed, if there is one. Raises IntegrationError where the simulation fails, ValueError where it does not settle.
    """
    orbit, model, values = request.scene.orbit, request.ode, request.parameters
    assert orbit is not None
    length = orbit.period
    if model.forced:
        length = orbit.cycles * model.forcing_period_at(list(values.values()))
        if not (math.isfinite(length) and length > 0.0):
            raise ValueError(f"[model] parameters: give a period of the forcing of {length:g}; accepted: finite, > 0")
    if length is not None:
        before = length * math.ceil((orbit.transient or 0.0) / length * (1.0 - 1e-12))
        t = np.linspace(before, before + length, CYCLE_SAMPLES)
        simulation = simulate(model, orbit.start, t if before == 0.0 else np.append(0.0, t), parameters=values)
        return Cycle(simulation, before, length)
    t = np.linspace(0.0, float(orbit.transient or 0.0), TRANSIENT_SAMPLES)
    simulated = simulate(model, orbit.start, t, parameters=values)
    if orbit.rotations and any(orbit.rotations.values()):
        return _last_turn(simulated, turns_of(orbit.rotations, model))
    try:
        found = simulated.last_cycle()
    except ValueError as error:
        reason = "perhaps it rests, or has not settled: another start, or a longer transient"
        raise ValueError(f"[orbit] start: {error} ({reason})") from error
    section = request.condition(orbit.section)
    return found if section is None else _from_section(found, section)


def turns_of(rotations: Mapping[str, int], model: OdeModel) -> tuple[int, ...]:
    """Turns of each state in a period."""
    return tuple(rotations.get(name, 0) for name in model.state_names)


def _last_turn(simulated: Evolution, turns: tuple[int, ...]) -> Cycle:
    """The last stretch of a simulation in which the first angle that rotates makes its turns."""
    component = int(np.flatnonzero(turns)[0])
    angle = simulated.states[:, component]
    left = (angle[-1] - 2.0 * np.pi * turns[component] - angle) * np.sign(turns[component])
    before = np.flatnonzero(left >= 0.0)
    if before.size == 0:
        words = f"{simulated.equations.physical.state_names[component]} makes no {turns[component]} turns"
        accepted = "a longer transient, a start that rotates, or a period"
        raise ValueError(f"[orbit] rotations: {words} in the simulation; accepted: {accepted}")
    i = int(before[-1])
    part = left[i] / (left[i] - left[i + 1])
    start = float(simulated.t[i] + part * (simulated.t[i + 1] - simulated.t[i]))
    before_these = np.floor(angle[i] / (2.0 * np.pi * turns[component]))
    last = replace(simulated, states=simulated.states - 2.0 * np.pi * before_these * np.array(turns))
    return Cycle(last, start, float(simulated.t[-1]) - start, turns)


def cycle_record(cycle: Cycle) -> CycleRecord:
    """Record of a simulated cycle: its stretch of the simulation."""
    t = cycle.evolution.t
    first = max(int(np.searchsorted(t, cycle.start, "right")) - 1, 0)
    last = min(int(np.searchsorted(t, cycle.start + cycle.period)) + 1, t.size)
    part = slice(first, last)
    states = data_of(cycle.evolution.states[part])
    return CycleRecord("", data_of(t[part]), states, float(cycle.start), float(cycle.period))


def known_cycle(records: Sequence[BranchRecord], model: OdeModel, parameters: Mapping[str, float]) -> Cycle | None:
    """The simulated cycle of a model that records hold; None where they hold none."""
    found = next((record for record in records if isinstance(record, CycleRecord)), None)
    if found is None:
        return None
    equations = equations_of_motion(model.first_order(), parameters)
    try:
        t, states = value_of(found.t), value_of(found.states)
        whole = states.shape == (t.size, equations.size) and np.all(np.isfinite(states)) and np.all(np.diff(t) > 0.0)
        if not (whole and t[0] <= found.start and 0.0 < found.period <= t[-1] - t[0]):
            return None
    except DAMAGED_FILE_ERRORS:
        return None
    evolution = Evolution(equations, t, states, "cvodes", 0.0, PHYSICAL, 0)
    return Cycle(evolution, found.start, found.period)


def _from_section(found: Cycle, section: Expression) -> Cycle:
    """The cycle from the first place on at which the section's expression passes zero; as it is where it never does."""
    evolution = found.evolution
    t = np.linspace(0.0, found.period, CYCLE_SAMPLES)
    function, parameters = evolution.equations.physical.function("section", section), evolution.equations.values
    values = np.array([float(function(0.0, state, parameters)) for state in found.evaluate(t)])
    crossed = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    if crossed.size == 0:
        return found
    i = int(crossed[0])
    start = found.start + t[i] + (t[i + 1] - t[i]) * values[i] / (values[i] - values[i + 1])
    end = float(evolution.t[-1])
    while start + found.period > end:  # the cycle has to lie in the simulated time
        start -= found.period
    return Cycle(evolution, start, found.period) if start >= 0.0 else found


def start_near_rest(request: Request) -> tuple[Array, Array | None]:
    """The state that a scene without an orbit starts from; raises ValueError for one that the model does not have."""
    dynamics: Any = request.scene.dynamics
    start = {name: getattr(dynamics, name) for name in ("mode", "site", "vector", "seed", "moving")}
    return initial_state(request.model, dynamics.size or 0.0, **start, parameters=request.model_parameters)
