"""Quantities that are arrays of Floquet multipliers, of orbits of every kind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.results.quantity import NETCDF, Place, Quantity
from casadi_skin.stability.localised import LocalisedFloquet
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import ReversibleFloquet
from casadi_skin.zero.problem import Array

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


def _localised(value: Callable[[LocalisedFloquet], Any]) -> Callable[[Place], Any]:
    def of(place: Place) -> Any:
        assert isinstance(place.floquet, LocalisedFloquet)
        return value(place.floquet)

    return of


def _localised_quantities(branch: Branch) -> list[Quantity]:
    """Those of orbits at the edge of a long tail: localised multipliers, as many as there are, and arcs."""
    found = [orbit.floquet() for orbit in branch.orbits]
    most = max(floquet.mu.size for floquet in found if isinstance(floquet, LocalisedFloquet))

    def padded(values: Array | ComplexArray) -> Array | ComplexArray:
        return np.concatenate([values, np.full(most - values.size, np.nan, values.dtype)])

    of, band, index = _localised, ("band",), ("mu_index",)
    arrays = [
        Quantity("mu", "eigenvalues of B^T C, localised ones", of(lambda f: padded(f.mu)), index, may_be_empty=True),
        Quantity("mu_error", "estimated errors of mu", of(lambda f: padded(f.mu_error)), index, may_be_empty=True),
    ]
    numbers = [
        Quantity("localised", "localised multipliers, in pairs", of(lambda f: f.mu.size)),
        Quantity("undecided", "pairs that more sites would decide", of(lambda f: f.unresolved.size)),
        Quantity("finite_size", "pairs off the circle by the cut alone", of(lambda f: f.finite_size.size)),
        Quantity("finite_size_modulus", "largest modulus of these, or 1", of(lambda f: f.finite_size_modulus)),
        Quantity("stability_sites", "sites of the variational problem", of(lambda f: f.sites)),
        Quantity("overlaps", "overlaps of arcs of opposite signature", of(lambda f: len(f.continuous.overlaps))),
        Quantity("arc_start", "least omega T of waves", of(lambda f: f.continuous.arcs[:, 0]), band),
        Quantity("arc_end", "largest omega T of waves", of(lambda f: f.continuous.arcs[:, 1]), band),
    ]
    return [*numbers, *((replace(q, where=NETCDF) for q in arrays) if most else ())]


def multiplier_quantities(branch: Branch) -> list[Quantity]:
    """Arrays of multipliers of the orbits of a branch; none where stability was not computed."""
    if not branch.with_stability or not len(branch):
        return []
    first = branch.orbits[0].floquet()
    if isinstance(first, LocalisedFloquet):
        return [replace(MULTIPLIERS[0], where=NETCDF), *_localised_quantities(branch)]
    reduced = isinstance(first, ReversibleFloquet) and first.mu.size > 0
    return [*(replace(q, where=NETCDF) for q in MULTIPLIERS), *(REDUCED if reduced else ())]
