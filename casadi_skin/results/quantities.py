"""The one table of quantities of solutions: name, meaning, dimensions and how each is had.

CSV files, netCDF files, xarray datasets, data frames, columns of maps, axes of pictures, `branch[name]` and
`branch.at(name=...)` are made from it. A quantity with a dimension of its own is left out of CSV; one that some
solutions do not have, as the energy of a model that conserves none, is empty there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter as at
from typing import Any

import numpy as np

from casadi_skin.certify.certificate import STABLE, UNSTABLE, Certificate
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Orbit, Solution
from casadi_skin.follow.space import EQUILIBRIA, FAMILY, ORBITS
from casadi_skin.model.arguments import accepted_names
from casadi_skin.zero.kinds import FOLD
from casadi_skin.zero.problem import Array

Cell = float | int | str
CSV, NETCDF, BOTH, NEITHER = "csv", "netcdf", "both", "neither"  # files: those of NEITHER follow from others
COUNTED_QUANTITIES = frozenset(  # marks, counts and words, which jump: no solution is sought by their value
    ("mode", "point", "index", "requested", "fold", "special", "stable", "unstable", "unstable_real",
     "unstable_complex", "at_round_off", "intervals", "resolution", "regime", "proved", "proved_stable", "localised",
     "undecided", "finite_size", "stability_sites", "overlaps")
)  # fmt: skip
PROFILE_PHASES = np.linspace(0.0, 1.0, 401)  # of the common grid of profiles of solutions
SAME_STATE_RTOL = 1e-6  # of its range, within which a state comes back
PLACES_PER_INTERVAL = 16  # places an interval in which extremes are looked for


@dataclass(frozen=True, eq=False)
class Place:
    """A solution of a branch with the data of its quantities: its place, and marks."""

    solution: Any
    index: int
    mode: int = 0
    requested: bool = False
    special: str = ""

    @property
    def floquet(self) -> Any:
        """Stability of the solution, an orbit or one that its conditions close."""
        return self.solution.floquet()

    @cached_property
    def extremes(self) -> tuple[Array, Array]:
        """Smallest and largest value of each state, shapes (components,)."""
        return extremes(self.solution)

    @property
    def sites(self) -> Any:
        """Numbers of the sites of a family's orbit."""
        return self.solution.output_sites

    @property
    def logarithms(self) -> tuple[Array, Array]:
        """log10 |y_n| and the signs of y_n of a family's orbit at t = 0, shapes (sites,)."""
        logs, signs = self.solution.log10_displacements(self.sites)
        return logs, signs

    @property
    def profile(self) -> Array:
        """States over the interval or the period, shape (phases, states)."""
        start, end = self.solution.interval
        return np.asarray(self.solution.evaluate(start + PROFILE_PHASES * (end - start)))

    def proved(self, value: Callable[[Certificate], float]) -> float:
        """A number of the proof of an orbit; NaN where none was requested."""
        return value(self.solution.certificate) if _is_certified(self.solution) else math.nan


@dataclass(frozen=True, eq=False)
class Quantity:
    """A quantity of a solution: `of` gives its value, an array where it has `dimensions`."""

    name: str
    meaning: str
    of: Callable[[Place], Any]
    dimensions: tuple[str, ...] = ()
    where: str = BOTH
    may_be_empty: bool = False


def _proof(name: str, meaning: str, value: Callable[[Certificate], float]) -> Quantity:
    """A number of the proof of an orbit, empty where none was requested."""
    return Quantity(name, meaning, lambda p: p.proved(value), may_be_empty=True)


# Quantities of orbits of families, in the order of the columns of family.csv ------------------------------------------

FAMILY_QUANTITIES = (
    Quantity("mode", "linear mode j that the family grows from", at("mode")),
    Quantity("point", "place along the family", at("index"), where=CSV),
    Quantity("index", "place along the family", at("index"), where=NETCDF),
    Quantity("requested", "1 where S, Omega or the period was asked for", lambda p: int(p.requested)),
    Quantity("S", "total amplitude: sum of y_n^2 at t = 0", at("solution.S")),
    Quantity("Omega", "frequency", at("solution.Omega")),
    Quantity("Omega_shift", "Omega minus the linear frequency", at("solution.Omega_shift")),
    Quantity("period", "2 pi/Omega", at("solution.period"), where=CSV),
    Quantity("energy", "the conserved quantity", lambda p: energy_of(p.solution), may_be_empty=True),
)
LARGEST_MULTIPLIER = "floquet.max_abs_multiplier"
FAMILY_STABILITY = (
    Quantity("max_abs_multiplier", "largest modulus, the trivial pair left out", at(LARGEST_MULTIPLIER)),
    Quantity("stable", "1 where no multiplier is outside the unit circle", lambda p: int(p.floquet.stable)),
    Quantity("unstable_real", "multipliers outside the circle, real", at("floquet.unstable_real"), where=CSV),
    Quantity("unstable_complex", "the same, complex", at("floquet.unstable_complex"), where=CSV),
    Quantity("multiplier_error", "estimated error of the multipliers", at("floquet.error")),
)
RESIDUAL = Quantity("residual", "largest residual relative to the largest term", at("solution.residual"))
ROUND_OFF = "1 where round-off keeps the errors above the tolerance"
FAMILY_ERRORS = (
    Quantity("Omega_error", "estimated absolute error of Omega", at("solution.Omega_error")),
    RESIDUAL,
    Quantity("profile_error", "estimated relative error of the profile", at("solution.profile_error")),
    Quantity("at_round_off", ROUND_OFF, lambda p: int(p.solution.at_round_off)),
    Quantity("S_error", "estimated absolute error of S", at("solution.S_error")),
)
IS_PROVED = "1 where the orbit is proved to exist, 0 where it is not; empty where no proof was asked for"
DISTANCE = "proved distance of the orbit from the computed one, in the norm of the certificate"
FAMILY_PROOFS = (
    _proof("proved", IS_PROVED, lambda c: float(c.proved)),
    _proof("Omega_lower", "proved lower bound of Omega", lambda c: c.Omega[0]),
    _proof("Omega_upper", "proved upper bound of Omega", lambda c: c.Omega[1]),
    _proof("proved_Omega_error", "proved bound of the error of Omega", at("Omega_error")),
    _proof("proved_radius", DISTANCE, at("radius")),
)
PROVED_STABILITY = Quantity(
    "proved_stable", "1 where the orbit is proved to be stable, 0 where unstable; empty where neither is",
    lambda p: p.proved(lambda _: {STABLE: 1.0, UNSTABLE: 0.0}.get(p.solution.proved_stability.verdict, math.nan)),
    may_be_empty=True,
)  # fmt: skip
LOGARITHMS_OF_PROFILE = "log10 |y_n| at t = 0, also where y_n is below the smallest double; empty where it is 0"
LEVEL = "harmonics or intervals of the discretisation"
FAMILY_ARRAYS = (
    Quantity("resolution", LEVEL, at("solution.point.problem.resolution"), where=NETCDF),
    Quantity("profile", "displacements y_n at t = 0", lambda p: p.solution.evaluate(0.0, p.sites), ("site",)),
    Quantity("log10_profile", LOGARITHMS_OF_PROFILE, lambda p: p.logarithms[0], ("site",), may_be_empty=True),
    Quantity("profile_sign", "sign of y_n at t = 0", lambda p: p.logarithms[1].astype(int), ("site",)),
)


def energy_of(orbit: Orbit) -> float:
    """The energy; NaN for a model without a conserved quantity, infinite where an infinite tail moves along."""
    try:
        return orbit.energy
    except ValueError:
        return math.nan


def _is_certified(orbit: Any) -> bool:
    """Whether a proof was requested for an orbit of a family."""
    request = orbit.space.request
    return bool(request.certify == "all" or (request.certify and orbit.point.requested))


def certified(branch: Branch) -> list[Orbit]:
    """The orbits of a branch for which a proof was requested."""
    return [o for o in branch.orbits if _is_certified(o)] if branch.space.connects == FAMILY else []


def _family_quantities(branch: Branch) -> list[Quantity]:
    space: Any = branch.space
    quantities = [*FAMILY_QUANTITIES, *(FAMILY_STABILITY if branch.with_stability else ()), *FAMILY_ERRORS]
    first = space.coordinates.regime(branch.solutions[0].point) if len(branch) else None
    if first is not None:
        regimes: list[Any] = list(first.__class__)  # of the linear tail of a long lattice
        words = "; ".join(f"{i}: {regime.value}" for i, regime in enumerate(regimes))

        def regime(place: Place) -> Any:
            return place.solution.space.coordinates.regime(place.solution.point)

        quantities.append(Quantity("regime", words, lambda p: regime(p).name.lower(), where=CSV))
        quantities.append(Quantity("regime", words, lambda p: regimes.index(regime(p)), where=NETCDF))
    if space.request.certify:
        quantities += [*FAMILY_PROOFS, *([PROVED_STABILITY] if branch.with_stability else [])]
    quantities += FAMILY_ARRAYS
    if space.symmetry.value == 0.25:
        harmonics = max((orbit.harmonics for orbit in branch.orbits), default=0)
        meaning = "c_kn of y_n(t) = sum_k c_kn cos((2k+1) Omega t), k from 0"

        def coefficients(place: Place) -> Array:
            return np.asarray(place.solution.coefficients(harmonics, place.sites))

        quantities.append(Quantity("coefficients", meaning, coefficients, ("harmonic", "site")))
    return quantities + _multipliers(branch)


# Quantities of other solutions, in the words of their model -----------------------------------------------------------

HEAD = (
    Quantity("point", "place along the branch", at("index"), where=CSV),
    Quantity("requested", "1 where the value of the parameter was asked for", lambda p: int(p.requested)),
)
IS_FOLD = Quantity("fold", "1 where the parameter turns back", lambda p: int(p.special == FOLD))
SPECIAL = Quantity("special", "kind of a special point; empty elsewhere", at("special"), where=CSV)
PERIOD = Quantity("period", "period of the orbit", at("solution.period"), where=CSV)
SUM_OF_SQUARES = "total amplitude: sum of squares of the positions at t = 0"
OF_ORBITS = (  # of a model that has them
    Quantity("Omega", "frequency", at("solution.Omega"), where=NEITHER),
    Quantity("energy", "the conserved quantity", at("solution.energy")),
    Quantity("S", SUM_OF_SQUARES, at("solution.S"), where=NEITHER),
)
ERRORS = (
    Quantity("error", "estimated error of the states, relative to the largest value of each", at("solution.error")),
    Quantity("parameter_error", "estimated relative error of free parameters", at("solution.parameter_error")),
    Quantity("intervals", "intervals of the mesh", at("solution.intervals")),
    RESIDUAL,
)
STABILITY = (
    Quantity("max_abs_multiplier", "largest modulus but for the trivial ones",
             lambda p: p.floquet.max_abs_multiplier if p.floquet.others.size else math.nan, may_be_empty=True),
    Quantity("multiplier_error", "estimated error of the multipliers",  # infinite where no mesh is finer
             lambda p: p.floquet.error if math.isfinite(p.floquet.error) else math.nan, may_be_empty=True),
    Quantity("stable", "1 where none but the trivial is unstable", lambda p: int(p.floquet.stable)),
    Quantity("unstable", "multipliers outside the unit circle", lambda p: int(np.sum(p.floquet.outside)), where=CSV),
    Quantity("trivial_deviation", "distance of the trivial multipliers from 1", at("floquet.trivial_deviation"),
             where=CSV),
)  # fmt: skip
LOGARITHMS = (  # of multipliers that no double holds
    Quantity("log10_max_abs_multiplier", "decimal logarithm of the largest modulus but for the trivial ones",
             lambda p: float(np.max(p.floquet.log10_abs_multipliers[p.floquet.trivial :]))),
    Quantity("log10_abs_multipliers", "decimal logarithms of the moduli of multipliers, the trivial ones first",
             at("floquet.log10_abs_multipliers"), ("multiplier",), may_be_empty=True),
)  # fmt: skip
ARRAYS = (
    Quantity("smallest", "smallest value of each state", lambda p: p.extremes[0], ("state",)),
    Quantity("largest", "largest value of each state", lambda p: p.extremes[1], ("state",)),
    Quantity("start", "start of the interval; 0 for an orbit", lambda p: p.solution.interval[0], where=NETCDF),
    Quantity("end", "end of the interval; the period of an orbit", lambda p: p.solution.interval[1], where=NETCDF),
    Quantity("profile", "states; names: state_name", at("profile"), ("phase", "state")),
)
AT_REST = (
    Quantity("stable", "1 where no eigenvalue has a positive real part", lambda p: int(p.solution.stable)),
    Quantity("unstable", "eigenvalues with a positive real part", at("solution.unstable")),
    Quantity("max_growth", "largest real part of an eigenvalue", lambda p: float(p.solution.eigenvalues.real.max())),
    Quantity("error", "estimated error of the state, relative to each component", at("solution.error")),
    Quantity("eigenvalue_error", "largest estimated error of an eigenvalue", at("solution.eigenvalue_error")),
    RESIDUAL,
    Quantity("states", "the state; names: state_name", at("solution.positions"), ("state",)),
    Quantity("eigenvalues", "eigenvalues by descending real part", at("solution.eigenvalues"), ("eigenvalue",)),
)
FIXED = tuple(q.name for q in (*HEAD, IS_FOLD, PERIOD, *ERRORS, *STABILITY))  # columns of orbits, and of states at rest
FIXED_AT_REST = tuple(q.name for q in (*HEAD, SPECIAL, *AT_REST) if not q.dimensions)


def _component(values: Callable[[Place], Any], place: Any) -> Callable[[Place], float]:
    return lambda p: float(values(p)[place])


def _monitored(space: Any, monitor: Any) -> Callable[[Place], float]:
    return lambda p: float(monitor.value(space.reading(p.solution.point)))


def _model_quantities(branch: Branch) -> list[Quantity]:
    """Names that users chose are distinguished from those of the table by " (of the model)"."""
    space: Any = branch.space
    first, at_rest, orbit = branch.solutions[0], space.connects == EQUILIBRIA, space.connects == ORBITS
    names, states = list(first.parameters), space.state_names
    followed = [name for name in (branch.parameter, *(space.free if at_rest else ())) if name]
    taken = set(FIXED_AT_REST if at_rest else FIXED)

    def of_user(name: str, meaning: str, of: Callable[[Place], Any]) -> Quantity:
        (unique,) = unique_names([name], taken)
        taken.add(unique)
        return Quantity(unique, meaning, of, where=CSV)

    def parameters(chosen: Iterable[str], meaning: str = "the parameter {}") -> list[Quantity]:
        return [of_user(n, meaning.format(n), _component(at("solution.parameters"), n)) for n in chosen]

    quantities = [*HEAD, SPECIAL if at_rest else IS_FOLD]
    quantities += parameters(followed) if at_rest else parameters(followed, "the parameter followed")
    if orbit:
        has = {"Omega": True, "energy": space.model.hamiltonian is not None, "S": space.positions > 0}
        own = [q for q in OF_ORBITS if has[q.name] and q.name not in {*names, *states}]
        quantities += [PERIOD, *own]
        taken |= {q.name for q in own}
    quantities += parameters(n for n in names if n not in followed and not (orbit and n == PERIOD.name))
    for i, name in enumerate(states):
        if at_rest:
            quantities.append(of_user(name, f"the state {name}", _component(at("solution.positions"), i)))
        else:
            low, high = (_component(lambda p, side=side: p.extremes[side], i) for side in (0, 1))  # type: ignore[misc]
            quantities.append(of_user(f"{name}_min", f"smallest value of {name}", low))
            quantities.append(of_user(f"{name}_max", f"largest value of {name}", high))
    for monitor in space.monitors:
        meaning = "a monitor: where it vanishes is a special point of its name"
        quantities.append(of_user(monitor.name, meaning, _monitored(space, monitor)))
    if at_rest:
        quantities += AT_REST
    else:
        quantities += ERRORS
        if branch.with_stability:
            quantities += STABILITY
            if any(solution.floquet().beyond_doubles for solution in branch.solutions):
                quantities += LOGARITHMS
        quantities += ARRAYS
    if names:
        meaning = "values of the parameters; names: parameter_name"
        values: Callable[[Place], Any] = lambda p: np.array([p.solution.parameters[n] for n in names])  # noqa: E731
        quantities.append(Quantity("parameters", meaning, values, ("parameter",)))
    return quantities if at_rest else quantities + _multipliers(branch)


# Multipliers of orbits of every kind ----------------------------------------------------------------------------------

DEVIATION = "distance of the trivial multipliers from their exact value"
MULTIPLIERS = (  # arrays, those of mu where there are these
    Quantity("multipliers", "Floquet multipliers, the trivial ones first", at("floquet.multipliers"), ("multiplier",),
             NETCDF),
    Quantity("mu", "eigenvalues of B^T C", at("floquet.mu"), ("mu_index",)),
    Quantity("mu_error", "estimated errors of mu", at("floquet.mu_error"), ("mu_index",)),
)  # fmt: skip
LOCALISED = (  # of orbits at the edge of a long tail: localised multipliers, and arcs
    Quantity("localised", "localised multipliers, in pairs", at("floquet.mu.size")),
    Quantity("undecided", "pairs that more sites would decide", at("floquet.tail.unresolved.size")),
    Quantity("finite_size", "pairs off the circle by the cut alone", at("floquet.tail.finite_size.size")),
    Quantity("finite_size_modulus", "largest modulus of these, or 1", at("floquet.tail.finite_size_modulus")),
    Quantity("stability_sites", "sites of the variational problem", at("floquet.tail.sites")),
    Quantity("overlaps", "overlaps of arcs of opposite signature", lambda p: len(p.floquet.tail.continuous.overlaps)),
    Quantity("arc_start", "least omega T of waves", lambda p: p.floquet.tail.continuous.arcs[:, 0], ("band",)),
    Quantity("arc_end", "largest omega T of waves", lambda p: p.floquet.tail.continuous.arcs[:, 1], ("band",)),
)


def _multipliers(branch: Branch) -> list[Quantity]:
    """Arrays of multipliers, of which orbits at an edge have different numbers; none without stability."""
    if not branch.with_stability or not len(branch):
        return []
    found: list[Any] = [orbit.floquet() for orbit in branch.orbits]
    quantities = [Quantity("trivial_deviation", DEVIATION, at("floquet.trivial_deviation"), where=NETCDF)]
    most = max(floquet.mu.size for floquet in found)
    if found[0].tail is None:
        return quantities + [q for q in MULTIPLIERS if found[0].mu.size or q.where == NETCDF]

    def padded(quantity: Quantity, meaning: str) -> Quantity:
        def of(place: Place) -> Any:
            values = quantity.of(place)
            return np.concatenate([values, np.full(most - values.size, np.nan, values.dtype)])

        return replace(quantity, meaning=meaning, of=of, where=NETCDF, may_be_empty=True)

    _, mu, error = MULTIPLIERS
    arrays = [padded(mu, f"{mu.meaning}, localised ones"), padded(error, error.meaning)]
    return [*quantities, *LOCALISED, *(arrays if most else ())]


# What is made from the table ------------------------------------------------------------------------------------------


def quantities_of(branch: Branch) -> list[Quantity]:
    """The quantities of a branch of any kind."""
    return _family_quantities(branch) if branch.space.connects == FAMILY else _model_quantities(branch)


def places_of(branch: Branch) -> list[Place]:
    """The solutions of a branch with their marks."""
    space: Any = branch.space
    mode = space.coordinates.mode_number if space.connects == FAMILY else 0
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
    return {q.name: q for q in table if not (q.dimensions or q.name in COUNTED_QUANTITIES)}


def unique_names(names: Iterable[str], taken: Iterable[str]) -> list[str]:
    """Names that users chose; those that are taken, or there twice, with " (of the model)" after them."""
    known, found = set(taken), list[str]()
    for name in names:
        while name in known:
            name = f"{name} (of the model)"
        known.add(name)
        found.append(name)
    return found


def columns_of(branch: Branch) -> list[Quantity]:
    """Quantities that are columns of tables of a branch: those without dimensions of their own."""
    table = quantities_of(branch) if branch.solutions else []
    return [q for q in table if not q.dimensions and q.where in (CSV, BOTH)]


def csv_row(columns: Sequence[Quantity], place: Place) -> dict[str, Cell]:
    """One row; a value that is not finite and may be empty is."""
    row: dict[str, Cell] = {}
    for quantity in columns:
        value = quantity.of(place)
        row[quantity.name] = "" if quantity.may_be_empty and not math.isfinite(value) else value
    return row


# Smallest and largest values of states, beyond the resolution of samples ----------------------------------------------


def extremes(solution: Solution) -> tuple[Array, Array]:
    """Smallest and largest value of each state over the interval or the period.

    The extremes of fine samples are moved to the vertex of the parabola through their neighbours and evaluated there;
    states that come back after the period have neighbours across its end.
    """
    t = _fine_times(solution)
    x = solution.evaluate(t)
    comes_back = solution.is_orbit & (np.abs(x[-1] - x[0]) <= SAME_STATE_RTOL * np.ptp(x, axis=0))
    found = []
    for sign in (-1.0, 1.0):
        place = np.argmax(sign * x, axis=0)
        times = np.array([_vertex(t, x[:, i], k, comes_back[i]) for i, k in enumerate(place)])
        moved = np.diagonal(solution.evaluate(times))
        found.append(sign * np.maximum(sign * moved, sign * np.diagonal(x[place])))
    return found[0], found[1]


def _fine_times(solution: Solution) -> Array:
    edges = solution.mesh
    inner = edges[:-1, None] + np.diff(edges)[:, None] * np.arange(PLACES_PER_INTERVAL) / PLACES_PER_INTERVAL
    t = np.append(inner.ravel(), edges[-1])
    if solution.space.connects not in (FAMILY, ORBITS):
        return t
    copies = round(1.0 / solution.space.symmetry.value)  # the part that was unknown, mirrored or repeated
    part = t[-1]
    whole = [k * part + (t if k % 2 == 0 else part - t[::-1]) for k in range(copies)]
    return np.unique(np.concatenate(whole))


def _vertex(t: Array, x: Array, k: int, comes_back: bool) -> float:
    """The vertex of the parabola through three samples; the sample itself on a line, or at an end of what goes on."""
    if k in (0, t.size - 1):
        if not comes_back:
            return float(t[k])
        period = t[-1] - t[0]
        vertex = _vertex(np.array([t[-2] - period, t[0], t[1]]), x[[-2, 0, 1]], 1, comes_back)
        return vertex if vertex >= t[0] else vertex + period
    left, right = t[k - 1] - t[k], t[k + 1] - t[k]
    a, b = (x[k - 1] - x[k]) / left, (x[k + 1] - x[k]) / right
    curvature = (b - a) / (right - left)
    if curvature == 0.0:
        return float(t[k])
    slope = a - curvature * left
    return float(np.clip(t[k] - 0.5 * slope / curvature, t[k - 1], t[k + 1]))
