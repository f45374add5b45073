"""Tables of a run beside those of its branches: evolutions, changes of stability, special points, searches."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family_series import FamilySeries
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.lattice.chain import Chain
from casadi_skin.optimise.search import SearchProblem, SearchResult
from casadi_skin.optimise.search_problem import Optimum, Outcome
from casadi_skin.points.edges import EdgeCurve
from casadi_skin.results.dataset import Dataset, Variable, versions, write_csv, write_netcdf
from casadi_skin.results.quantities import PROFILE_PHASES, Cell, unique_names
from casadi_skin.stability.tongues.diagram import StabilityDiagram, StabilityEdge, Tongue
from casadi_skin.zero.family import TWO_PI
from casadi_skin.zero.kinds import Unresolved
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import PERIOD

if TYPE_CHECKING:
    from casadi_skin.dynamics.evolution import Evolution

# A time evolution as a table: columns and rows of dynamics.csv, variables of dynamics.nc ------------------------------


def evolution_columns(evolution: Evolution) -> dict[str, Array]:
    """Columns of dynamics.csv: t, the energy where there is one, positions, or states of a model of first order."""
    known = _time_and_energy(evolution)
    names = unique_names(evolution.names[: evolution.equations.positions or evolution.equations.size], ("t", "energy"))
    return known | dict(zip(names, evolution.states.T, strict=False))


def evolution_variables(evolution: Evolution) -> list[Variable]:
    """Variables of dynamics.nc along the dimension `time`."""
    meanings = {"t": "time", "energy": "the conserved quantity"}
    known = [Variable(n, ("time",), values, meanings[n]) for n, values in _time_and_energy(evolution).items()]
    if evolution.equations.positions:
        return [
            *known,
            Variable("displacements", ("time", "site"), evolution.displacements, "displacements y_n"),
            Variable("velocities", ("time", "site"), evolution.velocities, "velocities of y_n"),
        ]
    return [
        *known,
        Variable("states", ("time", "state"), evolution.states, "states; names: state_name"),
        Variable("state_name", ("state",), np.array(evolution.names), "names along `state`"),
    ]


def _time_and_energy(evolution: Evolution) -> dict[str, Array]:
    """Both by name; the time alone where the model declares no energy."""
    return {"t": evolution.t} | ({"energy": evolution.energy} if evolution.has_energy else {})


# Power series of families: series.csv and series.nc -------------------------------------------------------------------


def series_columns(series: FamilySeries) -> dict[str, Array]:
    """Columns of series.csv: coefficients by the power of the variable, with their errors."""
    known = {"mode": np.full(series.order + 1, series.mode), "order": np.arange(series.order + 1)}
    return known | {"Omega": series.Omega, "Omega_error": series.Omega_error, "digits": series.digits}


def write_series(found: Sequence[FamilySeries], directory: Path, attributes: Mapping[str, Any]) -> None:
    """Write series.csv, with the radius of convergence where it is known, and series.nc, with the profiles."""
    rows = list[dict[str, Cell]]()
    for s in found:
        known = s.variable, *((s.radius, s.radius_error) if np.isfinite(s.radius) else ("", ""))
        ends, columns = dict(zip(("variable", "radius", "radius_error"), known, strict=True)), series_columns(s)
        rows += [{**{name: v[k].item() for name, v in columns.items()}, **ends} for k in range(s.order + 1)]
    write_csv(directory / "series.csv", list(rows[0]), rows)
    along, of = ("order", "harmonic", "position"), f"in powers of {found[0].variable}"
    stacked = {
        "mode": ((), "linear mode"), "radius": ((), "radius of convergence in S"),
        "Omega": (along[:1], f"coefficients of Omega {of}"), "profile": (along, f"of cosines of y_n / sqrt(S) {of}"),
        "profile_error": (along, "estimated error of profile"),
    }  # fmt: skip
    variables = [
        Variable(name, ("mode", *dimensions), np.array([getattr(s, name) for s in found]), meaning, True)
        for name, (dimensions, meaning) in stacked.items()
    ]
    variables.append(Variable("harmonic", ("harmonic",), found[0].harmonics, "multiples of Omega"))
    write_netcdf(directory / "series.nc", Dataset(variables, attributes))


# Tables of a family's stability: its changes, edges inside unstable stretches, and tongues ----------------------------

EVENT_COLUMNS = (
    "mode", "S", "Omega", "kind", "stable_before", "stable_after", "mu", "S_width",
    "S_error", "multiplier_real", "multiplier_imaginary", "signatures", "tongue", "tongue_width", "tongue_growth",
)  # fmt: skip
PROVED_COLUMNS = ("proved_S_lower", "proved_S_upper")  # of events.csv, where proofs are requested
TONGUE_COLUMNS = (
    "mode", "tongue", "kind", "S_start", "S_start_error", "S_end", "S_end_error", "width", "growth",
    "max_abs_multiplier", "S_deepest", "modes", "order", "decided",
)  # fmt: skip
UNRESOLVED = "unresolved"  # kind of the rows of stretches that are not known


def event_rows(
    mode: int, diagram: StabilityDiagram, prove: Callable[[Any], tuple[float, float] | None] | None = None
) -> list[dict[str, Cell]]:
    """Rows of events.csv: changes of stability in order, and stretches on which some may be missing.

    With `prove`, which gives two S between which a change is proved or None, they have the columns for it.
    """
    rows = [*edge_rows(mode, diagram, diagram.changes), *(_unresolved(mode, u) for u in diagram.unresolved)]
    if prove is not None:
        brackets = [prove(edge) for edge in diagram.changes] + [None] * len(diagram.unresolved)
        for row, ends in zip(rows, brackets, strict=True):
            row.update(zip(PROVED_COLUMNS, ends or ("", ""), strict=True))
    return sorted(rows, key=lambda row: row["S"] if isinstance(row["S"], float) else -1.0)


def further_rows(mode: int, diagram: StabilityDiagram) -> list[dict[str, Cell]]:
    """Rows of further_events.csv: places where orbits are unstable on both sides, or stable on both."""
    return list(edge_rows(mode, diagram, diagram.further))


def edge_rows(mode: int, diagram: StabilityDiagram, edges: Sequence[StabilityEdge]) -> Iterator[dict[str, Cell]]:
    """Rows of edges of tongues, and of changes of localised multipliers, which bound none."""
    for e in edges:
        signatures = "".join("+" if sign > 0 else "-" for sign in e.signatures)
        values: tuple[Cell, ...] = (
            mode, e.S, e.Omega, e.kind, int(e.stable_before), int(e.stable_after), e.mu, e.S_width,
            e.S_error, e.multiplier.real, e.multiplier.imag, signatures, *_of_tongue(diagram, e),
        )  # fmt: skip
        yield dict(zip(EVENT_COLUMNS, values, strict=True))


def _of_tongue(diagram: StabilityDiagram, edge: StabilityEdge) -> tuple[Cell, Cell, Cell]:
    """Number, width and growth of the tongue that an edge bounds."""
    if edge.tongue is None:
        return "", "", ""
    return edge.tongue + 1, edge.width, diagram.tongues[edge.tongue].growth


def _unresolved(mode: int, stretch: Unresolved) -> dict[str, Cell]:
    known = np.isfinite([stretch.S_start, stretch.S_end]).all()
    row: dict[str, Cell] = dict.fromkeys(EVENT_COLUMNS, "")
    start, width = (stretch.S_start, abs(stretch.S_end - stretch.S_start)) if known else ("", "")
    return {**row, "mode": mode, "S": start, "kind": UNRESOLVED, "S_width": width}


def tongue_rows(mode: int, diagram: StabilityDiagram) -> list[dict[str, Cell]]:
    """Rows of tongues.csv: every tongue, also those too narrow to decide whether they open."""
    decided = [_tongue(mode, number, tongue) for number, tongue in enumerate(diagram.tongues, start=1)]
    rows = [*decided, *(_tongue(mode, "", tongue) for tongue in diagram.undecided)]
    return sorted(rows, key=lambda row: float(row["S_start"]))


def _tongue(mode: int, number: Cell, t: Tongue) -> dict[str, Cell]:
    start, end = ("" if t.open_start else t.start.S_error), ("" if t.open_end else t.end.S_error)
    values: tuple[Cell, ...] = (
        mode, number, t.kind, t.start.S, start, t.end.S, end, t.width, t.growth, t.max_abs_multiplier, t.S_deepest,
        "" if t.modes is None else f"{t.modes[0]} {t.modes[1]}", "" if t.order is None else t.order, int(t.decided),
    )  # fmt: skip
    return dict(zip(TONGUE_COLUMNS, values, strict=True))


def edge_columns(curve: EdgeCurve) -> dict[str, Any]:
    """dict[str, Any] of a curve of edges: parameters, S with its error, Omega, mu and the kind."""
    columns: dict[str, Any] = {"point": np.arange(len(curve))}
    columns |= {name: curve[name] for name in curve.points[0].parameters}
    columns |= {"S_error": curve.errors, "Omega": np.array([point.edge.Omega for point in curve])}
    return columns | {"mu": np.array([point.edge.mu for point in curve])}


# Special points of a single branch, of the branches of a diagram, and of families with what leaves them ---------------

OFFSHOOT_COLUMNS = ("error", "Omega", "period", "mu", "loses")
DIAGRAM_COLUMNS: tuple[str, ...] = ("error", "period", "frequency", "coefficient", "criticality")
PARAMETER = "parameter "  # before its name


def write_special_points(path: Path, branches: Mapping[str, Branch]) -> None:
    """Write special points of branches by name; of a single one, without a name, its changes of stability too.

    Names of parameters have " (of the model)" after them where the table has them.
    """
    name, first = next(iter(branches.items()))
    parameters, after = [first.parameter], DIAGRAM_COLUMNS
    if first.space.is_family:
        parameters, after = ["S"], OFFSHOOT_COLUMNS
    elif name:
        others = [other for other in first.solutions[0].parameters if other != first.parameter]
        parameters += [other for other in others if other not in first.space.free or other != PERIOD]
    else:
        after = ("error", "period") if first.solutions[0].is_orbit else ("error",)
    before = ("branch", "kind") if name else ("kind",)
    names = (*before, *unique_names(parameters, (*before, *after)), *after)
    kinds = (*before, *(PARAMETER + each for each in parameters), *after)
    found = [
        {"branch": each, **cells} for each, branch in branches.items() for cells in _special(branch, after, not name)
    ]
    rows = [{each: cells.get(kind, "") for each, kind in zip(names, kinds, strict=True)} for cells in found]
    write_csv(path, names, rows)


def _special(branch: Branch, wanted: Collection[str], alone: bool) -> Iterator[dict[str, Cell]]:
    """Cells of special points by kind, parameters with PARAMETER, and of unresolved stretches, with widths as errors.

    Of a branch alone changes of stability are among them, in its order.
    """
    points, changes = [_special_point(point, wanted) for point in branch.special_points], iter(branch.located)
    special, found = {id(point.solution) for point in branch.special_points}, iter(points)
    solutions = branch.solutions if alone else ()
    for before, here in zip((*solutions[:1], *solutions), solutions, strict=False):
        if branch.located and before.stable != here.stable:
            change = next(changes)
            kind = f"stability {'gained' if change.stable_after else 'lost'} ({change.kind})"
            at: dict[str, Cell] = {"kind": kind, PARAMETER + branch.parameter: change.value}
            yield at | {"error": change.error, "period": TWO_PI / change.Omega}
        if id(here) in special:
            yield next(found)
    yield from found
    for stretch in branch.passed_over:
        at = {"kind": UNRESOLVED, PARAMETER + branch.parameter: stretch.start}
        yield at | {"error": abs(stretch.end - stretch.start)}


def _special_point(point: SpecialPoint, wanted: Collection[str]) -> dict[str, Cell]:
    cells: dict[str, Cell] = {PARAMETER + each: float(value) for each, value in point.parameters.items()}
    cells |= {"kind": point.kind, "error": point.error}
    if point.solution.is_orbit:
        orbit: Any = point.solution
        cells |= {"period": orbit.period, "Omega": orbit.Omega}
    if point.mu is not None:
        cells |= {"mu": point.mu, "loses": ", ".join(point.lost) if "loses" in wanted else ""}
    if "criticality" in wanted:
        with suppress(ValueError, ArithmeticError):
            coefficient = point.coefficient
            cells |= {"frequency": point.frequency or "", "criticality": point.criticality}
            cells |= {} if math.isnan(coefficient) else {"coefficient": coefficient}
    return cells


GRADIENT_COLUMNS = ("branch", "kind", "of", "value", "parameter", "derivative", "error")


def gradient_rows(
    name: str, branch: Branch, changes: bool, special: bool, failures: list[str]
) -> Iterator[dict[str, Cell]]:
    """Rows of gradient.csv: derivatives of the values of changes of stability of a family, and of special points.

    Kinds without derivatives are left out; `failures` gets the reasons of points that are not found again.
    """
    edges = range(len(branch.changes)) if changes and branch.space.is_family else ()
    for place in (*edges, *(branch.special_points if special else ())):
        try:
            point = branch.edge(place) if isinstance(place, int) else place
            found = point.gradient()
        except ValueError:
            continue
        except ArithmeticError as error:
            failures.append(f"gradient: {error}")
            continue
        for parameter, slope in found.items():
            values = name, point.kind, point.parameter, found.value, parameter, _finite(slope), found.errors[parameter]
            yield dict(zip(GRADIENT_COLUMNS, values, strict=True))


# Files of a search: search.csv (optima), starts.csv (where each start led), search.nc, and the journal's records ------

COLUMN_MEANINGS = {"S": "total amplitude: sum of y_n^2 at t = 0", "Omega": "frequency", "period": "period"}
OF_CHAIN = {"gamma": "nonreciprocity of the optimum", "g": "cubic on-site coefficient of the optimum"}


def _finite(value: float | None) -> Cell:
    return value if value is not None and math.isfinite(value) else ""


def optimum_row(problem: SearchProblem, optimum: Optimum, rank: int) -> dict[str, Cell]:
    """One row of search.csv; empty where a number is not known, or infinite."""
    check, of_family = optimum.check, problem.of_family
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
    meanings = COLUMN_MEANINGS | (OF_CHAIN if isinstance(problem.model, Chain) else {})
    for name in problem.columns:
        values = np.array([o.quantities[0][name] for o in found])
        stored = name if name in ("S", "Omega", "period") else f"optimum_{name}"
        variables.append(Variable(stored, ("optimum",), values, meanings.get(name, f"{name} of the optimum")))
    variables += _cosines(found) if problem.of_family else _states(found, problem.model.state_names)
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
    states = np.stack([o.orbit.evaluate(PROFILE_PHASES * o.orbit.period) for o in found])
    return [
        Variable("phase", ("phase",), PROFILE_PHASES, "place in the period, from 0 to 1"),
        *(Variable(f"state_{name}", ("optimum", "phase"), states[:, :, k], f"{name} along the orbit")
          for k, name in enumerate(names)),
    ]  # fmt: skip
