"""A branch as computed: solutions in the order of arclength, special points, changes of stability, why it ended."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.corners import PassedResonance, passed_resonances
from casadi_skin.follow.events import StabilityChange
from casadi_skin.follow.passages import passage, zeros_between
from casadi_skin.follow.solution import Orbit, Solution
from casadi_skin.follow.special_points import SpecialPoint, folds_of_family, special_point
from casadi_skin.model.arguments import check_instance, check_name, cut, number, whole
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.result import Result, in_turn
from casadi_skin.solve.watch import Budget, TimeLimitError
from casadi_skin.stability.tongues.diagram import Place, StabilityDiagram, StabilityEdge
from casadi_skin.zero.kinds import EDGE, FOLD, STABILITY, Unresolved, count_in_words
from casadi_skin.zero.model_coordinates import linear_spectrum, nearest_resonance
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import End

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Branch(Result):
    """Solutions of one branch in the order of arclength.

    Attributes:
        space: the solution space: equations and discretisations.
        solutions: orbits, equilibria or solutions of a boundary-value problem; special points located on the way among
            them.
        located: changes of stability between neighbouring solutions of a branch other than a family.
        with_stability: whether stability was computed with the solutions.
        end: reason for the end; None after an interruption.
        detail: details of the end, in words.
        misses: requested values at which no solution was found, by the name of the quantity.
        stopped: whether the condition `until` ended the branch.
        with_events: whether changes of stability are sought.
        passed_over: stretches that could not be resolved while the branch was followed.
        time_left: seconds that are left of the time limit, for what is computed on first use.
    """

    space: Any
    solutions: tuple[Any, ...]
    located: tuple[StabilityChange, ...] = ()
    with_stability: bool = False
    end: End | None = None
    detail: str = ""
    misses: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    stopped: bool = False
    with_events: bool = False
    passed_over: tuple[Unresolved, ...] = ()
    time_left: float = math.inf

    def __len__(self) -> int:
        return len(self.solutions)

    def __iter__(self) -> Iterator[Any]:
        """The orbits, equilibria or solutions in their order."""
        return iter(self.solutions)

    def __repr__(self) -> str:
        values = self.values
        words = f" from {values[0]:.6g} to {values[-1]:.6g}" if values.size else ""
        known = self.with_events and self.changes_known
        sought = known and self.with_stability and not self.space.stability_included
        count = count_in_words(len(self.changes), self.unresolved) if sought else ""
        changes = f", {count} changes of stability" if sought else ""
        kinds = [point.kind for point in self.special_points] if self.space.locates_folds else []
        special = "".join(f", {kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
        left = len(self.known_unresolved)
        gaps = f", unresolved: {left} stretch{'es' * (left > 1)}" if left else ""
        return f"<Branch: {len(self)} points, {self.parameter}{words}{changes}{special}{gaps}; {cut(self.reason)}>"

    @property
    def parameter(self) -> str:
        """Name of the continuation parameter: S of a family."""
        return str(self.space.parameter)

    @property
    def orbits(self) -> tuple[Orbit, ...]:
        """The solutions of a branch of orbits."""
        return self.solutions

    @property
    def start(self) -> Any:
        """The point where the branch starts: of a family its linear mode at S = 0, which is not among the orbits."""
        return self.space.start

    # Arrays -----------------------------------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> Array:
        """Values of a quantity along the branch, shape (solutions,) but where the quantity has dimensions of its own.

        Parameters, and all quantities of the table that files and data frames are made from, by the same names; a
        parameter comes before a quantity of its name. Raises KeyError, naming all, for other names.
        """
        if name == self.parameter:
            return self.values
        if all(name in solution.parameters for solution in self.solutions[:1]):
            return np.array([solution.parameters[name] for solution in self.solutions])
        return self.quantity(name)

    quantity: ClassVar[Callable[..., Array]]
    """Values of a quantity of the table along the branch: `casadi_skin.results.quantities.along`."""
    quantity_of: ClassVar[Callable[..., Callable[[Solution], float]]]
    """A quantity of the table as a function of a solution: `casadi_skin.results.quantities.sought`."""

    @property
    def values(self) -> Array:
        """Values of the continuation parameter, shape (solutions,)."""
        return np.array([solution.value(self.parameter) for solution in self.solutions])

    @property
    def parameters(self) -> Mapping[str, Array]:
        """Values of all parameters along the branch by name, each of shape (solutions,)."""
        names = self.solutions[0].parameters if self.solutions else ()
        return {name: self[name] for name in names}

    @property
    def S(self) -> Array:
        """Total amplitudes, shape (orbits,)."""
        return np.array([orbit.S for orbit in self.orbits])

    @property
    def Omega(self) -> Array:
        """Frequencies, shape (orbits,)."""
        return np.array([orbit.Omega for orbit in self.orbits])

    @property
    def period(self) -> Array:
        """Periods, shape (orbits,)."""
        return np.array([orbit.period for orbit in self.orbits])

    @property
    def energy(self) -> Array:
        """Energies, shape (orbits,)."""
        return np.array([orbit.energy for orbit in self.orbits])

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether each solution is stable, shape (solutions,); computed now where it is missing."""
        return np.array([solution.stable for solution in self.solutions], dtype=bool)

    @property
    def max_abs_multiplier(self) -> Array:
        """Largest modulus of a multiplier of each orbit, shape (orbits,); computed now where it is missing."""
        return np.array([orbit.floquet().max_abs_multiplier for orbit in self.orbits])

    @property
    def multiplier_error(self) -> Array:
        """Estimated absolute error of the multipliers of each orbit, shape (orbits,); see `Orbit.multiplier_error`."""
        return np.array([orbit.multiplier_error for orbit in self.orbits])

    # Changes of stability ---------------------------------------------------------------------------------------------

    @cached_property
    def diagram_of_changes(self) -> StabilityDiagram | None:
        """Changes of stability of a family: `stability_diagram`, or `localised_diagram` of one with an endless tail.

        Computed on first use, from the course of the family and not from its points. None where changes of stability
        are not sought, or without a family.
        """
        if not (self.with_stability and self.with_events and self.solutions and self.space.is_family):
            return None
        from casadi_skin.follow.family_changes import family_tongues
        from casadi_skin.follow.localised_changes import localised_changes

        family, points = self.space, [solution.point for solution in self.solutions]
        if self._is_localised:
            return self._within_time(STABILITY, lambda: localised_changes(family, points))
        stability = (None, *(orbit.known_floquet for orbit in self.orbits))
        return self._within_time(STABILITY, lambda: family_tongues(family, (self.start, *points), stability=stability))

    @property
    def _is_localised(self) -> bool:
        """Whether multipliers of a family are those of localised perturbations: its linear tail is endless, or cut."""
        return bool(self.space.is_family and self.space.coordinates.localised is not None)

    @property
    def stability_diagram(self) -> StabilityDiagram | None:
        """Every tongue of instability of a family; None where changes of stability are not sought, or without a family.

        Computed on first use, as `diagram_of_changes`.
        """
        return None if self._is_localised else self.diagram_of_changes

    @property
    def localised_diagram(self) -> StabilityDiagram | None:
        """Every change of localised multipliers of a family whose linear tail is endless, or cut; None of others.

        Computed on first use. Weak instabilities of waves in the tail depend on its length, and are not among them.
        """
        return self.diagram_of_changes if self._is_localised else None

    @property
    def changes_known(self) -> bool:
        """Whether changes of stability need no computation now: those of a family are sought on first use."""
        known = vars(self).get("diagram_of_changes") is not None
        return bool(known or STABILITY in self._cut or not self.space.is_family)

    @property
    def changes(self) -> tuple[StabilityChange | StabilityEdge, ...]:
        """Changes of stability in order: every one of a family, of other branches those between two solutions.

        Empty where stability was not computed: `with_stability` says whether it was; and where they are not sought.
        """
        return self.located if self.diagram_of_changes is None else self.diagram_of_changes.changes

    @property
    def unresolved(self) -> tuple[Unresolved, ...]:
        """Stretches on which special points or changes of stability may be missing, with the reason.

        () says that none is: of a branch of equilibria for its special points, of others where stability was computed
        and changes of it are sought.
        """
        diagram = self.diagram_of_changes
        return (*self.passed_over, *(() if diagram is None else diagram.unresolved), *self._cut.values())

    @cached_property
    def _budget(self) -> Budget:
        return Budget(self.time_left, self.time_left)

    @cached_property
    def _cut(self) -> dict[str, Unresolved]:
        """What the time limit ended, by kind."""
        return {}

    def _within_time(self, kind: str, compute: Callable[[], T]) -> T | None:
        """What is computed within the time that is left; None where that is not enough, which is `unresolved` then."""
        try:
            with self._budget.spent():
                return compute()
        except TimeLimitError as error:
            start, end = float(self.values[0]), float(self.values[-1])
            self._cut[kind] = Unresolved(start, end, str(error), kind, self.parameter)
            return None

    @property
    def known_unresolved(self) -> tuple[Unresolved, ...]:
        """Those of `unresolved` that are known without a search for changes of stability now."""
        return self.unresolved if self.changes_known else self.passed_over

    @cached_property
    def passed_resonances(self) -> tuple[PassedResonance, ...] | None:
        """Stretches of a family that may have gone past an internal resonance too narrow to be resolved.

        Two runs of other tolerances may have other folds there and nowhere else. Computed on first use; None where it
        is not sought: without odd cosines, or where the Jacobian is not symmetric; and where the time limit ends the
        search.
        """
        if not self.space.is_family:
            return None
        family, points = self.space, [solution.point for solution in self.solutions]
        return self._within_time(
            "internal resonance",
            lambda: passed_resonances(family.point_solver, points, lambda point: family.value("S", point)),
        )

    def first_instability(self, growth: float = 0.0) -> Place | None:
        """The place where a family first becomes unstable, with the error of S.

        Arguments:
            growth: depth of a tongue, log |multiplier| over a period, from which on it counts.

        Returns:
            The start of the first tongue that is as deep; None where there is none. One may be missing where
            `unresolved` names a stretch before it.

        Raises:
            ValueError: changes of stability were not sought, or the branch is not a family.
        """
        if self.localised_diagram is not None:
            if growth:
                raise ValueError("first_instability: given growth with an endless tail; accepted: without")
            change = self.localised_diagram.first_loss
            return None if change is None else change.place
        if self.stability_diagram is None:
            cut = f"; {self._cut[STABILITY]}" if STABILITY in self._cut else ""
            raise ValueError(f"first_instability: accepted: a family followed with stability=True, events=True{cut}")
        tongue = self.stability_diagram.first_instability(growth)
        return None if tongue is None else tongue.start

    edge: ClassVar[Callable[..., SpecialPoint]]
    """The edge of a tongue of a family as a special point: `casadi_skin.points.edges.edge`."""
    edges_left: ClassVar[Callable[..., Iterator[SpecialPoint | Unresolved]]]
    """Edges of tongues at which other orbits leave a family: `casadi_skin.points.edges.edges_left`."""

    # Special points ---------------------------------------------------------------------------------------------------

    @property
    def special_points(self) -> tuple[SpecialPoint, ...]:
        """Special points, in order along the branch.

        Those of a family are located on first use: folds, then, where its changes of stability are sought, the
        points at which orbits of less symmetry leave it.
        """
        return self._sought[0]

    @property
    def not_located(self) -> tuple[Unresolved, ...]:
        """Special points that a family passes and that are not among `special_points`, with the reason."""
        return self._sought[1]

    @cached_property
    def _sought(self) -> tuple[tuple[SpecialPoint, ...], tuple[Unresolved, ...]]:
        """Special points, and what is known of those that are not located."""
        if self.space.locates_folds:
            special = (solution for solution in self.solutions if solution.point.special)
            return tuple(special_point(self.space, solution) for solution in special), ()
        diagram, (folds, gaps) = self.diagram_of_changes, self._folds
        edges = None if diagram is None else self._within_time(EDGE, lambda: tuple(self.edges_left()))
        leaving = tuple(edge for edge in edges or () if isinstance(edge, SpecialPoint))
        others = (edge for edge in edges or () if isinstance(edge, Unresolved))
        return (*folds, *leaving), (*gaps, *others, *self._cut.values())

    @cached_property
    def _folds(self) -> tuple[list[SpecialPoint], list[Unresolved]]:
        """Folds of a family, for which no changes of stability are sought, and stretches where one is not located."""
        return self._within_time(FOLD, lambda: folds_of_family(self.space, self.solutions)) or ([], [])

    follow_all: ClassVar[Callable[..., Any]]
    """A `Diagram` of all branches that leave this one or each other: `casadi_skin.points.diagram.follow_all`."""

    @property
    def folds(self) -> tuple[Solution, ...]:
        """Solutions at which the continuation parameter turns back."""
        points = self.special_points if self.space.locates_folds else self._folds[0]
        return tuple(point.solution for point in points if point.kind == FOLD)

    @cached_property
    def threshold(self) -> float | None:
        """S at which the end breather of the infinite chain is born; None where no tail is eliminated."""
        coordinates = getattr(self.space, "coordinates", None)
        value: float | None = getattr(coordinates, "threshold", None)
        return value

    # The end ----------------------------------------------------------------------------------------------------------

    @property
    def missed(self) -> tuple[float, ...]:
        """Requested values of the continuation parameter at which no solution was found."""
        return self.misses.get(self.parameter, ())

    @property
    def complete(self) -> bool:
        """Whether the branch reached its requested end and no requested point is missing."""
        return (self.stopped or self.end in (End.REACHED, End.CLOSED)) and not any(self.misses.values())

    @property
    def reason(self) -> str:
        """The end of the branch, in a sentence."""
        return reason_of(self)

    # At any value -----------------------------------------------------------------------------------------------------

    def at(self, value: float | None = None, which: int = 0, **named: float) -> Any:
        """The solution corrected exactly at a value of the continuation parameter, or of another quantity.

        Arguments:
            value: of the continuation parameter.
            which: counts the passages of the value along the branch, from 0.
            named: one value by name in place of `value`: of any number that `branch[name]` gives, as energy=0.3. S,
                Omega or the period of a family, the parameter followed, and Omega or an unknown period are held by
                the equations, others sought along the branch.

        Returns:
            The orbit or solution there.

        Raises:
            ValueError, TypeError: not exactly one number, or the branch does not pass it that often.
            ArithmeticError: no solution is found there.
        """
        given = {name: v for name, v in {self.parameter: value, **named}.items() if v is not None}
        if len(given) != 1 or (value is not None and named):
            accepted = f"one of {', '.join(self.space.held_names)}, or another quantity of the branch"
            raise ValueError(f"at: given {' and '.join(given) or 'nothing'}; accepted: {accepted}")
        ((name, wanted),) = given.items()
        whole("which", which, 0)
        wanted = number(f"at, {name}", wanted)
        if wanted in self.space.requested_values().get(name, ()) and wanted not in self.misses.get(name, ()):
            there = [solution for solution in self.solutions if solution.value(name) == wanted]
            if which < len(there):  # every passage is a solution already
                return there[which]
        return passage(self.space, self.solutions, self.quantity_of(name), (name, wanted), which)

    certify: ClassVar[Callable[..., Any]]
    """A proof that the family is one curve of orbits: `casadi_skin.certify.stretch.certify_branch`."""
    series: ClassVar[Callable[..., Any]]
    """The family as a power series in S, a `FamilySeries`: `casadi_skin.follow.family_series.series`."""
    certify_change: ClassVar[Callable[..., tuple[float, float] | None]]
    """Values of S between which a change of stability is proved: `casadi_skin.certify.stability.certify_change`."""


# The end of a branch in a sentence, with advice on the next request ---------------------------------------------------

NEAR_LIMIT = 1e-6  # relative
CLOSE_FREQUENCIES_RTOL = 1e-5  # difference of linear frequencies below which steps of the continuation may miss it
UNBOUNDED_WORDS = "grows without bound"
SLOW_PERIOD_FACTOR = 3.0  # times the period of the linear mode
STILL_S_RATE = 1e-2  # a relative change of S, per that of Omega, below which S has come to a limit


def reason_of(branch: Branch) -> str:
    """The end of a branch, in a sentence."""
    space, end = branch.space, branch.end
    if any(branch.misses.values()):
        return "; ".join([*_missing(branch), *([branch.detail] if branch.detail else [])])
    if branch.stopped:
        return "stopped where the condition holds"
    if end is None:
        return branch.detail or "interrupted"
    if end is End.REACHED:
        return str(end.value)
    came_back = end is End.RETURNED and not space.is_family
    words = "the branch came back to the value of the parameter that it started from" if came_back else str(end.value)
    if not (space.is_family and branch.solutions):
        near = near_resonance(space, CLOSE_FREQUENCIES_RTOL) if space.is_family else ""
        return f"{words}: {branch.detail}".rstrip(". :") + near
    last = branch.orbits[-1]
    where = f"(S = {last.S:.10g}, Omega = {last.Omega:.6g})"
    softened = _softened(branch, space.to)
    if end is End.FLOW and UNBOUNDED_WORDS in softened:
        return f"{softened.removeprefix('; ')} {where}; {words}: {branch.detail}"
    more = _wandering(branch) if end is End.POINTS else branch.detail
    near = near_resonance(space, CLOSE_FREQUENCIES_RTOL)
    return f"{words} {where}{f': {more}' if more else ''}{softened}{near}"


def _softened(branch: Branch, S: float) -> str:
    """The slow last orbit in words: its period, and whether S has come to a limit short of the requested S."""
    last = branch.orbits[-1]
    slower = branch.space.coordinates.frequency / last.point.Omega
    if slower < SLOW_PERIOD_FACTOR:
        return ""
    words = f"; the period is {slower:.3g} times the linear one"
    if last.point.parameter_rate > STILL_S_RATE:
        return words
    if abs(S - last.S) <= NEAR_LIMIT * last.S:
        return f"{words} and {UNBOUNDED_WORDS}: S = {S:.15g} is too near its limit for orbits to differ in doubles"
    return f"{words} and {UNBOUNDED_WORDS}: a softening orbit of this family does not exist at S = {S:.15g}"


def _missing(branch: Branch) -> Iterator[str]:
    """The requested values without a solution, in words."""
    what, whole_ = ("orbit", "family") if branch.space.is_family else ("solution", "branch")
    for name, missed in branch.misses.items():
        values = np.array([solution.value(name) for solution in branch.solutions])
        passed = [v for v in missed if values.size and values.min() <= v <= values.max()]
        beyond = [v for v in missed if v not in passed]
        if passed:
            yield f"no {what} was found at {name} = {_listed(passed)}, which the {whole_} passes"
        if beyond:
            covered = f"from {values.min():.6g} to {values.max():.15g}" if values.size else "nowhere"
            yield f"no {what} was found at {name} = {_listed(beyond)}: the {whole_} was followed {covered} in {name}"
    if branch.missed and branch.solutions and branch.space.is_family:
        softened = _softened(branch, branch.missed[-1])
        if softened:
            yield f"{softened.removeprefix('; ')}; ask for at_period or at_Omega, and end at a period_max"


def _wandering(branch: Branch) -> str:
    """The course of a family that used up its points, with advice on the next request."""
    family, S, Omega = branch.space, branch.S, branch.Omega
    turns = np.flatnonzero(np.diff(np.sign(np.diff(S))) != 0) + 1
    words, less = f"{S.size} points, largest S = {S.max():.6g}, smallest Omega = {Omega.min():.6g}", ""
    if turns.size:
        first = S[turns[0]]
        words += f", S turns back {turns.size} times, first at S = {first:.6g}"
        less = f"amplitude_max up to {0.999 * first:.4g}, before S first turns back, " if first > 0 else ""
    band = family.coordinates.band()
    if band is not None and family.coordinates.mode.size > 1:
        lowest, highest = np.sqrt(np.maximum(band, 0.0)).tolist()
        odd = [k for k in range(3, int(highest / Omega[-1]) + 1, 2) if k * Omega[-1] >= lowest]
        if odd:
            each = ", ".join(f"{k} Omega" for k in odd[:3]) + (", ..." if len(odd) > 3 else "")
            words += f"; {each} lie among the linear frequencies, and each that is met is a resonance to go round"
    more = f"max_points above {family.request.targets.max_points}"
    return f"{words}; try {less}a period_max, a smaller amplitude_max, or {more}"


def near_resonance(family: Any, within: float) -> str:
    """The resonance of a family's linear mode with another one, within a relative distance, in words; empty without."""
    coordinates, request = family.coordinates, family.request
    squares = linear_spectrum(request.model, request.parameters).squares  # none of long lattices
    odd = family.symmetry is SymmetryClass.QUARTER
    known = squares.size > 0 and squares[0] >= 0.0
    found = nearest_resonance(squares, coordinates.mode_number, odd) if known else None
    if found is None or found.off > within:
        return ""
    return f"; its linear mode is within {found.off:.1e} of {found.words}, where no family starts alone"


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.15g}" for value in values)


# Shares of harmonics in an orbit, and where along a family the third takes over from the first ------------------------


@in_turn
def harmonic_shares(orbit: Orbit, coordinates: str = "gauge") -> Array:
    """Shares of the odd harmonics 1, 3, 5, ... in the mean over time of sum_n x_n^2, shape (harmonics,), of sum 1.

    x is the displacement in the "gauge", where no site is favoured, or "physical". Raises ValueError for other words.
    """
    check_instance("orbit", orbit, Orbit)
    check_name("coordinates", coordinates, ("gauge", "physical"))
    count = max(4, orbit.harmonics)
    if coordinates == "physical":
        c = orbit.coefficients(count)
    else:
        theta = (np.arange(count) + 0.5) * np.pi / (2 * count)
        c = np.cos(np.outer(2 * np.arange(count) + 1, theta)) @ orbit.point.problem.sample(orbit.point.z, theta)
    squares = np.sum(c**2, axis=1)
    return np.asarray(squares / np.sum(squares))


@in_turn
def third_harmonic_leads(branch: Branch, coordinates: str = "gauge") -> Orbit | None:
    """The orbit at which the third harmonic first becomes as large as the fundamental, or None where it never does.

    Where no orbit is found between two of the branch, the first of the branch in which it is larger.
    """

    def lead(orbit: Orbit) -> float:
        shares = harmonic_shares(orbit, coordinates)
        return float(shares[1] - shares[0])

    check_instance("branch", branch, Branch)
    leads = [lead(orbit) for orbit in branch.orbits]
    leading = next((k for k, value in enumerate(leads) if value >= 0), None)
    if not leading:
        return None if leading is None else branch.orbits[0]
    (before, after), values = branch.orbits[leading - 1 : leading + 1], (leads[leading - 1], leads[leading])
    ends = before.point, after.point
    with suppress(ArithmeticError):
        return next(zeros_between(branch.space, ends, lambda p: lead(branch.space.solution(p)), values, values), after)
    return after
