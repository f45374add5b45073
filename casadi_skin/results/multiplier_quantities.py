"""Quantities that are arrays of Floquet multipliers, of orbits of every kind."""

from __future__ import annotations

from dataclasses import replace

from casadi_skin.orbits.branch import Branch
from casadi_skin.results.quantity import NETCDF, Quantity
from casadi_skin.stability.result import ReversibleFloquet

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


def multiplier_quantities(branch: Branch) -> list[Quantity]:
    """Arrays of multipliers of the orbits of a branch; none where stability was not computed."""
    if not branch.with_stability or not len(branch):
        return []
    first = branch.orbits[0].floquet()
    reduced = isinstance(first, ReversibleFloquet) and first.mu.size > 0
    return [*(replace(q, where=NETCDF) for q in MULTIPLIERS), *(REDUCED if reduced else ())]
