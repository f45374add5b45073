"""What is asked of one family, checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from casadi_skin.arguments import number, numbers, short_repr
from casadi_skin.bvp.gauss import GaussProblem
from casadi_skin.bvp.problem import Scalar
from casadi_skin.bvp.radau import RadauProblem
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.continuation.points import SAME, ContinuationSettings, Target
from casadi_skin.lattice.chain import FIRST, LAST, Chain

if TYPE_CHECKING:
    pass

TWO_PI = 2.0 * math.pi
COLLOCATIONS: Mapping[str, type[GaussProblem | RadauProblem]] = MappingProxyType(
    {"gauss": GaussProblem, "radau": RadauProblem}
)
MAX_POINTS = 2000  # of a family: ten times what those need that do not wander from one resonance to the next
NARROWEST_BAND = 1e-10  # of its squared frequency, in which doubles tell modes apart; measured
QUICK_LOOK = 1e-5  # tolerance from which on points are for a quick look
DEGREE_RANGE = (2, 12)
NEGLIGIBLE = 1e-16  # of the cubic term: what of it the tail may leave out
PAYS, PAYS_FROM = 8, 500  # times the core's sites, and sites, from which on the elimination of the tail is cheaper
LONGEST_CORE = 5000


@dataclass(frozen=True)
class FamilyRequest:
    """One family of `chain`: from linear mode `mode` to S = `amplitude_max`, with points exactly at the S of `at`.

    Also exactly at the frequencies `at_Omega` and periods `at_period`, where the family passes them. It ends at the
    period `period_max` where that comes first, and after `max_points` points wherever it is then.

    `symmetry` may name a larger part of the period than the model's class needs (not trigonometric). Raises ValueError
    naming the argument, what was given and what is accepted.
    """

    chain: Chain
    mode: int
    amplitude_max: float
    at: tuple[float, ...] = ()
    tolerance: float = 1e-8
    transcription: str = "trigonometric"
    corrector: str = "ipopt"
    flow: str = "splitting"
    symmetry: SymmetryClass | None = None
    walker: str | None = None
    degree: int | None = None
    at_Omega: tuple[float, ...] = ()
    at_period: tuple[float, ...] = ()
    period_max: float | None = None
    max_points: int = MAX_POINTS
    tail: str | None = None

    def __post_init__(self) -> None:
        self._check_types()
        chain = self.chain
        if chain.g == 0:
            raise ValueError("g: given 0; accepted: not 0 (the family is the linear mode at every amplitude)")
        square = chain.linear_frequency(self.mode) ** 2
        if chain.sites > 1 and 0.0 < 4.0 * chain.coupling < NARROWEST_BAND * square:
            raise ValueError(
                f"alpha: given {chain.alpha!r}, beside which the band is {4 * chain.coupling / square:.0e} wide:"
                " doubles do not tell its modes apart; "
                f"accepted: alpha up to {4.0 * chain.coupling / NARROWEST_BAND:.3g}"
            )
        if abs(chain.gamma) == 1.0:
            edge = chain.sites if chain.g > 0 else 1
            if chain.mode_number(self.mode) != edge:
                raise ValueError(
                    f"mode: given {self.mode}; accepted at |gamma| = 1 with g = {chain.g:g}: {edge} (all frequencies "
                    "meet, and only the family in which the edge site alone moves exists in the gauge)"
                )
        if not (math.isfinite(self.amplitude_max) and self.amplitude_max > 0):
            raise ValueError(f"amplitude_max: given {self.amplitude_max!r}; accepted: a finite number > 0")
        ascending = all(a < b for a, b in zip(self.at, self.at[1:], strict=False))
        if not ascending or any(not 0 < a <= self.amplitude_max for a in self.at):
            raise ValueError(f"at: given {list(self.at)}; accepted: ascending numbers > 0 up to {self.amplitude_max:g}")
        if not 1e-13 <= self.tolerance <= 1e-2:
            raise ValueError(f"tolerance: given {self.tolerance!r}; accepted: 1e-13 to 1e-2")
        for name, accepted in (
            ("transcription", ("trigonometric", "gauss", "radau", "shooting")),
            ("corrector", ("ipopt", "newton")),
            ("walker", (None, "arclength", "series")),
            ("flow", ("splitting", "cvodes", "gauss", "rk4")),
            ("tail", (None, "eliminated", "full")),
        ):
            if getattr(self, name) not in accepted:
                names = ", ".join(word for word in accepted if word)
                raise ValueError(f"{name}: given {short_repr(getattr(self, name))}; accepted: {names}")
        if self.symmetry not in (None, SymmetryClass.QUARTER) and self.transcription == "trigonometric":
            raise ValueError(f"symmetry: given {self.symmetry}; odd cosines live on a quarter of the period; use gauss")
        if self.walker == "series" and self.transcription != "trigonometric":
            raise ValueError(f'walker: given "series"; accepted with {self.transcription}: arclength')
        self._check_degree()
        self._check_periods()
        obstacle = self._obstacle
        if obstacle and (self.tail == "eliminated" or chain.infinite):
            given = "an infinite chain" if chain.infinite else '"eliminated"'
            raise ValueError(f"{'sites' if chain.infinite else 'tail'}: given {given}; {obstacle}")
        if self.tail == "full" and chain.infinite:
            raise ValueError('tail: given "full" with an infinite chain; accepted: eliminated')

    def _check_types(self) -> None:
        """Raises TypeError, and ValueError for numbers that are not finite."""
        if not isinstance(self.chain, Chain):
            raise TypeError(f"chain: given {short_repr(self.chain)}; accepted: a Chain")
        number("amplitude_max", self.amplitude_max, "a finite number > 0")
        number("tolerance", self.tolerance, "1e-13 to 1e-2")
        for name in ("at", "at_Omega", "at_period"):
            numbers(name, getattr(self, name))
            if not isinstance(getattr(self, name), tuple):
                raise TypeError(f"{name}: given {short_repr(getattr(self, name))}; accepted: a tuple of finite numbers")
        if self.period_max is not None:
            number("period_max", self.period_max)
        if not (self.symmetry is None or isinstance(self.symmetry, SymmetryClass)):
            raise TypeError(f"symmetry: given {short_repr(self.symmetry)}; accepted: a SymmetryClass")

    # The tail of a long chain ---------------------------------------------------------------------------------------

    @property
    def core_sites(self) -> int:
        """Number of sites at the edge outside of which the cubic term is below round-off, counted to LONGEST_CORE."""
        chain, reach = self.chain, max(1.0, abs(self.chain.g) * self.amplitude_max)
        decay, sites = 2.0 * math.atanh(abs(chain.gamma)), 2
        while sites <= LONGEST_CORE and sites * decay < 2.0 * math.log(sites + 1) + math.log(reach / NEGLIGIBLE):
            sites += max(1, sites // 64)
        return sites

    @property
    def tailed(self) -> bool:
        """Whether the tail is eliminated: where that was asked for, or else pays."""
        if self.tail is not None or self.chain.infinite:
            return self.tail != "full"
        return not self._obstacle and self.chain.sites >= max(PAYS_FROM, PAYS * self.core_sites)

    @property
    def _obstacle(self) -> str:
        """Why the tail cannot be eliminated; empty where it can."""
        chain = self.chain
        if self.mode != chain.mode_number(LAST if chain.g > 0 else FIRST):
            wanted = "the highest mode with g > 0, or the lowest with g < 0 (others have no limit for long chains)"
        elif not 0.0 < abs(chain.gamma) < 1.0:
            wanted = "0 < |gamma| < 1, where a tail exists and is linear"
        elif self.transcription != "trigonometric" or self.walker == "series":
            wanted = "transcription trigonometric with walker arclength"
        elif self.core_sites > LONGEST_CORE:
            wanted = f"a gamma at which fewer than {LONGEST_CORE} sites are nonlinear"
        elif self.core_sites + 2 > chain.sites:
            wanted = f"more than {self.core_sites + 2} sites: so many are nonlinear at this gamma"
        elif chain.g < 0 and 9.0 * chain.band()[0] <= chain.band()[1]:
            wanted = "an alpha so large that three times the lowest frequency lies above the band"
        else:
            return ""
        return f"accepted: {wanted}"

    def _check_degree(self) -> None:
        low, high = DEGREE_RANGE
        if self.degree is None:
            return
        if self.transcription not in COLLOCATIONS:
            raise ValueError(
                f"degree: given {short_repr(self.degree)}; accepted: with {' or '.join(COLLOCATIONS)} only"
            )
        if not (isinstance(self.degree, int) and low <= self.degree <= high):
            raise ValueError(f"degree: given {short_repr(self.degree)}; accepted: a whole number from {low} to {high}")

    def _check_periods(self) -> None:
        linear = TWO_PI / self.chain.linear_frequency(self.mode)
        if self.period_max is not None and not linear * (1.0 + SAME) < self.period_max < math.inf:
            accepted = f"a finite number > {linear:.12g} (the period of linear mode {self.mode})"
            raise ValueError(f"period_max: given {self.period_max!r}; accepted: {accepted}")
        longest = math.inf if self.period_max is None else self.period_max
        for name, values, within in (
            ("at_Omega", self.at_Omega, [TWO_PI / value <= longest for value in self.at_Omega if value > 0]),
            ("at_period", self.at_period, [value <= longest for value in self.at_period]),
        ):
            positive = all(0 < value < math.inf for value in values)
            if not positive or len(set(values)) < len(values) or not all(within):
                most = "" if self.period_max is None else f", with periods up to period_max = {longest:g}"
                raise ValueError(f"{name}: given {list(values)}; accepted: finite numbers > 0, each once{most}")
        if not (isinstance(self.max_points, int) and self.max_points >= 1):
            raise ValueError(f"max_points: given {short_repr(self.max_points)}; accepted: a whole number >= 1")

    @property
    def way(self) -> str:
        """The walker asked for, or the fastest for the transcription: series have half the cost of predicted steps."""
        whole_cosines = self.transcription == "trigonometric" and not self.tailed
        return self.walker or ("series" if whole_cosines else "arclength")

    @property
    def collocation_degree(self) -> int:
        """Degree of the polynomials of gauss and radau: the one asked for, or the fastest for the tolerance.

        Measured for both at N = 1, 6 and 24: 5 at 1e-4, 8 or 9 at 1e-8, 10 to 12 at 1e-12.
        """
        return round(2.0 - 0.75 * math.log10(self.tolerance)) if self.degree is None else self.degree

    def continuation_settings(self) -> ContinuationSettings:
        """The walk in kappa = g S, the model's free parameter; a quick look has half the points."""
        g, end = self.chain.g, self.chain.g * self.amplitude_max
        at = [Target(Scalar.PARAMETER, g * S) for S in self.at]
        at += [Target(Scalar.OMEGA, Omega) for Omega in (*self.at_Omega, *self._Omega_of_period)]
        settings = ContinuationSettings(
            end,
            self.tolerance,
            tuple(dict.fromkeys(at)),
            None if self.period_max is None else TWO_PI / self.period_max,
            max_points=self.max_points,
        )
        if self.tolerance < QUICK_LOOK:
            return settings
        return replace(settings, max_step=2.0 * settings.max_step, max_parameter_step=2.0 * settings.max_parameter_step)

    def S_of(self, kappa: float) -> float:
        """S of a value of kappa = g S; exactly the S asked for where kappa came from one."""
        asked = {self.chain.g * S: S for S in (*self.at, self.amplitude_max)}
        return asked.get(kappa, kappa / self.chain.g)

    @property
    def _Omega_of_period(self) -> dict[float, float]:
        """Frequencies of the periods asked for, with these."""
        return {TWO_PI / period: period for period in self.at_period}

    def period_of(self, Omega: float) -> float:
        """Period at Omega; exactly the period asked for where Omega came from one."""
        asked = self._Omega_of_period
        if self.period_max is not None:
            asked[TWO_PI / self.period_max] = self.period_max
        return asked.get(Omega, TWO_PI / Omega)
