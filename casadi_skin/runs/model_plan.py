"""The plan of a scene of a model: what is solved for, what is built; nothing is simulated or solved."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from casadi_skin.bvp.symmetry import SymmetryClass, symmetry_class
from casadi_skin.orbits.find_orbit import PERIOD, UNFOLDING
from casadi_skin.orbits.solve import TABLES
from casadi_skin.runs.model_request import ModelRequest


def plan_lines(request: ModelRequest) -> list[tuple[str, str]]:
    """Pairs (subject, text) that describe what a run of the scene would do."""
    scene, model = request.scene, request.model
    lines = [
        ("model", f"{model.name}, from {request.path}"),
        ("states", ", ".join(model.state_names)),
        ("parameters", _named(request.parameters) or "none"),
        ("declared", _declared(request)),
    ]
    if request.problem is not None and scene.solution is not None:
        lines += _problem_lines(request)
    elif scene.orbit is not None:
        lines += _orbit_lines(request)
    else:
        return [*lines, ("not built", "any boundary-value problem: the scene asks for no [orbit] or [solution]")]
    table = scene.continuation
    if table is not None:
        at = f", points exactly at {', '.join(f'{value:g}' for value in table.at)}" if table.at else ""
        lines.append(("branch", f"in {table.parameter} to {table.to:g}{at}; {table.max_points} points at most"))
    lines.append(("tolerance", f"{scene.accuracy.relative_tolerance:g}, relative, of each state and free parameter"))
    lines.append(("unknowns", _unknowns(request)))
    if scene.stability is not None:
        lines.append(("stability", f"multipliers over the full period at every point, by {scene.method.flow}"))
    else:
        lines.append(("not built", "multipliers: the scene has no [stability]"))
    return lines


def _declared(request: ModelRequest) -> str:
    model = request.model
    words = {
        "time reversal": model.reversal is not None,
        "half-period symmetry": model.half_period is not None,
        "conserved quantity": model.hamiltonian is not None,
        "forced": model.forced,
    }
    return ", ".join(word for word, holds in words.items() if holds) or "no symmetry, no conserved quantity"


def _symmetry(request: ModelRequest) -> SymmetryClass:
    symmetric = request.scene.orbit is not None and request.orbit.symmetric
    return symmetry_class(request.model) if symmetric else SymmetryClass.FULL


def _orbit_lines(request: ModelRequest) -> list[tuple[str, str]]:
    orbit, model = request.orbit, request.model
    start = _named(dict(zip(model.state_names, request.start, strict=True)))
    if model.forced:
        times = "a period" if orbit.cycles == 1 else f"{orbit.cycles} periods"
        what = f"closes after {times} of the forcing"
        after = f", after a transient of {orbit.transient:g} or little more" if orbit.transient else ""
        return [("orbit", what), ("guess", f"{times} simulated from {start}{after}")]
    symmetry, selected = _symmetry(request), "" if orbit.select is None else f", selected by {_named(orbit.select)}"
    if symmetry is SymmetryClass.FULL:
        phase = "an integral phase condition" if orbit.section is None else f"phase zero at {_named(orbit.section)}"
        what = f"the full period, {phase}{selected}"
        what += ", unfolded by a damping that comes back as zero" if model.hamiltonian is not None else ""
    else:
        what = f"{symmetry.reason}{selected}"
    if orbit.period is not None:
        return [("orbit", what), ("guess", f"one period of {orbit.period:g} from {start}")]
    return [("orbit", what), ("guess", f"the last cycle of a simulation for {orbit.transient:g} from {start}")]


def _problem_lines(request: ModelRequest) -> list[tuple[str, str]]:
    problem = request.problem
    assert problem is not None
    start, end = problem.span(np.array(list(request.parameters.values())))
    ends = sum(int(expression.numel()) for expression in problem.conditions)
    integrals = sum(int(expression.numel()) for expression in problem.integrals)
    words = f"t from {start:g} to {end:g}; {ends} conditions at the ends, {integrals} integrals"
    free = f"; free: {', '.join(problem.free)}" if problem.free else ""
    best = "; an objective is minimised" if problem.optimises else ""
    return [("problem", f"{words}{free}{best}")]


def _unknowns(request: ModelRequest) -> str:
    """States at the ends and stages of the intervals, and free parameters, on the first mesh."""
    method, model, problem = request.scene.method, request.model, request.problem
    columns = method.intervals * TABLES[method.transcription](method.degree).ends.size + 1
    unfolded = model.hamiltonian is not None and _symmetry(request) is SymmetryClass.FULL
    orbit = () if model.forced else (PERIOD, UNFOLDING) if unfolded else (PERIOD,)
    free = orbit if problem is None else tuple(problem.free)
    mesh = f"{method.intervals} {method.transcription} intervals of degree {method.degree} at the start"
    also = f"and {', '.join(free)} " if free else ""
    return f"{model.full_size * columns} state values {also}on {mesh}; more where the tolerance asks for it"


def _named(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in values.items())
