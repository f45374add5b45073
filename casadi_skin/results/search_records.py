"""Files of a search: search.csv (optima), starts.csv (where each start led), search.nc, and the journal's records."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from casadi_skin.lattice.chain import Chain
from casadi_skin.optimise.nlp import Solution
from casadi_skin.optimise.optimum import CosineOrbit, Optimum
from casadi_skin.optimise.search import SearchResult
from casadi_skin.optimise.search_problem import Ending, Outcome, SearchProblem, Start
from casadi_skin.results.dataset import Cell, Dataset, Variable, versions, write_csv, write_netcdf

PHASES = 401  # of an orbit in search.nc, over a period
MEANINGS = {
    "S": "total amplitude: sum of y_n^2 at t = 0",
    "Omega": "frequency",
    "period": "period",
}
OF_CHAIN = {"gamma": "nonreciprocity of the optimum", "g": "cubic on-site coefficient of the optimum"}


# The journal ---------------------------------------------------------------------------------------------------------


class OutcomeRecord(msgspec.Struct, frozen=True, tag="outcome"):
    """Where one start led; arrays as bytes of little-endian doubles, empty where there is no solution."""

    start: int
    begins: tuple[float, ...]
    ending: Ending
    words: str
    arrays: tuple[bytes, ...]  # x, lam_g, lam_x, free, place, times
    objective: float
    status: str
    iterations: int
    violation: float
    worst: str
    gap: float


def outcome_record(found: Outcome) -> OutcomeRecord:
    """Record of an outcome."""
    s = found.solution or Solution(np.zeros(0), np.zeros(0), np.zeros(0), math.nan, "", 0)
    arrays = (s.x, s.lam_g, s.lam_x, found.free, found.place, found.times)
    return OutcomeRecord(
        found.start.number, found.start.free, found.ending, found.words,
        tuple(values.astype("<f8").tobytes() for values in arrays), s.objective, s.words, s.iterations,
        found.violation, found.worst, found.gap,
    )  # fmt: skip


def restored(record: OutcomeRecord) -> Outcome:
    """The outcome of a record."""
    x, lam_g, lam_x, free, place, times = (np.frombuffer(data, "<f8").copy() for data in record.arrays)
    solution = Solution(x, lam_g, lam_x, record.objective, record.status, record.iterations) if x.size else None
    return Outcome(
        Start(record.start, record.begins), record.ending, record.words, solution, free, place, times,
        record.violation, record.worst, record.gap,
    )  # fmt: skip


# Tables --------------------------------------------------------------------------------------------------------------


def _finite(value: float | None) -> Cell:
    return value if value is not None and math.isfinite(value) else ""


def optimum_row(problem: SearchProblem, optimum: Optimum, rank: int) -> dict[str, Cell]:
    """One row of search.csv; empty where a number is not known, or infinite."""
    check, of_family = optimum.check, isinstance(optimum.orbit, CosineOrbit)
    row: dict[str, Cell] = {"rank": rank}
    if of_family:
        row["on_family"] = "" if optimum.on_family is None else int(optimum.on_family)
    row |= {"objective": optimum.objective, "objective_error": _finite(optimum.errors["objective"])}
    row |= {name: optimum.quantities[0][name] for name in problem.columns}
    row |= {
        "active": "; ".join(optimum.active),
        "kkt": optimum.kkt.largest,
        "curvature": _finite(optimum.curvature),
        problem.resolution_name: optimum.resolution,
        "starts": " ".join(map(str, optimum.starts)),
        "Omega_difference": check.Omega_difference,
        "residual": check.residual,
    }
    row |= {"family_difference": _finite(check.family_difference)} if of_family else {"difference": check.difference}
    return row | {f"error_{name}": _finite(error) for name, error in optimum.errors.items() if name != "objective"}


def start_row(outcome: Outcome, names: Sequence[str]) -> dict[str, Cell]:
    """One row of starts.csv."""
    solution = outcome.solution
    return {
        "start": outcome.start.number,
        "deflated": int(outcome.deflated),
        **{f"from_{name}": value for name, value in zip(names, outcome.start.free, strict=True)},
        "ending": outcome.ending.name.lower(),
        "objective": "" if solution is None else _finite(solution.objective),
        "iterations": 0 if solution is None else solution.iterations,
        "violation": _finite(outcome.gap),
        "violated": outcome.worst if outcome.gap > 0 else "",
        "words": outcome.words,
    }


def write_search(result: SearchResult, directory: Path, scene_text: str, title: str) -> None:
    """Write search.csv, starts.csv and, where there is an optimum, search.nc."""
    found = (*result.optima, *result.others)
    if found:
        rows = [optimum_row(result.problem, optimum, rank) for rank, optimum in enumerate(found, start=1)]
        write_csv(directory / "search.csv", list(rows[0]), rows)
        _write_netcdf(directory / "search.nc", result, scene_text, title)
    if result.outcomes:
        starts = [start_row(outcome, result.problem.free_names) for outcome in result.outcomes]
        write_csv(directory / "starts.csv", list(starts[0]), starts)


# search.nc -----------------------------------------------------------------------------------------------------------


def _write_netcdf(path: Path, result: SearchResult, scene_text: str, title: str) -> None:
    found, problem = (*result.optima, *result.others), result.problem
    variables = [
        Variable("objective", ("optimum",), np.array([o.objective for o in found]), "objective"),
        Variable("kkt", ("optimum",), np.array([o.kkt.largest for o in found]),
                 "largest residual of the conditions of optimality"),
    ]  # fmt: skip
    meanings = MEANINGS | (OF_CHAIN if isinstance(problem.model, Chain) else {})
    for name in problem.columns:
        values = np.array([o.quantities[0][name] for o in found])
        stored = name if name in ("S", "Omega", "period") else f"optimum_{name}"
        variables.append(Variable(stored, ("optimum",), values, meanings.get(name, f"{name} of the optimum")))
    if isinstance(found[0].orbit, CosineOrbit):
        variables += _cosines(found)
    else:
        variables += _states(found, problem.model.state_names)
    known = {"title": title, "scene": scene_text, **versions()}
    if isinstance(problem.model, Chain):
        known |= {name: getattr(problem.model, name) for name in ("sites", "alpha", "gamma", "g")}
    else:
        known |= {"model": problem.model.name}
    known |= {"search_status": result.status.name.lower(), "search_reason": result.reason}
    write_netcdf(path, Dataset(variables, known))


def _cosines(found: Sequence[Optimum]) -> list[Variable]:
    """Profiles and coefficients; the stiffness of every site of a chain."""
    harmonics, sites = max(o.resolution for o in found), found[0].orbit.profile.size
    coefficients = np.zeros((len(found), harmonics, sites))
    for k, optimum in enumerate(found):
        coefficients[k, : optimum.resolution] = optimum.orbit.cosines
    meaning = "c_kn of y_n(t) = sum_k c_kn cos((2k+1) Omega t), k from 0"
    profiles = np.stack([o.orbit.profile for o in found])
    variables = [
        Variable("profile", ("optimum", "site"), profiles, "y_n at t = 0"),
        Variable("coefficients", ("optimum", "harmonic", "site"), coefficients, meaning),
    ]
    if "alpha_n" in found[0].quantities[0]:
        alphas = np.stack([np.atleast_1d(o.alpha_n) for o in found])
        variables.append(Variable("alpha_n", ("optimum", "site"), alphas, "on-site stiffness of every site"))
    return variables


def _states(found: Sequence[Optimum], names: Sequence[str]) -> list[Variable]:
    """States at phases of the period, one variable a state."""
    phases = np.linspace(0.0, 1.0, PHASES)
    states = np.stack([o.orbit.evaluate(phases * o.orbit.period) for o in found])
    return [
        Variable("phase", ("phase",), phases, "place in the period, from 0 to 1"),
        *(Variable(f"state_{name}", ("optimum", "phase"), states[:, :, k], f"{name} along the orbit")
          for k, name in enumerate(names)),
    ]  # fmt: skip
