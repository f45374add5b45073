"""Files of a search: search.csv (optima), starts.csv (what each start led to), search.nc, and the journal's records."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np

from casadi_skin.optimise.result import Optimum, SearchResult
from casadi_skin.optimise.search_nlp import Solution
from casadi_skin.optimise.starts import Ending, Outcome, Start
from casadi_skin.results.dataset import Cell, Dataset, Variable, versions, write_csv, write_netcdf


class OutcomeRecord(msgspec.Struct, frozen=True, tag="outcome"):
    """What one start led to; arrays as bytes of little-endian doubles, empty where there is no solution."""

    start: int
    free: tuple[float, ...]
    ending: Ending
    words: str
    x: bytes
    lam_g: bytes
    lam_x: bytes
    objective: float
    status: str
    iterations: int
    violation: float
    worst: str
    gap: float


def outcome_record(found: Outcome) -> OutcomeRecord:
    """Record of an outcome."""
    s = found.solution or Solution(np.zeros(0), np.zeros(0), np.zeros(0), math.nan, "", 0)
    x, lam_g, lam_x = (values.astype("<f8").tobytes() for values in (s.x, s.lam_g, s.lam_x))
    return OutcomeRecord(
        found.start.number, found.start.free, found.ending, found.words, x, lam_g, lam_x, s.objective, s.words,
        s.iterations, found.violation, found.worst, found.gap,
    )  # fmt: skip


def restored(record: OutcomeRecord) -> Outcome:
    """The outcome of a record."""
    x, lam_g, lam_x = (np.frombuffer(data, "<f8").copy() for data in (record.x, record.lam_g, record.lam_x))
    solution = Solution(x, lam_g, lam_x, record.objective, record.status, record.iterations) if x.size else None
    start = Start(record.start, record.free)
    return Outcome(start, record.ending, record.words, solution, record.violation, record.worst, record.gap)


def _finite(value: float | None) -> Cell:
    return value if value is not None and math.isfinite(value) else ""


def optimum_row(optimum: Optimum, rank: int) -> dict[str, Cell]:
    """One row of search.csv; empty where a number is not known, or infinite."""
    orbit = optimum.orbit
    row: dict[str, Cell] = {
        "rank": rank,
        "on_family": "" if optimum.on_family is None else int(optimum.on_family),
        "objective": optimum.objective,
        "objective_error": _finite(optimum.errors["objective"]),
        "S": orbit.S,
        "Omega": orbit.Omega,
        "gamma": optimum.gamma,
        "alpha": float(np.mean(optimum.alpha_n)),
        "g": optimum.g,
        "active": "; ".join(optimum.active),
        "kkt": optimum.kkt.largest,
        "curvature": _finite(optimum.curvature),
        "harmonics": optimum.harmonics,
        "starts": " ".join(map(str, optimum.starts)),
        "Omega_difference": orbit.check.Omega_difference,
        "residual": orbit.check.residual,
        "family_difference": _finite(orbit.check.family_difference),
    }
    return row | {f"error_{name}": _finite(error) for name, error in optimum.errors.items() if name != "objective"}


def start_row(found: Outcome, names: tuple[str, ...]) -> dict[str, Cell]:
    """One row of starts.csv."""
    solution = found.solution
    return {
        "start": found.start.number,
        "deflated": int(found.deflated),
        **{f"from_{name}": value for name, value in zip(names, found.start.free, strict=True)},
        "ending": found.ending.name.lower(),
        "objective": "" if solution is None else _finite(solution.objective),
        "iterations": 0 if solution is None else solution.iterations,
        "violation": _finite(found.gap),
        "violated": found.worst if found.gap > 0 else "",
        "words": found.words,
    }


def write_search(result: SearchResult, directory: Path, names: tuple[str, ...], scene_text: str, title: str) -> None:
    """Write search.csv, starts.csv and, where there is an optimum, search.nc; dimensionless."""
    found = (*result.optima, *result.others)
    if found:
        rows = [optimum_row(optimum, rank) for rank, optimum in enumerate(found, start=1)]
        write_csv(directory / "search.csv", list(rows[0]), rows)
        _write_netcdf(directory / "search.nc", result, scene_text, title)
    if result.outcomes:
        starts = [start_row(outcome, names) for outcome in result.outcomes]
        write_csv(directory / "starts.csv", list(starts[0]), starts)


def _write_netcdf(path: Path, result: SearchResult, scene_text: str, title: str) -> None:
    found, chain = (*result.optima, *result.others), result.chain
    harmonics = max(optimum.harmonics for optimum in found)
    coefficients = np.zeros((len(found), harmonics, chain.sites))
    for k, optimum in enumerate(found):
        coefficients[k, : optimum.harmonics] = optimum.orbit.coefficients
    meaning = "c_kn of y_n(t) = sum_k c_kn cos((2k+1) Omega t), k from 0"
    profiles = np.stack([o.orbit.profile for o in found])
    variables = [
        Variable("objective", ("optimum",), np.array([o.objective for o in found]), "objective"),
        Variable("S", ("optimum",), np.array([o.S for o in found]), "total amplitude: sum of y_n^2 at t = 0"),
        Variable("Omega", ("optimum",), np.array([o.Omega for o in found]), "frequency"),
        Variable("optimum_gamma", ("optimum",), np.array([o.gamma for o in found]), "nonreciprocity of the optimum"),
        Variable("optimum_g", ("optimum",), np.array([o.g for o in found]), "cubic on-site coefficient of the optimum"),
        Variable("kkt", ("optimum",), np.array([o.kkt.largest for o in found]), "largest KKT residual"),
        Variable(
            "alpha_n", ("optimum", "site"), np.stack([o.alpha_n for o in found]), "on-site stiffness of every site"
        ),
        Variable("profile", ("optimum", "site"), profiles, "y_n at t = 0"),
        Variable("coefficients", ("optimum", "harmonic", "site"), coefficients, meaning),
    ]
    known = {"title": title, "scene": scene_text, **versions()}
    known |= {name: getattr(chain, name) for name in ("sites", "alpha", "gamma", "g")}
    known |= {"search_status": result.status.name.lower(), "search_reason": result.reason}
    write_netcdf(path, Dataset(variables, known))
