"""Files of a search: search.csv (optima), starts.csv (where each start led), search.nc, and the journal's records."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from casadi_skin.files import replacing
from casadi_skin.lattice.chain import Chain
from casadi_skin.optimise.nlp import Solution
from casadi_skin.optimise.result import CosineOrbit, Optimum, SearchResult
from casadi_skin.optimise.search_problem import Ending, Outcome, SearchProblem, Start
from casadi_skin.results.netcdf import put, write_origin, write_versions
from casadi_skin.results.tables import Cell, write_csv

if TYPE_CHECKING:
    from scipy.io import netcdf_file

PHASES = 401  # of an orbit in search.nc, over a period
MEANINGS = {
    "S": "total amplitude: sum of y_n^2 at t = 0",
    "Omega": "frequency",
    "period": "period",
    "gamma": "nonreciprocity of the optimum",
    "g": "cubic on-site coefficient of the optimum",
}


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
    from scipy.io import netcdf_file

    found, problem = (*result.optima, *result.others), result.problem
    with replacing(path) as temporary, netcdf_file(temporary, "w", version=2) as file:
        if isinstance(problem.model, Chain):
            write_origin(file, problem.model, scene_text, title)
        else:
            write_versions(file, scene_text, title)
            setattr(file, "model", problem.model.name)  # noqa: B010
        setattr(file, "search_status", result.status.name.lower())  # noqa: B010
        setattr(file, "search_reason", result.reason)  # noqa: B010
        file.createDimension("optimum", len(found))
        put(file, "objective", ("optimum",), np.array([o.objective for o in found]), "objective")
        kkt = np.array([o.kkt.largest for o in found])
        put(file, "kkt", ("optimum",), kkt, "largest residual of the conditions of optimality")
        for name in problem.columns:
            values = np.array([o.quantities[0][name] for o in found])
            stored = name if name in ("S", "Omega", "period") else f"optimum_{name}"
            put(file, stored, ("optimum",), values, MEANINGS.get(name, f"{name} of the optimum"))
        if isinstance(found[0].orbit, CosineOrbit):
            _put_cosines(file, found)
        else:
            _put_states(file, found, problem.model.state_names)


def _put_cosines(file: netcdf_file, found: Sequence[Optimum]) -> None:
    """Profiles and coefficients; the stiffness of every site of a chain."""
    harmonics, sites = max(o.resolution for o in found), found[0].orbit.profile.size
    coefficients = np.zeros((len(found), harmonics, sites))
    for k, optimum in enumerate(found):
        coefficients[k, : optimum.resolution] = optimum.orbit.coefficients
    file.createDimension("harmonic", harmonics)
    file.createDimension("site", sites)
    if "alpha_n" in found[0].quantities[0]:
        alphas = np.stack([np.atleast_1d(o.alpha_n) for o in found])
        put(file, "alpha_n", ("optimum", "site"), alphas, "on-site stiffness of every site")
    put(file, "profile", ("optimum", "site"), np.stack([o.orbit.profile for o in found]), "y_n at t = 0")
    meaning = "c_kn of y_n(t) = sum_k c_kn cos((2k+1) Omega t), k from 0"
    put(file, "coefficients", ("optimum", "harmonic", "site"), coefficients, meaning)


def _put_states(file: netcdf_file, found: Sequence[Optimum], names: Sequence[str]) -> None:
    """States at phases of the period, one variable a state."""
    phases = np.linspace(0.0, 1.0, PHASES)
    file.createDimension("phase", PHASES)
    put(file, "phase", ("phase",), phases, "place in the period, from 0 to 1")
    states = np.stack([o.orbit.evaluate(phases * o.orbit.period) for o in found])
    for k, name in enumerate(names):
        put(file, f"state_{name}", ("optimum", "phase"), states[:, :, k], f"{name} along the orbit")
