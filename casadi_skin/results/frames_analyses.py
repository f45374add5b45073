"""Analyses as tables: stability along a branch, growth, proofs, searches, kicks, modes and bands."""

from __future__ import annotations

import numpy as np

from casadi_skin.certify.certificate import Certificate, ProvedStability, ProvedStretch
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.lattice.linear import Bands, LatticeModes
from casadi_skin.lattice.spreading import Spreading
from casadi_skin.optimise.kick import SmallestKick
from casadi_skin.optimise.optimum import Optimum
from casadi_skin.optimise.search import SearchResult
from casadi_skin.optimise.search_orbit import ParetoFront
from casadi_skin.results.columns import Columns, table
from casadi_skin.results.stability_tables import EVENT_COLUMNS, edge_rows
from casadi_skin.stability.growth import TransientGrowth
from casadi_skin.stability.tongues.diagram import StabilityDiagram
from casadi_skin.stability.tongues.localised_diagram import LocalisedDiagram


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
