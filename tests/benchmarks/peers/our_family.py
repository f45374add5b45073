"""The family followed by this package: the variants that are measured, and the reference that errors are taken to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from family_case import Array, Family, FamilyCase

from casadi_skin.follow import family as computed
from casadi_skin.follow.follow import BranchRun
from casadi_skin.follow.solution import Orbit
from casadi_skin.zero.family import FamilyRequest, family_request
from casadi_skin.zero.settings import ContinuationSettings

# Name in the table: keywords of family_request. A new method is one line.
VARIANTS: dict[str, dict[str, str]] = {
    f"this, {corrector}, {walker}": {"corrector": corrector, "walker": walker}
    for corrector in ("ipopt", "newton")
    for walker in ("arclength", "series")
}

FEWER = 4.0  # times the longest steps: 18 points in place of 52


@dataclass(frozen=True)
class FewerPoints(FamilyRequest):
    """A request with fewer points along the family, each of them as accurate."""

    def continuation_settings(self) -> ContinuationSettings:
        """The same with longer steps."""
        usual = super().continuation_settings()
        longest = {name: FEWER * getattr(usual, name) for name in ("max_step", "max_parameter_step")}
        return replace(usual, aim_angle=1.7 * usual.aim_angle, guard_angle=2.0 * usual.guard_angle, **longest)


def our_walk(
    case: FamilyCase, tolerance: float, keywords: dict[str, str], stability: bool, fewer: bool = False
) -> Callable[[], tuple[Orbit, ...]]:
    """A walk over the family; what is built once serves every call."""
    request = family_request(case.chain, 1, case.at[-1], at=case.at, tolerance=tolerance, **keywords)  # type: ignore[arg-type]
    if fewer:
        request = FewerPoints(**{each.name: getattr(request, each.name) for each in fields(FamilyRequest)})
    space = computed.Family(request)

    def follow() -> tuple[Orbit, ...]:
        walk = BranchRun(space, stability, events=False)
        for _ in walk:
            pass
        branch = walk.branch()
        if not branch.complete:
            raise RuntimeError(branch.reason)
        return branch.orbits

    return follow


def our_family(
    case: FamilyCase, tolerance: float, keywords: dict[str, str], stability: bool, fewer: bool = False
) -> Callable[[], Family]:
    """The same walk, its points as the other programs give theirs."""
    walk = our_walk(case, tolerance, keywords, stability, fewer)

    def follow() -> Family:
        orbits = walk()
        S, Omega = (np.array([getattr(orbit, name) for orbit in orbits]) for name in ("S", "Omega"))
        found = np.array([orbit.floquet().max_abs_multiplier for orbit in orbits]) if stability else None
        return Family(S, Omega, found)

    return follow


def reference(case: FamilyCase, S: Array) -> Family:
    """The family at the given S > 0, in their order, at tolerance 1e-12."""
    asked = tuple(float(value) for value in np.unique(np.minimum([*S, *case.at], case.at[-1])))
    exact = replace(case, at=asked)
    family = our_family(exact, 1e-12, {"corrector": "newton"}, True)()
    index = [int(np.argmin(abs(family.S - value))) for value in S]
    return Family(family.S[index], family.Omega[index], family.multiplier[index])
