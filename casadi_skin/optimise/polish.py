"""An optimum of the starts made final: on more harmonics, with its error estimate, active bounds and checks."""

from __future__ import annotations

import numpy as np

from casadi_skin.optimise.names import NAMED
from casadi_skin.optimise.optimality import Indices, curvature, kkt
from casadi_skin.optimise.result import FoundOrbit, Optimum, physical_coefficients
from casadi_skin.optimise.search_nlp import SearchNlp, Solution, programme
from casadi_skin.optimise.starts import HARMONICS, Ending, Outcome, chain_at, outcome
from casadi_skin.optimise.verify import plain_check

FLAT = 1e-9  # curvature of an objective that does not tell neighbours apart
NEAR_BOUND = 1e-6  # distance to a bound, relative to the range or to 1, at which it holds
MOVED = 1e-2  # relative change of Omega by more harmonics of what is no optimum but on the coarse grid


def finished(nlp: SearchNlp, found: Outcome, numbers: tuple[int, ...]) -> Optimum | None:
    """The optimum of an outcome on as many harmonics as the tolerance asks for; None where more do not confirm it.

    An orbit off the family asked for is taken no farther than the first step that shows so.
    """
    if found.solution is None:
        return None
    solution, best = found.solution, None
    for harmonics in (level for level in HARMONICS if level > nlp.harmonics):
        finer = programme(nlp.request, harmonics)
        better = finer.solve(nlp.prolonged(solution.x, finer), polish=True)
        if outcome(finer, found.start, better).ending is not Ending.CONVERGED:
            break
        errors = differences(nlp, solution, finer, better)
        nlp, solution = finer, better
        best = optimum(nlp, solution, numbers, errors)
        flat = best.curvature < FLAT  # no resolution would settle it
        if errors["Omega"] > MOVED * best.Omega and not flat:
            return None
        allowed = nlp.request.tolerance
        settled = errors["objective"] <= allowed * max(1.0, abs(best.objective))
        if flat or best.on_family is False or (settled and errors["Omega"] <= allowed * best.Omega):
            break
    return best


def differences(nlp: SearchNlp, solution: Solution, finer: SearchNlp, better: Solution) -> dict[str, float]:
    """What objective, Omega and free numbers differ by."""
    moved = np.abs(finer.free_of(better.x) - nlp.free_of(solution.x))
    turned = np.max(np.abs(finer.frequencies(better.x) - nlp.frequencies(solution.x)))
    names = ("objective", "Omega", *nlp.request.free_names)
    values = (abs(better.objective - solution.objective), float(turned), *moved.tolist())
    return dict(zip(names, values, strict=True))


def optimum(nlp: SearchNlp, solution: Solution, numbers: tuple[int, ...], errors: dict[str, float]) -> Optimum:
    """A solution with all that is told of it; `numbers` are the starts that led to it."""
    x, request = solution.x, nlp.request
    chain = chain_at(request, nlp.free_of(x))
    named = nlp.values(x, tuple(NAMED))
    orbits = []
    for k in range(len(request.amplitudes)):
        S, Omega = nlp.amplitude(x, k), float(np.sqrt(nlp.square_of(x, k)))
        coefficients = physical_coefficients(nlp.state_of(x, k), np.sqrt(S) * chain.rho)
        orbits.append(FoundOrbit(S, Omega, coefficients, named[k], plain_check(nlp, x, k)))
    words, unknowns, rows = _active(nlp, solution)
    return Optimum(
        objective=solution.objective,
        parameters=dict(zip(request.free_names, nlp.free_of(x).tolist(), strict=True)),
        alpha_n=nlp.parameter(x, "alpha_n"),
        gamma=chain.gamma,
        g=chain.g,
        orbits=tuple(orbits),
        conditions=nlp.conditions(x),
        active=words,
        kkt=kkt(nlp, solution),
        curvature=curvature(nlp, solution, unknowns, rows),
        errors=errors,
        harmonics=nlp.harmonics,
        starts=numbers,
        x=x,
    )


def _active(nlp: SearchNlp, solution: Solution) -> tuple[tuple[str, ...], Indices, Indices]:
    """Words for the bounds that hold at a solution, the unknowns at bounds, and the rows of conditions that hold."""
    x, words, unknowns, rows = solution.x, list[str](), list[int](), list[int]()
    for i, (name, (low, high)) in enumerate(zip(nlp.request.free_names, nlp.request.limits, strict=True)):
        near = NEAR_BOUND * (high - low if np.isfinite(high - low) else max(1.0, abs(x[i])))
        for bound, sign in ((low, ">="), (high, "<=")):
            if abs(x[i] - bound) <= near:
                words.append(f"{name} {sign} {bound:.10g}")
                unknowns.append(i)
    row = nlp.equations
    for condition, count in zip(nlp.request.conditions, nlp.rows, strict=True):
        values = nlp.conditions(x)[condition.name]
        for k in range(count):
            for bound, sign in ((condition.lower, ">="), (condition.upper, "<=")):
                if np.isfinite(bound) and abs(values[k] - bound) <= NEAR_BOUND * max(1.0, abs(bound)):
                    rows.append(row + k)
                    if not condition.equality:
                        words.append(f"{condition.name} {sign} {bound:.10g}")
        row += count
    return tuple(words), np.array(unknowns, dtype=np.int64), np.unique(np.array(rows, dtype=np.int64))
