"""Quantities of orbits and solutions of boundary-value problems, in the words of their model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import FOLD
from casadi_skin.results.dataset import unique_names
from casadi_skin.results.multiplier_quantities import multiplier_quantities
from casadi_skin.results.quantity import CSV, NEITHER, NETCDF, Place, Quantity

PHASES = 401  # of the common grid of profiles of solutions

FIXED = ("point", "requested", "fold", "period", "error", "parameter_error", "intervals", "residual",
         "max_abs_multiplier", "multiplier_error", "stable", "unstable", "trivial_deviation")  # fmt: skip


LOGARITHMS = (  # of multipliers that no double holds
    Quantity(
        "log10_max_abs_multiplier", "decimal logarithm of the largest modulus but for the trivial ones",
        lambda p: float(np.max(p.floquet.log10_abs_multipliers[p.floquet.trivial :])),
    ),
    Quantity(
        "log10_abs_multipliers", "decimal logarithms of the moduli of multipliers, the trivial ones first",
        lambda p: p.floquet.log10_abs_multipliers, ("multiplier",), may_be_empty=True,
    ),
)  # fmt: skip


def branch_quantities(branch: Branch) -> list[Quantity]:
    """Quantities of other solutions, columns of branch.csv in their order and variables of branch.nc.

    Names that users chose are distinguished from those of the table by " (of the model)".
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
        own = [q for q in _of_orbits(solution.space) if q.name not in {*names, *solution.space.state_names}]
        quantities, taken = quantities + own, taken | {q.name for q in own}
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
        if any(solution.floquet().beyond_doubles for solution in branch.solutions):
            quantities += LOGARITHMS
    return quantities + _branch_arrays(names, solution.space.state_names) + multiplier_quantities(branch)


def _of_orbits(space: SolutionSpace) -> list[Quantity]:
    """Numbers of orbits that their model has; a parameter or a state of the same name stands in place of one."""
    assert isinstance(space, BoundarySpace)
    found = [Quantity("Omega", "frequency", lambda p: p.orbit.Omega, where=NEITHER)]
    if space.model.hamiltonian is not None:
        found.append(Quantity("energy", "the conserved quantity", lambda p: p.orbit.energy))
    if space.positions:
        meaning = "total amplitude: sum of squares of the positions at t = 0"
        found.append(Quantity("S", meaning, lambda p: p.orbit.S, where=NEITHER))
    return found


def _full_period_quantities() -> list[Quantity]:
    def largest(place: Place) -> float:  # all of them may be trivial
        return place.floquet.max_abs_multiplier if place.floquet.others.size else math.nan

    def error(place: Place) -> float:  # infinite where no mesh is finer
        return place.floquet.error if np.isfinite(place.floquet.error) else math.nan

    return [
        Quantity("max_abs_multiplier", "largest modulus but for the trivial ones", largest, may_be_empty=True),
        Quantity("multiplier_error", "estimated error of the multipliers", error, may_be_empty=True),
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
