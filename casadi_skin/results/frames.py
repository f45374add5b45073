"""Results as tables of other packages: pandas and xarray, each an extra that is imported on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.solution import Equilibrium, Solution
from casadi_skin.points.diagram import Diagram
from casadi_skin.points.edges import EdgeCurve
from casadi_skin.results import frames_analyses
from casadi_skin.results.columns import Columns, table
from casadi_skin.results.dataset import Dataset, Variable, to_xarray, unique_names
from casadi_skin.results.quantities import branch_to_xarray, places_of, quantities_of
from casadi_skin.results.quantity import BOTH, CSV
from casadi_skin.stability.result import Floquet
from casadi_skin.zero.statics import Spectrum

if TYPE_CHECKING:
    import pandas
    import xarray

SAMPLES = 401  # times of an orbit
REGISTERED = frames_analyses  # its tables count once it is loaded


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
        quantities = quantities_of(result) if result.solutions else []
        columns = [q for q in quantities if not q.dimensions and q.where in (CSV, BOTH)]
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
