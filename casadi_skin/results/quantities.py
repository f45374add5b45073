"""The one table of quantities of orbits and solutions: name, meaning, dimensions and how each is had.

CSV files, netCDF files and xarray datasets of branches are made from it. Quantities with a dimension of their own are
left out of CSV; a quantity that some orbits do not have, as the energy of a model that conserves none, is empty there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.equilibria.equilibrium import Equilibrium
from casadi_skin.orbits.boundary_space import BoundarySpace
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.solution import Solution
from casadi_skin.orbits.special_points import FOLD
from casadi_skin.results.dataset import Cell, Dataset, Variable, to_xarray, unique_names
from casadi_skin.results.equilibria import equilibrium_quantities
from casadi_skin.results.quantity import CSV, NETCDF, Place, Quantity
from casadi_skin.stability.result import ReversibleFloquet

if TYPE_CHECKING:
    import xarray

    from casadi_skin.certify.certificate import Certificate

PHASES = 401  # of the common grid of profiles of solutions

# Families -------------------------------------------------------------------------------------------------------------

FAMILY: tuple[Quantity, ...] = (
    Quantity("mode", "linear mode j that the family grows from", lambda p: p.mode),
    Quantity("point", "place along the family", lambda p: p.index, where=CSV),
    Quantity("index", "place along the family", lambda p: p.index, where=NETCDF),
    Quantity("requested", "1 where S, Omega or the period was asked for", lambda p: int(p.requested)),
    Quantity("S", "total amplitude: sum of y_n^2 at t = 0", lambda p: p.orbit.S),
    Quantity("Omega", "frequency", lambda p: p.orbit.Omega),
    Quantity("Omega_shift", "Omega minus the linear frequency", lambda p: p.orbit.Omega_shift),
    Quantity("period", "2 pi/Omega", lambda p: p.orbit.period, where=CSV),
    Quantity("energy", "the conserved quantity", lambda p: energy_of(p.orbit), may_be_empty=True),
)
FAMILY_STABILITY: tuple[Quantity, ...] = (
    Quantity(
        "max_abs_multiplier", "largest modulus, the trivial pair left out", lambda p: p.floquet.max_abs_multiplier
    ),
    Quantity("stable", "1 where no multiplier is outside the unit circle", lambda p: int(p.floquet.stable)),
    Quantity("unstable_real", "multipliers outside the circle, real", lambda p: p.floquet.unstable_real, where=CSV),
    Quantity("unstable_complex", "the same, complex", lambda p: p.floquet.unstable_complex, where=CSV),
    Quantity("multiplier_error", "estimated error of the multipliers", lambda p: p.floquet.error),
)
FAMILY_ERRORS: tuple[Quantity, ...] = (
    Quantity("Omega_error", "estimated absolute error of Omega", lambda p: p.orbit.Omega_error),
    Quantity("residual", "largest residual relative to the largest term", lambda p: p.solution.residual),
    Quantity("profile_error", "estimated relative error of the profile", lambda p: p.orbit.profile_error),
    Quantity(
        "at_round_off", "1 where round-off keeps the errors above the tolerance", lambda p: int(p.solution.at_round_off)
    ),
    Quantity("S_error", "estimated absolute error of S", lambda p: p.orbit.S_error),
)
FAMILY_ARRAYS: tuple[Quantity, ...] = (
    Quantity(
        "resolution", "harmonics or intervals of the discretisation", lambda p: p.solution.point.problem.resolution,
        where=NETCDF,
    ),
    Quantity(
        "profile", "displacements y_n at t = 0", lambda p: p.orbit.evaluate(0.0, p.orbit.output_sites)[0], ("site",)
    ),
    Quantity(
        "log10_profile", "log10 |y_n| at t = 0, also where y_n is below the smallest double; empty where it is 0",
        lambda p: p.orbit.log10_displacements(p.orbit.output_sites)[0], ("site",), may_be_empty=True,
    ),
    Quantity(
        "profile_sign", "sign of y_n at t = 0",
        lambda p: p.orbit.log10_displacements(p.orbit.output_sites)[1].astype(int), ("site",),
    ),
)  # fmt: skip
MULTIPLIERS: tuple[Quantity, ...] = (
    Quantity(
        "trivial_deviation",
        "distance of the trivial multipliers from their exact value",
        lambda p: p.floquet.trivial_deviation,
    ),
    Quantity(
        "multipliers", "Floquet multipliers, the trivial ones first", lambda p: p.floquet.multipliers, ("multiplier",)
    ),
)
REDUCED: tuple[Quantity, ...] = (
    Quantity("mu", "eigenvalues of B^T C", lambda p: p.floquet.mu, ("mu_index",)),  # type: ignore[attr-defined]
    Quantity("mu_error", "estimated errors of mu", lambda p: p.floquet.mu_error, ("mu_index",)),  # type: ignore[attr-defined]
)


def _certificate(place: Place) -> Certificate | None:
    """The proof of an orbit that one is asked for, else None."""
    space = place.orbit.space
    assert isinstance(space, Family)
    return place.orbit.certificate if space.request.certify == "all" or place.requested else None


def _of_proof(value: Callable[[Certificate], float]) -> Callable[[Place], float]:
    def of(place: Place) -> float:
        certificate = _certificate(place)
        return math.nan if certificate is None else value(certificate)

    return of


def certified(branch: Branch) -> list[Orbit]:
    """The orbits of a branch that a proof was asked for."""
    asked = isinstance(branch.space, Family) and branch.space.request.certify
    return [o for o in branch.orbits if asked == "all" or o.point.requested] if asked else []


FAMILY_PROOFS: tuple[Quantity, ...] = (
    Quantity(
        "proved", "1 where the orbit is proved to exist, 0 where it is not; empty where no proof was asked for",
        _of_proof(lambda c: float(c.proved)), may_be_empty=True,
    ),
    Quantity(
        "Omega_lower", "proved lower bound of Omega", _of_proof(lambda c: c.Omega[0]), may_be_empty=True
    ),
    Quantity(
        "Omega_upper", "proved upper bound of Omega", _of_proof(lambda c: c.Omega[1]), may_be_empty=True
    ),
    Quantity(
        "proved_Omega_error", "proved bound of the error of Omega", _of_proof(lambda c: c.Omega_error),
        may_be_empty=True,
    ),
    Quantity(
        "proved_radius", "proved distance of the orbit from the computed one, in the norm of the certificate",
        _of_proof(lambda c: c.radius), may_be_empty=True,
    ),
)  # fmt: skip


def energy_of(orbit: Orbit) -> float:
    """The energy; NaN for a model without a conserved quantity, infinite where an infinite tail moves along."""
    try:
        return orbit.energy
    except ValueError:
        return math.nan


def family_quantities(branch: Branch) -> list[Quantity]:
    """Quantities of the orbits of a family, columns of family.csv in their order and variables of family.nc."""
    assert isinstance(branch.space, Family)
    quantities = [*FAMILY, *(FAMILY_STABILITY if branch.with_stability else ()), *FAMILY_ERRORS]
    first = branch.space.coordinates.regime(branch.solutions[0].point) if len(branch) else None
    if first is not None:
        words = "; ".join(f"{i}: {regime.value}" for i, regime in enumerate(type(first)))
        quantities.append(Quantity("regime", words, lambda p: _regime(p).name.lower(), where=CSV))
        quantities.append(Quantity("regime", words, lambda p: list(type(_regime(p))).index(_regime(p)), where=NETCDF))
    quantities += FAMILY_PROOFS if branch.space.request.certify else ()
    quantities += FAMILY_ARRAYS
    harmonics = max((orbit.harmonics for orbit in branch.orbits), default=0)
    if branch.space.symmetry.value == 0.25:
        meaning = "c_kn of y_n(t) = sum_k c_kn cos((2k+1) Omega t), k from 0"

        def coefficients(place: Place) -> NDArray[np.float64]:
            return place.orbit.coefficients(harmonics, place.orbit.output_sites)

        quantities.append(Quantity("coefficients", meaning, coefficients, ("harmonic", "site")))
    return quantities + _multiplier_quantities(branch)


def _multiplier_quantities(branch: Branch) -> list[Quantity]:
    if not branch.with_stability or not len(branch):
        return []
    first = branch.orbits[0].floquet()
    reduced = isinstance(first, ReversibleFloquet) and first.mu.size > 0
    return [*(replace(q, where=NETCDF) for q in MULTIPLIERS), *(REDUCED if reduced else ())]


def _regime(place: Place) -> Enum:
    """What the linear tail of a long lattice does."""
    space = place.solution.space
    assert isinstance(space, Family)
    regime = space.coordinates.regime(place.solution.point)
    assert regime is not None
    return regime


# Other branches -------------------------------------------------------------------------------------------------------

FIXED = ("point", "requested", "fold", "period", "error", "parameter_error", "intervals", "residual",
         "max_abs_multiplier", "stable", "unstable", "trivial_deviation")  # fmt: skip


def branch_quantities(branch: Branch) -> list[Quantity]:
    """Quantities of other solutions, columns of branch.csv in their order and variables of branch.nc.

    Names that users chose are told apart from those of the table by " (of the model)".
    """
    solution = branch.solutions[0]
    names, followed, orbit = list(solution.parameters), branch.parameter, isinstance(solution, Orbit)
    quantities = [
        Quantity("point", "place along the branch", lambda p: p.index, where=CSV),
        Quantity("requested", "1 where the value of the parameter was asked for", lambda p: int(p.requested)),
        Quantity("fold", "1 where the parameter turns back", lambda p: int(p.special == FOLD)),
    ]
    taken = {q.name for q in quantities} | set(FIXED)

    def add(name: str, meaning: str, of: Callable[[Place], Any]) -> None:
        (unique,) = unique_names([name], taken)
        taken.add(unique)
        quantities.append(Quantity(unique, meaning, of, where=CSV))

    if followed:
        add(followed, "the parameter followed", lambda p: p.solution.parameters[followed])
    if orbit:
        quantities.append(Quantity("period", "period of the orbit", lambda p: p.orbit.period, where=CSV))
    for name in names:
        if name != followed and not (orbit and name == "period"):
            add(name, f"the parameter {name}", lambda p, name=name: p.solution.parameters[name])  # type: ignore[misc]
    for i, name in enumerate(solution.space.state_names):
        add(f"{name}_min", f"smallest value of {name}", lambda p, i=i: float(p.extremes[0][i]))  # type: ignore[misc]
        add(f"{name}_max", f"largest value of {name}", lambda p, i=i: float(p.extremes[1][i]))  # type: ignore[misc]
    quantities += [
        Quantity(
            "error", "estimated error of the states, relative to the largest value of each", lambda p: p.solution.error
        ),
        Quantity(
            "parameter_error", "estimated relative error of free parameters", lambda p: p.solution.parameter_error
        ),
        Quantity("intervals", "intervals of the mesh", lambda p: p.solution.intervals),
        Quantity("residual", "largest residual relative to the largest term", lambda p: p.solution.residual),
    ]
    if branch.with_stability:
        quantities += _full_period_quantities()
    return quantities + _branch_arrays(names, solution.space.state_names) + _multiplier_quantities(branch)


def _full_period_quantities() -> list[Quantity]:
    def largest(place: Place) -> float:  # all of them may be trivial
        return place.floquet.max_abs_multiplier if place.floquet.others.size else math.nan

    return [
        Quantity("max_abs_multiplier", "largest modulus but for the trivial ones", largest, may_be_empty=True),
        Quantity("stable", "1 where none but the trivial is unstable", lambda p: int(p.floquet.stable)),
        Quantity(
            "unstable", "multipliers outside the unit circle", lambda p: int(np.sum(p.floquet.outside)), where=CSV
        ),
        Quantity(
            "trivial_deviation",
            "distance of the trivial multipliers from 1",
            lambda p: p.floquet.trivial_deviation,
            where=CSV,
        ),
    ]


def _branch_arrays(parameters: Sequence[str], states: Sequence[str]) -> list[Quantity]:
    phases = np.linspace(0.0, 1.0, PHASES)

    def profile(place: Place) -> NDArray[np.float64]:
        start, end = place.solution.interval
        return place.solution.evaluate(start + phases * (end - start))

    arrays = [
        Quantity("smallest", "smallest value of each state", lambda p: p.extremes[0], ("state",)),
        Quantity("largest", "largest value of each state", lambda p: p.extremes[1], ("state",)),
        Quantity("start", "start of the interval; 0 for an orbit", lambda p: p.solution.interval[0], where=NETCDF),
        Quantity("end", "end of the interval; the period of an orbit", lambda p: p.solution.interval[1], where=NETCDF),
        Quantity("profile", "states; names: state_name", profile, ("phase", "state")),
    ]
    if parameters:

        def values(place: Place) -> NDArray[np.float64]:
            return np.array([place.solution.parameters[name] for name in parameters])

        arrays.append(Quantity("parameters", "values of the parameters; names: parameter_name", values, ("parameter",)))
    return arrays


# Tables and datasets --------------------------------------------------------------------------------------------------


def quantities_of(branch: Branch) -> list[Quantity]:
    """The quantities of a branch of any kind."""
    if isinstance(branch.solutions[0], Equilibrium):
        return equilibrium_quantities(branch)
    return family_quantities(branch) if isinstance(branch.space, Family) else branch_quantities(branch)


def places_of(branch: Branch) -> list[Place]:
    """The solutions of a branch with their marks."""
    mode = branch.space.coordinates.mode_number if isinstance(branch.space, Family) else 0
    return [Place(s, i, mode, s.point.requested, s.point.special) for i, s in enumerate(branch.solutions)]


def csv_row(quantities: Sequence[Quantity], place: Place) -> dict[str, Cell]:
    """One row: quantities without dimensions of their own; one that is not finite and may be empty is."""
    row: dict[str, Cell] = {}
    for quantity in quantities:
        if quantity.dimensions or quantity.where == NETCDF:
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
    quantities = [q for q in quantities_of(widest) if q.where != CSV]
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
