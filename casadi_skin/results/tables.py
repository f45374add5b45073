"""Tables of a run beside those of its branches: evolutions, changes of stability, special points, designs."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family_series import FamilySeries
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.points.edges import EdgeCurve
from casadi_skin.points.gradient import NoGradientError
from casadi_skin.results.dataset import Dataset, Variable, versions, write_csv, write_netcdf
from casadi_skin.results.quantities import Cell, unique_names
from casadi_skin.search.cosine_orbit import CosineOrbit
from casadi_skin.search.design import Design
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
        radius, error = (s.radius, s.radius_error) if np.isfinite(s.radius) else ("", "")
        ends, columns = {"variable": s.variable, "radius": radius, "radius_error": error}, series_columns(s)
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


def edge_rows(mode: int, diagram: StabilityDiagram, edges: Sequence[StabilityEdge]) -> Iterator[dict[str, Cell]]:
    """Rows of edges of tongues, and of changes of localised multipliers, which bound none."""
    for e in edges:
        signatures = "".join("+" if sign > 0 else "-" for sign in e.signatures)
        tongue = ("", "", "") if e.tongue is None else (e.tongue + 1, e.width, diagram.tongues[e.tongue].growth)
        values: tuple[Cell, ...] = (
            mode, e.S, e.Omega, e.kind, int(e.stable_before), int(e.stable_after), e.mu, e.S_width,
            e.S_error, e.multiplier.real, e.multiplier.imag, signatures, *tongue,
        )  # fmt: skip
        yield dict(zip(EVENT_COLUMNS, values, strict=True))


def _unresolved(mode: int, stretch: Unresolved) -> dict[str, Cell]:
    row: dict[str, Cell] = {**dict.fromkeys(EVENT_COLUMNS, ""), "mode": mode, "kind": UNRESOLVED}
    known = math.isfinite(width := abs(stretch.S_end - stretch.S_start))
    return {**row, "S": stretch.S_start, "S_width": width} if known else row


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
    """Columns of a curve of edges: parameters, S with its error, Omega and mu."""
    parameters = {name: curve[name] for name in curve.points[0].parameters}
    Omega, mu = np.array([(point.edge.Omega, point.edge.mu) for point in curve]).T
    return {"point": np.arange(len(curve)), **parameters, "S_error": curve.errors, "Omega": Omega, "mu": mu}


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
        try:
            coefficient = point.coefficient
            cells |= {"frequency": point.frequency or "", "criticality": point.criticality}
            cells |= {} if math.isnan(coefficient) else {"coefficient": coefficient}
        except (ValueError, ArithmeticError) as error:  # of a kind without a normal form: ValueError
            cells["criticality"] = f"unknown: {error}" if isinstance(error, ArithmeticError) else ""
    return cells


GRADIENT_COLUMNS = ("branch", "kind", "of", "value", "parameter", "derivative", "error")


def gradient_rows(
    name: str, branch: Branch, changes: bool, special: bool, failures: list[str]
) -> Iterator[dict[str, Cell]]:
    """Rows of gradient.csv: derivatives of the values of changes of stability of a family, and of special points.

    Kinds without derivatives are left out; `failures` gets the reasons of others that have none.
    """
    edges = range(len(branch.changes)) if changes and branch.space.is_family else ()
    if edges and branch.localised_diagram is not None:
        failures.append(f"gradient: {len(edges)} changes of localised multipliers, which have no derivatives")
        edges = ()
    for place in (*edges, *(branch.special_points if special else ())):
        try:
            point = branch.edge(place) if isinstance(place, int) else place
            found = point.gradient()
        except NoGradientError:
            continue
        except (ValueError, ArithmeticError) as error:
            failures.append(f"gradient: {error}")
            continue
        for parameter, slope in found.items():
            known = slope if math.isfinite(slope) else ""
            values = name, point.kind, point.parameter, found.value, parameter, known, found.errors[parameter]
            yield dict(zip(GRADIENT_COLUMNS, values, strict=True))


# Files of a design: design.csv (optima), design_path.csv (the way to each), design.nc --------------------------------


def design_row(design: Design, rank: int) -> dict[str, Cell]:
    """One row of design.csv."""
    row: dict[str, Cell] = {"rank": rank, "found": int(design.found), "value": design.value}
    row |= {"value_error": design.error, **design.parameters}
    scalars = {name: value for name, value in design.quantities[0].items() if isinstance(value, float)}
    row |= {name: value for name, value in scalars.items() if name not in row}
    row |= {"active": "; ".join(design.active), "optimality": design.optimality}
    return row | {"optimality_error": design.optimality_error, "designs": len(design.path)}


def write_design(design: Design, directory: Path, scene_text: str, title: str) -> None:
    """Write design.csv, design_path.csv and, of a family, design.nc."""
    every, rows, steps = (design, *design.others), list[dict[str, Cell]](), list[dict[str, Cell]]()
    for rank, one in enumerate(every, start=1):
        rows.append(design_row(one, rank))
        for k, (value, place) in enumerate(zip(one.values, one.path.tolist(), strict=True), start=1):
            at = dict(zip(one.parameters, place, strict=True))
            steps.append({"rank": rank, "design": k, "value": float(value), **at})
    write_csv(directory / "design.csv", list(rows[0]), rows)
    write_csv(directory / "design_path.csv", list(steps[0]), steps)
    if isinstance(design.solution, CosineOrbit):
        known = {"title": title, "scene": scene_text, **versions(), "design_quantity": design.quantity}
        known |= {"design_reason": design.reason, "design_engine": design.engine}
        write_netcdf(directory / "design.nc", Dataset(_cosines(every), known))


def _cosines(found: Sequence[Design]) -> list[Variable]:
    """Profiles and coefficients of orbits of a family."""
    orbits = [one.located for one in found]
    profiles = np.array([[orbit.profile for orbit in row] for row in orbits])
    harmonics = max(orbit.harmonics for row in orbits for orbit in row)
    coefficients = np.array([[orbit.coefficients(harmonics) for orbit in row] for row in orbits])
    meaning, both = "c_kn of y_n(t) = sum_k c_kn cos((2k+1) Omega t), k from 0", ("optimum", "orbit")
    return [
        *(Variable(name, both, np.array([[getattr(orbit, name) for orbit in row] for row in orbits]), words)
          for name, words in (("S", "total amplitude: sum of y_n^2 at t = 0"), ("Omega", "frequency"))),
        Variable("profile", (*both, "site"), profiles, "y_n at t = 0"),
        Variable("coefficients", (*both, "harmonic", "site"), coefficients, meaning),
    ]  # fmt: skip
