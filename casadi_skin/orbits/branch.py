"""A family as computed: orbits in arclength order, changes of stability, and why the walk ended."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array, Scalar
from casadi_skin.continuation.points import End, Point, Target
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.request import TWO_PI
from casadi_skin.orbits.stability_changes import StabilityChange
from casadi_skin.orbits.tools import FamilyTools

if TYPE_CHECKING:
    import xarray


SLOW = 3.0  # times the period of the linear mode
NEAR_LIMIT = 1e-6  # relative
STILL = 1e-2  # a relative change of S, per that of Omega, below which S has come to a limit


@dataclass(frozen=True, eq=False)
class Branch:
    """Orbits of one family in arclength order; `start` is the linear mode at S = 0, which is not among them.

    `end` is None where the walk was interrupted; `missed`, `missed_Omega` and `missed_period` list requested values at
    which there is no orbit, though the family was followed to its end or passed them.
    """

    tools: FamilyTools
    start: Point
    orbits: tuple[Orbit, ...]
    changes: tuple[StabilityChange, ...]
    with_stability: bool
    end: End | None
    detail: str = ""
    missed: tuple[float, ...] = ()
    missed_Omega: tuple[float, ...] = ()
    missed_period: tuple[float, ...] = ()

    def __len__(self) -> int:
        return len(self.orbits)

    @property
    def S(self) -> Array:
        """Total amplitudes, shape (points,)."""
        return np.array([o.S for o in self.orbits])

    @property
    def Omega(self) -> Array:
        """Frequencies, shape (points,)."""
        return np.array([o.Omega for o in self.orbits])

    @property
    def energy(self) -> Array:
        """Energies, shape (points,)."""
        return np.array([o.energy for o in self.orbits])

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether each orbit is stable, shape (points,); computed now where it was not before."""
        return np.array([o.floquet().stable for o in self.orbits], dtype=bool)

    @property
    def max_abs_multiplier(self) -> Array:
        """Largest modulus of a multiplier of each orbit, shape (points,); computed now where it was not before."""
        return np.array([o.floquet().max_abs_multiplier for o in self.orbits])

    @property
    def multiplier_error(self) -> Array:
        """Estimated absolute error of the multipliers of each orbit, shape (points,); see `Orbit.multiplier_error`."""
        return np.array([o.multiplier_error for o in self.orbits])

    @cached_property
    def threshold(self) -> float | None:
        """S at which the end breather of the infinite chain is born; None where the tail is not eliminated."""
        from casadi_skin.lattice.threshold import threshold

        return threshold(self.tools.request.chain) if self.tools.request.tailed else None

    @property
    def complete(self) -> bool:
        """Whether the family reached what was asked and no requested point is missing."""
        return self.end is End.REACHED and not (self.missed or self.missed_Omega or self.missed_period)

    @property
    def reason(self) -> str:
        """How the family ended, in a sentence."""
        if self.missed or self.missed_Omega or self.missed_period:
            return "; ".join([*self._missing(), *([self.detail] if self.detail else [])])
        if self.end is None:
            return "interrupted"
        if self.end is End.REACHED:
            return str(self.end.value)
        if not self.orbits:
            return f"{self.end.value}. {self.detail}".rstrip(". ")
        last = self.orbits[-1]
        words = f"{self.end.value} (S = {last.S:.10g}, Omega = {last.Omega:.6g})"
        if self.end is End.POINTS:
            words += f": {self._wandering()}"
        elif self.detail:
            words += f": {self.detail}"
        return words + self._softened(self.tools.request.amplitude_max)

    def _softened(self, S: float) -> str:
        """Where the last orbit is a slow one: how slow, and whether S has come to a limit short of the S given."""
        last, request = self.orbits[-1], self.tools.request
        point = last.point
        slower = self.tools.linear_frequency / point.Omega
        if request.chain.g > 0 or slower < SLOW:
            return ""
        words = f"; the period is {slower:.3g} times the linear one"
        if point.parameter_rate > STILL:
            return words
        if abs(S - last.S) <= NEAR_LIMIT * last.S:
            return f"{words} and grows without bound: S = {S:.15g} is too near its limit to tell orbits apart"
        return f"{words} and grows without bound: a softening orbit of this family does not exist at S = {S:.15g}"

    def _missing(self) -> Iterator[str]:
        """The requested values without an orbit, in words."""
        for name, missed, values in (
            ("S", self.missed, self.S),
            ("Omega", self.missed_Omega, self.Omega),
            ("period", self.missed_period, TWO_PI / self.Omega),
        ):
            passed = [v for v in missed if values.size and values.min() <= v <= values.max()]
            beyond = [v for v in missed if v not in passed]
            if passed:
                yield f"no orbit was found at {name} = {_listed(passed)}, which the family passes"
            if beyond:
                covered = f"from {values.min():.6g} to {values.max():.15g}" if values.size else "nowhere"
                yield f"no orbit was found at {name} = {_listed(beyond)}: the family was followed {covered} in {name}"
        softened = self._softened(self.missed[-1]) if self.missed and self.orbits else ""
        if softened:
            yield f"{softened.removeprefix('; ')}; ask for at_period or at_Omega, and end at a period_max"

    def _wandering(self) -> str:
        """What a family did that used up its points, and what to ask for instead."""
        request, S = self.tools.request, self.S
        turns = np.flatnonzero(np.diff(np.sign(np.diff(S))) != 0) + 1
        words = f"{len(self)} points, largest S = {S.max():.6g}, smallest Omega = {self.Omega.min():.6g}"
        less = ""
        if turns.size:
            first = S[turns[0]]
            words += f", S turns back {turns.size} times, first at S = {first:.6g}"
            less = f"amplitude_max up to {0.999 * first:.4g}, before S first turns back, " if first > 0 else ""
        lowest, highest = np.sqrt(np.maximum(self.tools.core.band(), 0.0)).tolist()
        last = self.orbits[-1].Omega
        odd = [k for k in range(3, int(highest / last) + 1, 2) if k * last >= lowest]
        if odd and self.tools.core.sites > 1:
            each = ", ".join(f"{k} Omega" for k in odd[:3]) + (", ..." if len(odd) > 3 else "")
            words += f"; {each} lie among the linear frequencies, and each that is met is a resonance to go round"
        more = f"max_points above {request.max_points}"
        return f"{words}; try {less}a period_max, a smaller amplitude_max, or {more}"

    def at(
        self, S: float | None = None, which: int = 0, *, Omega: float | None = None, period: float | None = None
    ) -> Orbit:
        """The orbit corrected exactly at S, at Omega or at a period; `which` counts its passages along the branch.

        Raises ValueError where not one of the three is given or the branch does not pass it that often, ArithmeticError
        where no orbit is found there.
        """
        given = {name: v for name, v in (("S", S), ("Omega", Omega), ("period", period)) if v is not None}
        if len(given) != 1:
            raise ValueError(f"at: given {' and '.join(given) or 'nothing'}; accepted: one of S, Omega, period")
        ((name, value),) = given.items()
        if which < 0:
            raise ValueError(f"which: given {which}; accepted: a whole number from 0 on")
        if name != "S" and not 0 < value < np.inf:
            raise ValueError(f"at: given {name} = {value!r}; accepted: a finite number > 0")
        target = {
            "S": lambda: Target(Scalar.PARAMETER, self.tools.request.chain.g * value),
            "Omega": lambda: Target(Scalar.OMEGA, value),
            "period": lambda: Target(Scalar.OMEGA, TWO_PI / value),
        }[name]()
        point_solver = self.tools.point_solver
        passage, before = 0, self.start
        for orbit in self.orbits:
            if getattr(orbit, name) == value:
                found: list[Point | None] = [orbit.point]
            elif target.meets(orbit.point):
                found = [point_solver.beside(orbit.point, target)]
            elif target.meets(before):
                found = []
            else:
                found = [point for _, point in point_solver.between(before, orbit.point, (target,))]
            before = orbit.point
            for point in found:
                if passage < which:
                    passage += 1
                    continue
                if point is None:
                    raise ArithmeticError(f"at: no orbit was found at {name} = {value:g}, which the branch passes")
                return orbit if point is orbit.point else Orbit(self.tools, point, asked_S=S, asked_period=period)
        values = np.array([getattr(orbit, name) for orbit in self.orbits])
        covered = f"{values.min():g} to {values.max():g}" if self.orbits else "no point"
        words = f"the branch covers {covered} and passes {name} {passage} times"
        raise ValueError(f"at: given {name} = {value!r}, which = {which}; {words}")

    def to_xarray(self) -> xarray.Dataset:
        """The branch as an xarray Dataset along `point`, with profiles; needs the extra `xarray`.

        Raises ImportError where xarray is not installed.
        """
        import xarray as xr

        data = {
            "S": ("point", self.S),
            "Omega": ("point", self.Omega),
            "Omega_shift": ("point", np.array([o.Omega_shift for o in self.orbits])),
            "Omega_error": ("point", np.array([o.Omega_error for o in self.orbits])),
            "energy": ("point", self.energy),
            "profile": (("point", "site"), np.array([o.profile for o in self.orbits])),
        }
        if self.with_stability:
            data["stable"] = ("point", self.stable)
            data["max_abs_multiplier"] = ("point", self.max_abs_multiplier)
            data["multiplier_error"] = ("point", self.multiplier_error)
        request = self.tools.request
        chain = request.chain
        attributes = {"sites": chain.sites, "alpha": chain.alpha, "gamma": chain.gamma, "g": chain.g}
        coordinates = {"site": self.tools.layout.output_sites}
        return xr.Dataset(data, coordinates, {**attributes, "mode": request.mode, "tolerance": request.tolerance})


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.15g}" for value in values)
