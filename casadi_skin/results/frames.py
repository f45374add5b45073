"""Results as tables of other packages: pandas and xarray, each an extra that is imported on first use."""

from __future__ import annotations

from functools import singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.certify.certificate import Certificate, ProvedStability, ProvedStretch
from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.dynamics.starts import Spreading
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.solution import Equilibrium, Solution
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.lattice.linear import Bands, LatticeModes
from casadi_skin.optimise.kick import SmallestKick
from casadi_skin.optimise.optimum import Optimum
from casadi_skin.optimise.search import SearchResult
from casadi_skin.optimise.search_orbit import ParetoFront
from casadi_skin.points.diagram import Diagram
from casadi_skin.points.edge_curve import EdgeCurve
from casadi_skin.results.dataset import Dataset, Variable, branch_to_xarray, to_xarray
from casadi_skin.results.quantities import columns_of, places_of, unique_names
from casadi_skin.results.tables import EVENT_COLUMNS, edge_rows
from casadi_skin.stability.growth import TransientGrowth
from casadi_skin.stability.result import Floquet
from casadi_skin.stability.tongues.diagram import LocalisedDiagram, StabilityDiagram
from casadi_skin.zero.statics import Spectrum

if TYPE_CHECKING:
    import pandas
    import xarray


Columns = dict[str, Any]


@singledispatch
def table(result: Any) -> tuple[str, str, Columns]:
    """The name of the first column, the meaning of the table, and its columns; raises TypeError for other objects."""
    raise TypeError(f"no result: {type(result).__name__}")


# Analyses as tables: stability along a branch, growth, proofs, searches, kicks, modes and bands -----------------------


@table.register
def _(result: SpecialPoint) -> tuple[str, str, Columns]:
    values = {name: [value] for name, value in result.parameters.items()}
    return (
        "special point",
        f"a {result.kind}",
        {"special point": [0], "kind": [result.kind], **values, "error": [result.error]},
    )


@table.register
def _(result: StabilityDiagram) -> tuple[str, str, Columns]:
    rows = [*edge_rows(1, result, result.changes)]
    columns = {name: [row[name] for row in rows] for name in EVENT_COLUMNS if name != "mode"}
    return "change", "changes of stability", {"change": np.arange(1, len(rows) + 1), **columns}


@table.register
def _(result: LocalisedDiagram) -> tuple[str, str, Columns]:
    rows = [*edge_rows(1, result, result.all)]
    names = [name for name in EVENT_COLUMNS if name != "mode" and "tongue" not in name]
    columns = {name: [row[name] for row in rows] for name in names}
    return "change", "changes of localised multipliers", {"change": np.arange(1, len(rows) + 1), **columns}


@table.register
def _(result: TransientGrowth) -> tuple[str, str, Columns]:
    gains = {name: getattr(result, name) for name in ("log10_gain", "log10_bounded", "log10_trivial")}
    return "t", "largest amplification of perturbations against time", {"t": result.t, **gains}


@table.register
def _(result: Certificate) -> tuple[str, str, Columns]:
    low, high = result.profile
    return (
        "position",
        "enclosures of displacements",
        {"position": np.arange(1, low.size + 1), "lower": low, "upper": high},
    )


@table.register
def _(result: ProvedStability) -> tuple[str, str, Columns]:
    low, high = result.brackets.T
    columns = {"lower": low, "upper": high, "signature": result.signatures}
    return "exponent", "enclosures of exponents", {"exponent": np.arange(1, low.size + 1), **columns}


@table.register
def _(result: ProvedStretch) -> tuple[str, str, Columns]:
    ends = np.array([result.S_start, *result.breaks, result.S_end])
    columns = {"S_start": ends[:-1], "S_end": ends[1:]}
    return "piece", "proved pieces of a family", {"piece": np.arange(1, ends.size), **columns}


@table.register
def _(result: SearchResult) -> tuple[str, str, Columns]:
    return "optimum", "optima of a search", _optima(result.optima)


@table.register
def _(result: ParetoFront) -> tuple[str, str, Columns]:
    both = dict(zip(result.names, result.values.T, strict=True))
    return "optimum", "a Pareto front", {**_optima(result.points), **both}


def _optima(optima: tuple[Optimum, ...]) -> Columns:
    names = list(optima[0].parameters) if optima else []
    columns: Columns = {"optimum": np.arange(1, len(optima) + 1), "objective": [o.objective for o in optima]}
    columns |= {name: [o.parameters[name] for o in optima] for name in names}
    return columns | {"objective_error": [o.errors.get("objective", np.nan) for o in optima]}


@table.register
def _(result: SmallestKick) -> tuple[str, str, Columns]:
    columns = {"displacement": result.displacements, "velocity": result.velocities}
    return "site", "the smallest kick", {"site": np.arange(1, result.displacements.size + 1), **columns}


@table.register
def _(result: Spreading) -> tuple[str, str, Columns]:
    centres = {f"centre_{k}": values for k, values in enumerate(result.centre.T, start=1)}
    columns = {"participation": result.participation, "second_moment": result.second_moment}
    return "t", "spreading of the energy", {"t": result.t, "energy": result.total, **centres, **columns}


@table.register
def _(result: LatticeModes) -> tuple[str, str, Columns]:
    omega = result.frequencies
    columns = {"omega": omega.real, "growth": omega.imag, "participation": result.participation}
    return "mode", "linear modes", {"mode": np.arange(1, omega.size + 1), **columns}


@table.register
def _(result: Bands) -> tuple[str, str, Columns]:
    waves = {f"k_{i}": values for i, values in enumerate(result.wave_numbers.T, start=1)}
    squares = {f"omega2_{i}": values.real for i, values in enumerate(result.squares.T, start=1)}
    return "point", "bands", {"point": np.arange(len(result.wave_numbers)), **waves, **squares}


SAMPLES = 401  # times of an orbit


def result_to_xarray(result: Any) -> xarray.Dataset:
    """A result as an xarray Dataset: branches along `point`, states along `t`, multipliers along their number."""
    if isinstance(result, Branch):
        return branch_to_xarray(result)
    if isinstance(result, Diagram):
        raise ValueError(
            "to_xarray: given a diagram, whose branches have dimensions of their own; accepted: one branch"
        )
    index, meaning, columns = table(result)
    along = [Variable(name, (index,), np.asarray(values), name) for name, values in columns.items()]
    return to_xarray(Dataset(along, {"title": meaning}), (index,))


def result_to_dataframe(result: Any) -> pandas.DataFrame:
    """A result as a pandas DataFrame; raises ImportError, naming the extra, without pandas."""
    try:
        import pandas
    except ImportError as error:
        extra = 'it comes with the extra: pip install "casadi-skin[pandas]"'
        raise ImportError(f"pandas is not installed; {extra}") from error
    if isinstance(result, Branch):
        columns = columns_of(result)
        return pandas.DataFrame([{q.name: q.of(place) for q in columns} for place in places_of(result)])
    if isinstance(result, Diagram):
        frames = [result_to_dataframe(branch).assign(branch=n) for n, branch in enumerate(result.branches, start=1)]
        return pandas.concat(frames, ignore_index=True)
    return pandas.DataFrame(table(result)[2])


@table.register
def _(result: Solution) -> tuple[str, str, Columns]:
    start, end = result.interval
    t = np.linspace(start, end, SAMPLES)
    names = result.space.state_names
    sites = result.space.output_sites if isinstance(result.space, Family) else None
    values = result.evaluate(t) if sites is None else result.evaluate(t, sites)  # type: ignore[call-arg]
    return "t", "states over the interval or the period", _states(t, names, values)


@table.register
def _(result: Evolution) -> tuple[str, str, Columns]:
    return "t", "states in time", _states(result.t, result.names, result.states)


@table.register
def _(result: Equilibrium) -> tuple[str, str, Columns]:
    names = unique_names(result.space.state_names, ["error"])
    states = {name: [value] for name, value in zip(names, result.positions.tolist(), strict=True)}
    values = {name: [value] for name, value in result.parameters.items() if name not in states}
    known = {"stable": [result.stable], "error": [result.error]}
    return "equilibrium", "an equilibrium", {"equilibrium": [0], **values, **states, **known}


@table.register
def _(result: EdgeCurve) -> tuple[str, str, Columns]:
    return "point", "the edge of a tongue of instability", edge_columns(result)


def edge_columns(curve: EdgeCurve) -> Columns:
    """Columns of a curve of edges: parameters, S with its error, Omega, mu and the kind."""
    columns: Columns = {"point": np.arange(len(curve))}
    columns |= {name: curve[name] for name in curve.points[0].parameters}
    columns |= {"S_error": curve.errors, "Omega": np.array([point.edge.Omega for point in curve])}
    return columns | {"mu": np.array([point.edge.mu for point in curve])}


@table.register
def _(result: Floquet) -> tuple[str, str, Columns]:
    trivial = np.arange(result.multipliers.size) < result.trivial
    outside = np.append(np.zeros(result.trivial, dtype=bool), result.outside)
    return (
        "multiplier",
        "Floquet multipliers",
        _plane("multiplier", result.multipliers, trivial=trivial, outside=outside),
    )


@table.register
def _(result: Spectrum) -> tuple[str, str, Columns]:
    return "eigenvalue", "eigenvalues", _plane("eigenvalue", result.values, error=result.errors)


def _states(t: Any, names: Any, values: Any) -> Columns:
    return {"t": t, **dict(zip(unique_names(map(str, names), ["t"]), values.T, strict=False))}


def _plane(index: str, values: Any, **more: Any) -> Columns:
    number = np.arange(1, values.size + 1)
    return {index: number, "real": values.real, "imaginary": values.imag, "modulus": np.abs(values), **more}
