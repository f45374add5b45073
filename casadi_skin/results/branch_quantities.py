"""Quantities of orbits and solutions of boundary-value problems, in the words of their model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.certify.certificate import STABLE, UNSTABLE, Certificate
from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import FOLD
from casadi_skin.results.dataset import unique_names
from casadi_skin.results.quantity import CSV, NEITHER, NETCDF, Place, Quantity
from casadi_skin.stability.localised import LocalisedFloquet
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import ReversibleFloquet
from casadi_skin.zero.problem import Array

# Quantities that are arrays of Floquet multipliers, of orbits of every kind -------------------------------------------

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


# Quantities of the orbits of a family, with its proofs ----------------------------------------------------------------

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
        "profile", "displacements y_n at t = 0", lambda p: p.orbit.evaluate(0.0, p.orbit.output_sites), ("site",)
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


def _certificate(place: Place) -> Certificate | None:
    """The proof of an orbit, where one was requested, else None."""
    space = place.orbit.space
    assert isinstance(space, Family)
    return place.orbit.certificate if space.request.certify == "all" or place.requested else None


def _of_proof(value: Callable[[Certificate], float]) -> Callable[[Place], float]:
    def of(place: Place) -> float:
        certificate = _certificate(place)
        return math.nan if certificate is None else value(certificate)

    return of


def certified(branch: Branch) -> list[Orbit]:
    """The orbits of a branch for which a proof was requested."""
    requested = isinstance(branch.space, Family) and branch.space.request.certify
    return [o for o in branch.orbits if requested == "all" or o.point.requested] if requested else []


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


def _proved_stable(place: Place) -> float:
    """1 or 0 where it is proved, NaN where it is not decided or no proof was requested."""
    if _certificate(place) is None:
        return math.nan
    return {STABLE: 1.0, UNSTABLE: 0.0}.get(place.orbit.proved_stability.verdict, math.nan)


PROVED_STABILITY = Quantity(
    "proved_stable", "1 where the orbit is proved to be stable, 0 where unstable; empty where neither is",
    _proved_stable, may_be_empty=True,
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
    if branch.space.request.certify:
        quantities += [*FAMILY_PROOFS, *([PROVED_STABILITY] if branch.with_stability else [])]
    quantities += FAMILY_ARRAYS
    harmonics = max((orbit.harmonics for orbit in branch.orbits), default=0)
    if branch.space.symmetry.value == 0.25:
        meaning = "c_kn of y_n(t) = sum_k c_kn cos((2k+1) Omega t), k from 0"

        def coefficients(place: Place) -> NDArray[np.float64]:
            return place.orbit.coefficients(harmonics, place.orbit.output_sites)

        quantities.append(Quantity("coefficients", meaning, coefficients, ("harmonic", "site")))
    return quantities + multiplier_quantities(branch)


def _regime(place: Place) -> Enum:
    """Regime of the linear tail of a long lattice."""
    space = place.solution.space
    assert isinstance(space, Family)
    regime = space.coordinates.regime(place.solution.point)
    assert regime is not None
    return regime
