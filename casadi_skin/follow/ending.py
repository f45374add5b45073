"""The end of a branch in a sentence, with advice on the next request."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import FAMILY, SolutionSpace
from casadi_skin.lattice.spectrum import linear_spectrum
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.zero.model_coordinates import nearest_resonance
from casadi_skin.zero.settings import End

NEAR_LIMIT = 1e-6  # relative
CLOSE_FREQUENCIES_RTOL = (
    1e-5  # relative difference of linear frequencies below which steps of the continuation may miss it
)
UNBOUNDED_WORDS = "grows without bound"
SLOW_PERIOD_FACTOR = 3.0  # times the period of the linear mode
STILL_S_RATE = 1e-2  # a relative change of S, per that of Omega, below which S has come to a limit


@dataclass(frozen=True, eq=False)
class Ending:
    """Data of the end of a branch; the attributes are those of `Branch`."""

    space: SolutionSpace
    solutions: tuple[Solution, ...]
    end: End | None
    detail: str
    misses: Mapping[str, tuple[float, ...]]
    stopped: bool

    @property
    def orbits(self) -> tuple[Orbit, ...]:
        """The solutions of a family."""
        return cast(tuple[Orbit, ...], self.solutions)

    @property
    def reason(self) -> str:
        """The end of the branch, in a sentence."""
        if any(self.misses.values()):
            return "; ".join([*self._missing(), *([self.detail] if self.detail else [])])
        if self.stopped:
            return "stopped where the condition holds"
        if self.end is None:
            return self.detail or "interrupted"
        if self.end is End.REACHED:
            return str(self.end.value)
        if self.space.connects != FAMILY:
            return f"{self._end_words()}: {self.detail}".rstrip(". :")
        near = near_resonance(self.space, CLOSE_FREQUENCIES_RTOL)
        if not self.solutions:
            return f"{self._end_words()}: {self.detail}".rstrip(". :") + near
        last = self.orbits[-1]
        where = f"(S = {last.S:.10g}, Omega = {last.Omega:.6g})"
        softened = self._softened(self.space, self.space.to)
        if self.end is End.FLOW and UNBOUNDED_WORDS in softened:
            return f"{softened.removeprefix('; ')} {where}; {self._end_words()}: {self.detail}"
        words = f"{self._end_words()} {where}"
        if self.end is End.POINTS:
            words += f": {self._wandering(self.space)}"
        elif self.detail:
            words += f": {self.detail}"
        return words + softened + near

    def _end_words(self) -> str:
        if self.end is End.RETURNED and self.space.connects != FAMILY:
            return "the branch came back to the value of the parameter that it started from"
        return str(self.end.value) if self.end is not None else ""

    def _softened(self, family: Any, S: float) -> str:
        """The slow last orbit in words: its period, and whether S has come to a limit short of the requested S."""
        last = self.orbits[-1]
        slower = family.coordinates.frequency / last.point.Omega
        if slower < SLOW_PERIOD_FACTOR:
            return ""
        words = f"; the period is {slower:.3g} times the linear one"
        if last.point.parameter_rate > STILL_S_RATE:
            return words
        if abs(S - last.S) <= NEAR_LIMIT * last.S:
            return f"{words} and {UNBOUNDED_WORDS}: S = {S:.15g} is too near its limit for orbits to differ in doubles"
        return f"{words} and {UNBOUNDED_WORDS}: a softening orbit of this family does not exist at S = {S:.15g}"

    def _missing(self) -> Iterator[str]:
        """The requested values without a solution, in words."""
        for name, missed in self.misses.items():
            values = np.array([solution.value(name) for solution in self.solutions])
            passed = [v for v in missed if values.size and values.min() <= v <= values.max()]
            beyond = [v for v in missed if v not in passed]
            what = "orbit" if self.space.connects == FAMILY else "solution"
            whole = "family" if self.space.connects == FAMILY else "branch"
            if passed:
                yield f"no {what} was found at {name} = {_listed(passed)}, which the {whole} passes"
            if beyond:
                covered = f"from {values.min():.6g} to {values.max():.15g}" if values.size else "nowhere"
                yield f"no {what} was found at {name} = {_listed(beyond)}: the {whole} was followed {covered} in {name}"
        missed_S = self.misses.get(self.space.parameter, ())
        if missed_S and self.solutions and self.space.connects == FAMILY:
            softened = self._softened(self.space, missed_S[-1])
            if softened:
                yield f"{softened.removeprefix('; ')}; ask for at_period or at_Omega, and end at a period_max"

    def _wandering(self, family: Any) -> str:
        """The course of a family that used up its points, with advice on the next request."""
        request, S = family.request, np.array([orbit.S for orbit in self.orbits])
        slowest = min(orbit.Omega for orbit in self.orbits)
        turns = np.flatnonzero(np.diff(np.sign(np.diff(S))) != 0) + 1
        words = f"{S.size} points, largest S = {S.max():.6g}, smallest Omega = {slowest:.6g}"
        less = ""
        if turns.size:
            first = S[turns[0]]
            words += f", S turns back {turns.size} times, first at S = {first:.6g}"
            less = f"amplitude_max up to {0.999 * first:.4g}, before S first turns back, " if first > 0 else ""
        band = family.coordinates.band()
        if band is not None and family.coordinates.mode.size > 1:
            lowest, highest = np.sqrt(np.maximum(band, 0.0)).tolist()
            last = self.orbits[-1].Omega
            odd = [k for k in range(3, int(highest / last) + 1, 2) if k * last >= lowest]
            if odd:
                each = ", ".join(f"{k} Omega" for k in odd[:3]) + (", ..." if len(odd) > 3 else "")
                words += f"; {each} lie among the linear frequencies, and each that is met is a resonance to go round"
        more = f"max_points above {request.targets.max_points}"
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
