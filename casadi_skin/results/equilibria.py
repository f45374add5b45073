"""Quantities of equilibria: columns of branch.csv and variables of branch.nc."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Equilibrium
from casadi_skin.results.dataset import unique_names
from casadi_skin.results.quantity import CSV, Place, Quantity

FIXED = ("point", "requested", "special", "stable", "unstable", "max_growth", "error", "eigenvalue_error", "residual")


def equilibrium_quantities(branch: Branch) -> list[Quantity]:
    """Quantities of equilibria in the order of the columns, parameters followed first.

    Names that users chose are distinguished from those of the table by " (of the model)".
    """
    first = _equilibrium(Place(branch.solutions[0], 0))
    quantities = [
        Quantity("point", "place along the branch", lambda p: p.index, where=CSV),
        Quantity("requested", "1 where the value of the parameter was asked for", lambda p: int(p.requested)),
        Quantity("special", "kind of a special point; empty elsewhere", lambda p: p.special or "", where=CSV),
    ]
    taken = set(FIXED)

    def add(name: str, meaning: str, of: Callable[[Place], Any]) -> None:
        (unique,) = unique_names([name], taken)
        taken.add(unique)
        quantities.append(Quantity(unique, meaning, of, where=CSV))

    followed = [name for name in (branch.parameter, *branch.space.free) if name]
    for name in [*followed, *(name for name in first.parameters if name not in followed)]:
        add(name, f"the parameter {name}", lambda p, name=name: p.solution.parameters[name])  # type: ignore[misc]
    for i, name in enumerate(first.space.state_names):
        add(name, f"the state {name}", lambda p, i=i: float(_equilibrium(p).positions[i]))  # type: ignore[misc]
    return [
        *quantities,
        Quantity("stable", "1 where no eigenvalue has a positive real part", lambda p: int(p.solution.stable)),
        Quantity("unstable", "eigenvalues with a positive real part", lambda p: _equilibrium(p).unstable),
        Quantity("max_growth", "largest real part of an eigenvalue", lambda p: float(_spectrum(p).real.max())),
        Quantity("error", "estimated error of the state, relative to each component", lambda p: p.solution.error),
        Quantity(
            "eigenvalue_error", "largest estimated error of an eigenvalue", lambda p: _equilibrium(p).eigenvalue_error
        ),
        Quantity("residual", "largest residual relative to the largest term", lambda p: p.solution.residual),
        Quantity("states", "the state; names: state_name", lambda p: _equilibrium(p).positions, ("state",)),
        Quantity("eigenvalues", "eigenvalues by descending real part", _spectrum, ("eigenvalue",)),
        *_parameters(first),
    ]


def _parameters(first: Equilibrium) -> list[Quantity]:
    names = list(first.parameters)

    def values(place: Place) -> NDArray[np.float64]:
        return np.array([place.solution.parameters[name] for name in names])

    meaning = "values of the parameters; names: parameter_name"
    return [Quantity("parameters", meaning, values, ("parameter",))] if names else []


def _equilibrium(place: Place) -> Equilibrium:
    return cast(Equilibrium, place.solution)


def _spectrum(place: Place) -> NDArray[np.complex128]:
    return _equilibrium(place).eigenvalues
