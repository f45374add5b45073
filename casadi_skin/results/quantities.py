"""The one table of quantities of orbits and solutions: name, meaning, dimensions and how each is had.

CSV files, netCDF files and xarray datasets of branches are made from it. Quantities with a dimension of their own are
left out of CSV; a quantity that some orbits do not have, as the energy of a model that conserves none, is empty there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.solution import Equilibrium, Solution
from casadi_skin.model.arguments import accepted_names
from casadi_skin.results.branch_quantities import PHASES, branch_quantities, family_quantities
from casadi_skin.results.dataset import Cell, Dataset, Variable, to_xarray
from casadi_skin.results.quantity import BOTH, COUNTED, CSV, NETCDF, Place, Quantity
from casadi_skin.results.tables import equilibrium_quantities
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    import xarray


def quantities_of(branch: Branch) -> list[Quantity]:
    """The quantities of a branch of any kind."""
    if isinstance(branch.solutions[0], Equilibrium):
        return equilibrium_quantities(branch)
    return family_quantities(branch) if isinstance(branch.space, Family) else branch_quantities(branch)


def places_of(branch: Branch) -> list[Place]:
    """The solutions of a branch with their marks."""
    mode = branch.space.coordinates.mode_number if isinstance(branch.space, Family) else 0
    return [Place(s, i, mode, s.point.requested, s.point.special) for i, s in enumerate(branch.solutions)]


def along(branch: Branch, name: str) -> Array:
    """Values of a quantity along a branch, shape (solutions, ...); raises KeyError, naming all, for other names."""
    if not branch.solutions:
        return np.empty(0)
    known = {quantity.name: quantity for quantity in quantities_of(branch)}
    if name not in known:
        names = dict.fromkeys([branch.parameter, *branch.solutions[0].parameters, *known])
        raise KeyError(f"{name}; known: {', '.join(filter(None, names))}")
    return np.array([known[name].of(place) for place in places_of(branch)])


def sought(branch: Branch, name: str) -> Callable[[Solution], float]:
    """A number of the table that moves along a branch as a function of a solution.

    Raises ValueError, naming all, for other names; parameters that are the same everywhere are none of them.
    """
    known, free = numbers_of(branch), branch.space.free
    fixed = set(branch.solutions[0].parameters) - {branch.parameter, *free} if branch.solutions else set()
    names = dict.fromkeys([*branch.space.held_names, *free, *(n for n in known if n not in fixed)])
    if name not in names:
        raise ValueError(f"at: given {name}; {accepted_names(name, names)}")
    if name in free:
        return lambda solution: solution.parameters[name]
    return lambda solution: float(known[name].of(Place(solution, 0)))


def numbers_of(branch: Branch) -> dict[str, Quantity]:
    """Quantities of a branch that are real numbers and move along it, by name."""
    table = quantities_of(branch) if branch.solutions else []
    return {q.name: q for q in table if not (q.dimensions or q.name in COUNTED)}


def csv_row(quantities: Sequence[Quantity], place: Place) -> dict[str, Cell]:
    """One row: quantities without dimensions of their own; one that is not finite and may be empty is."""
    row: dict[str, Cell] = {}
    for quantity in quantities:
        if quantity.dimensions or quantity.where not in (CSV, BOTH):
            continue
        value = quantity.of(place)
        row[quantity.name] = "" if quantity.may_be_empty and not math.isfinite(value) else value
    return row


def dataset_of(branches: Sequence[Branch], vectors: bool = False) -> Dataset:
    """All branches along one dimension `point`, in the order given and in arclength order within each.

    Arguments:
        branches: families of one model, or one other branch; at least one solution in all.
        vectors: whether Floquet vectors at requested points are among the variables.

    Returns:
        Variables named as in the table of quantities, with names of states and parameters, sites, phases and meshes.
    """
    held = [branch for branch in branches if len(branch)]
    widest = max(held, key=lambda branch: max((getattr(s, "harmonics", 0) for s in branch.solutions), default=0))
    quantities = [q for q in quantities_of(widest) if q.where in (NETCDF, BOTH)]
    places = [place for branch in held for place in places_of(branch)]
    variables = _axes(held[0])
    for quantity in quantities:
        values = np.array([quantity.of(place) for place in places])
        dimensions = ("point", *quantity.dimensions)
        variables.append(Variable(quantity.name, dimensions, values, quantity.meaning, quantity.may_be_empty))
    if isinstance(held[0].space, BoundarySpace):
        variables.append(_mesh([place.solution for place in places]))
    if vectors:
        variables += _vectors(places)
    return Dataset(variables)


def _axes(branch: Branch) -> list[Variable]:
    """Coordinates along the dimensions of the quantities."""
    solution = branch.solutions[0]
    if isinstance(branch.space, Family):
        sites = branch.orbits[0].output_sites
        meaning = "number of the site, from 1; up to 0 in an infinite chain with gamma > 0"
        return [Variable("site", ("site",), sites, meaning)]
    axes = [Variable("state_name", ("state",), np.array(solution.space.state_names), "names along `state`")]
    if solution.parameters:
        names = np.array(list(solution.parameters))
        axes.append(Variable("parameter_name", ("parameter",), names, "names along `parameter`"))
    if isinstance(solution, Equilibrium):
        return axes
    phases = np.linspace(0.0, 1.0, PHASES)
    return [*axes, Variable("phase", ("phase",), phases, "place in the interval or the period, from 0 to 1")]


def _mesh(solutions: Sequence[Solution]) -> Variable:
    longest = max(s.intervals for s in solutions)
    edges = np.stack([np.append(s.mesh, np.full(longest - s.intervals, np.nan)) for s in solutions])
    meaning = "ends of the intervals of the part that was unknown; empty after it"
    return Variable("mesh", ("point", "edge"), edges, meaning, may_be_empty=True)


def _vectors(places: Sequence[Place]) -> list[Variable]:
    chosen = [i for i, place in enumerate(places) if place.requested]
    if not chosen:
        return []
    vectors = np.stack([places[i].orbit.floquet_vectors() for i in chosen])
    dimensions = ("requested_point", "component", "multiplier")
    return [
        Variable("vectors_point", ("requested_point",), np.array(chosen), "place along `point`, from 0"),
        Variable("vectors", dimensions, vectors, "Floquet vectors (positions, velocities) at t = 0, columns"),
    ]


def branch_to_xarray(branch: Branch) -> xarray.Dataset:
    """A branch as an xarray Dataset along `point`; raises ImportError, naming the extra, without xarray."""
    space, attributes = branch.space, dict[str, Any]()
    if isinstance(space, Family):
        attributes = {**space.coordinates.attributes, "mode": space.coordinates.mode_number}
    return to_xarray(replace(dataset_of([branch]), attributes={**attributes, "tolerance": space.tolerance}), ("site",))


# Tables of results, which modules register by class -------------------------------------------------------------------

Columns = dict[str, Any]


@singledispatch
def table(result: Any) -> tuple[str, str, Columns]:
    """The name of the first column, the meaning of the table, and its columns; raises TypeError for other objects."""
    raise TypeError(f"no result: {type(result).__name__}")
