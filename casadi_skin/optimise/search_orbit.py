"""The public entry to searches: orbits of a chain, or of any model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from typing import Any

from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import check_options, short_repr, truth, whole
from casadi_skin.model.ode import OdeModel
from casadi_skin.optimise.chain_family import ChainFamily
from casadi_skin.optimise.family_search import FamilySearch
from casadi_skin.optimise.family_statement import FamilyStatement
from casadi_skin.optimise.model_family import ModelFamily
from casadi_skin.optimise.orbit_search import OrbitSearch
from casadi_skin.optimise.result import SearchResult
from casadi_skin.optimise.search import search
from casadi_skin.optimise.search_problem import SearchProblem
from casadi_skin.runs.processes import Report

STARTS = 8


def search_orbit(
    chain_or_model: Chain | OdeModel,
    *,
    free: Sequence[str],
    bounds: Mapping[str, Any] | None = None,
    constraints: Sequence[Any] = (),
    maximise: bool = False,
    starts: int = STARTS,
    seed: int = 0,
    deflate: bool = False,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Report | None = None,
    **stated: Any,
) -> SearchResult:
    """Find the orbits that optimise an objective over free parameters within bounds, from many starts.

    Of a chain, and of a model without a `guess`, orbits of one mode's family are searched, in odd cosines on a quarter
    of the period; the model is then of second order, odd, and reversible with even positions. With a `guess` periodic
    orbits of any model are searched near it, by collocation.

    From each start a plain orbit is solved, and Ipopt (Waechter and Biegler 2006) goes on from there with exact second
    derivatives. Distinct optima are made final on finer discretisations and compared with plain orbits.

    Arguments:
        chain_or_model: a `Chain` of finitely many sites, or an `OdeModel`.
        objective: of a family the name of a quantity, or a function of its `Observables` that returns a scalar CasADi
            expression. Near a guess a name (of a state, an output, a parameter, "period", "Omega" or "hamiltonian") or
            an expression in states and parameters, taken at phase zero.
        running: near a guess: a name or an expression whose mean over the period is added to the objective.
        free: names of the free numbers: of a chain S, gamma, alpha, g, alpha_n (one stiffness a site); of a model its
            parameters and, in a family, S.
        bounds: (lower, upper) by name, None where there is none: of free numbers, of quantities, and near a guess of
            states over the whole period.
        constraints: each a quantity that has to vanish, or (quantity, lower, upper).
        maximise: whether the objective is maximised.
        mode: of a family: the linear mode it grows from, a number from 1, "first" or "last"; by default that of the
            end breather of a chain, the first of a model.
        S: of a family: the total amplitude, sum of y_n^2 at rest, of the orbit or of the first start. With a list there
            is one orbit at each, all share the parameters, and functions get the tuple of their observables.
        guess, period, select, section, symmetric, cycles: the orbit that starts begin near, as in `find_orbit`.
        parameters: values of a model's parameters by name, where they are not nominal.
        tolerance: bound of the estimated relative error by discretisation; near a guess `transcription`, `degree`,
            `corrector` and `intervals` may be given as well, as in `find_orbit`.
        starts: number of starts: the own parameters first, then a Halton sequence within the bounds.
        seed: of that sequence.
        deflate: whether starts that led to a known optimum are used once more, away from it.
        workers, executor: processes that share the starts. Functions then have to be at the top of a module.
        progress: called with a `SearchProgress` at iterations and at the end of every start.

    Returns:
        A `SearchResult`: distinct optima, best first, and why the search ended. Ctrl-C ends it with the best so far.

    Raises:
        ValueError, TypeError: arguments that are not accepted, before anything is solved.
    """
    truth("maximise", maximise)
    truth("deflate", deflate)
    problem = stated_search(
        chain_or_model, free=free, bounds=bounds, constraints=constraints, maximise=maximise, **stated
    )
    numbers = {name: whole(name, value, least) for name, value, least in (("starts", starts, 1), ("seed", seed, 0))}
    first = problem.starts(numbers["starts"], numbers["seed"])
    return search(problem, first, deflate=deflate, progress=progress, workers=workers, executor=executor)


def stated_search(chain_or_model: Chain | OdeModel, **stated: Any) -> SearchProblem:
    """The search of `search_orbit`'s arguments, checked but not run; raises ValueError and TypeError."""
    if isinstance(chain_or_model, OdeModel) and stated.get("guess") is not None:
        return OrbitSearch.of(chain_or_model, **stated)
    mode, S, parameters = stated.pop("mode", None), stated.pop("S", 1.0), stated.pop("parameters", None)
    stated.pop("guess", None)
    check_options("search_orbit", stated, search_orbit, FamilyStatement.of)
    if stated.get("objective") is None:
        raise ValueError("objective: given none; accepted: the name of a quantity, or a function of observables")
    if isinstance(chain_or_model, Chain):
        return FamilySearch.of(ChainFamily.of(chain_or_model, mode), S=S, **stated)
    if isinstance(chain_or_model, OdeModel):
        return FamilySearch.of(ModelFamily.of(chain_or_model, mode, parameters), S=S, **stated)
    raise TypeError(f"chain_or_model: given {short_repr(chain_or_model)}; accepted: a Chain or an OdeModel")
