"""A family as computed: orbits in arclength order, changes of stability, and why the walk ended."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.points import End, Point, is_any
from casadi_skin.families.events import StabilityChange
from casadi_skin.families.orbit import Orbit
from casadi_skin.families.request import FamilyTools

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class Branch:
    """Orbits of one family in arclength order; `start` is the linear mode at S = 0, which is not among them.

    `end` is None where the walk was interrupted; `missed` lists requested S that the walk passed without an orbit.
    """

    tools: FamilyTools
    start: Point
    orbits: tuple[Orbit, ...]
    changes: tuple[StabilityChange, ...]
    with_stability: bool
    end: End | None
    detail: str = ""
    missed: tuple[float, ...] = ()

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
        from casadi_skin.families.threshold import threshold

        return threshold(self.tools.request.chain) if self.tools.request.tailed else None

    @property
    def complete(self) -> bool:
        """Whether the family reached what was asked and no requested point is missing."""
        return self.end is End.REACHED and not self.missed

    @property
    def reason(self) -> str:
        """How the family ended, in a sentence."""
        request = self.tools.request
        if self.missed:
            return f"no orbit was found at S = {', '.join(f'{S:g}' for S in self.missed)}, which the family passes"
        if self.end is None:
            return "interrupted"
        if self.end is End.REACHED or not self.orbits:
            return f"{self.end.value}. {self.detail}".rstrip(". ")
        last = self.orbits[-1]
        words = f"{self.end.value} (S = {last.S:.10g}, Omega = {last.Omega:.6g})"
        if self.detail:
            words += f": {self.detail}"
        omega = self.tools.linear_frequency
        if request.chain.g < 0 and last.Omega < 0.3 * omega:
            words += (
                f"; the period, {last.Omega and omega / last.Omega:.3g} times the linear one, grows without bound: a "
                f"softening orbit of this family does not exist at S = {request.amplitude_max:g}"
            )
        return words

    def at(self, S: float, which: int = 0) -> Orbit:
        """The orbit corrected exactly at S; `which` counts the passages of S along the branch from 0.

        Raises ValueError where the branch does not pass S that often, ArithmeticError where no orbit is found there.
        """
        if which < 0:
            raise ValueError(f"which: given {which}; accepted: a whole number from 0 on")
        kappa = self.tools.request.chain.g * S
        locator = self.tools.locator
        passage, before = 0, self.start
        for orbit in self.orbits:
            if orbit.S == S:
                found: list[Point | None] = [orbit.point]
            elif is_any(orbit.point.parameter, (kappa,)):
                found = [locator.beside(orbit.point, kappa)]
            elif is_any(before.parameter, (kappa,)):
                found = []
            else:
                found = [point for _, point in locator.between(before, orbit.point, (kappa,))]
            before = orbit.point
            for point in found:
                if passage < which:
                    passage += 1
                    continue
                if point is None:
                    raise ArithmeticError(f"at: no orbit was found at S = {S:g}, which the branch passes")
                return orbit if point is orbit.point else Orbit(self.tools, point, asked_S=S)
        covered = f"{self.S.min():g} to {self.S.max():g}" if self.orbits else "no point"
        raise ValueError(
            f"at: given S = {S!r}, which = {which}; the branch covers {covered} and passes S {passage} times"
        )

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
        coordinates = {"site": np.arange(1, chain.sites + 1)}
        return xr.Dataset(data, coordinates, {**attributes, "mode": request.mode, "tolerance": request.tolerance})
