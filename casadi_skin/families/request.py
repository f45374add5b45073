"""What is asked of one family, checked; and the objects that computing it needs, each built when first used."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from casadi_skin.arguments import number, numbers, shown
from casadi_skin.bvp.gauss import GaussProblem
from casadi_skin.bvp.problem import OrbitProblem, Scalar
from casadi_skin.bvp.radau import RadauProblem
from casadi_skin.bvp.shooting import ShootingProblem
from casadi_skin.bvp.symmetry import SymmetryClass, symmetry_class
from casadi_skin.bvp.tailed import TailedProblem
from casadi_skin.bvp.trigonometric import TrigonometricProblem
from casadi_skin.continuation.arclength import ArclengthWalk
from casadi_skin.continuation.locating import Locator
from casadi_skin.continuation.points import SAME, Point, Target, Walk, WalkSettings
from casadi_skin.correctors.base import Corrector
from casadi_skin.correctors.ipopt import IpoptCorrector
from casadi_skin.correctors.ladder import Ladder
from casadi_skin.correctors.newton import NewtonCorrector
from casadi_skin.families.layout import Alone, Tailed, Whole
from casadi_skin.models.chain import FIRST, LAST, Chain
from casadi_skin.models.ode import OdeModel
from casadi_skin.stability.cvodes import CvodesFlow
from casadi_skin.stability.flow import FlowMap
from casadi_skin.stability.gauss_flow import GaussFlow
from casadi_skin.stability.rk4 import RungeKuttaFlow
from casadi_skin.stability.splitting import SplittingFlow

if TYPE_CHECKING:
    from casadi_skin.bvp.recursion import PolynomialForm, TaylorRecursion

TWO_PI = 2.0 * math.pi
HARMONICS = (4, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 64, 80, 96, 128, 160, 192, 256)
MANY_HARMONICS = (320, 384, 512)  # where few sites make them cheap
INTERVALS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)
DIGITS = (8, 10, 12, 14, 15)  # of CVODES' local tolerance: fewer cost as much, and their noise refuses more steps
SHOOTING_SHARE = 0.03  # of the tolerance, local: an orbit's error is 10 to 1000 local tolerances
SHOOTING_NOISE = 10.0  # local tolerances, which a corrector of shooting may leave
ROUND_OFF = 2e-15  # of a residual relative to the state, per square of the resolution
LARGEST = 10_000_000  # sites times harmonics squared: what fits into about a gigabyte
CHEAP = 1_000_000  # the same: what takes a fraction of a second to solve
COLLOCATIONS: Mapping[str, type[GaussProblem | RadauProblem]] = MappingProxyType(
    {"gauss": GaussProblem, "radau": RadauProblem}
)
MAX_POINTS = 2000  # of a family: ten times what those need that do not wander from one resonance to the next
NARROWEST_BAND = 1e-10  # of its squared frequency, in which doubles tell modes apart; measured
QUICK_LOOK = 1e-5  # tolerance from which on points are for a quick look
LONGEST_WHOLE = 5000  # sites of a chain whose stability is computed: all of them take part
DEGREE_RANGE = (2, 12)
SERIES_PRECISION = 1e-6  # of a residual: what is left before Newton's step
NEGLIGIBLE = 1e-16  # of the cubic term: what of it the tail may leave out
PAYS, PAYS_FROM = 8, 500  # times the core's sites, and sites, from which on the elimination of the tail is cheaper
LONGEST_CORE = 5000
SERIES_ORDERS = 24  # cost of a step over its length is flat between 20 and 35


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
                raise ValueError(f"{name}: given {shown(getattr(self, name))}; accepted: {names}")
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
            raise TypeError(f"chain: given {shown(self.chain)}; accepted: a Chain")
        number("amplitude_max", self.amplitude_max, "a finite number > 0")
        number("tolerance", self.tolerance, "1e-13 to 1e-2")
        for name in ("at", "at_Omega", "at_period"):
            numbers(name, getattr(self, name))
            if not isinstance(getattr(self, name), tuple):
                raise TypeError(f"{name}: given {shown(getattr(self, name))}; accepted: a tuple of finite numbers")
        if self.period_max is not None:
            number("period_max", self.period_max)
        if not (self.symmetry is None or isinstance(self.symmetry, SymmetryClass)):
            raise TypeError(f"symmetry: given {shown(self.symmetry)}; accepted: a SymmetryClass")

    # The tail of a long chain ---------------------------------------------------------------------------------------

    @property
    def core_sites(self) -> int:
        """Number of sites at the edge outside of which the cubic term is below round-off, counted to LONGEST_CORE."""
        chain, reach = self.chain, max(1.0, self.amplitude_max)
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
            raise ValueError(f"degree: given {shown(self.degree)}; accepted: with {' or '.join(COLLOCATIONS)} only")
        if not (isinstance(self.degree, int) and low <= self.degree <= high):
            raise ValueError(f"degree: given {shown(self.degree)}; accepted: a whole number from {low} to {high}")

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
            raise ValueError(f"max_points: given {shown(self.max_points)}; accepted: a whole number >= 1")

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

    def walk_settings(self) -> WalkSettings:
        """The walk in kappa = g S, the model's free parameter; a quick look has half the points."""
        g, end = self.chain.g, self.chain.g * self.amplitude_max
        at = [Target(Scalar.PARAMETER, g * S) for S in self.at]
        at += [Target(Scalar.OMEGA, Omega) for Omega in (*self.at_Omega, *self._Omega_of_period)]
        settings = WalkSettings(
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


class FamilyTools:
    """Model, problems, correctors and flow map of a request; nothing exists before it is asked for.

    Tools made once serve any number of walks of the same request.
    """

    def __init__(self, request: FamilyRequest) -> None:
        self.request = request
        self._recursions: dict[int, TaylorRecursion] = {}

    @cached_property
    def layout(self) -> Whole | Tailed:
        """Which sites are unknown: all, those where the cubic term is felt, or at |gamma| = 1 the edge site alone."""
        request, chain = self.request, self.request.chain
        if abs(chain.gamma) == 1.0:
            return Alone(Chain(1, chain.alpha, 0.0, chain.g), 1, chain)
        if request.tailed:
            return Tailed(
                chain, replace(chain, sites=request.core_sites, gamma=abs(chain.gamma)), -1 if chain.g > 0 else 1
            )
        return Whole(chain, request.mode)

    @property
    def core(self) -> Chain:
        """The chain whose equations are solved in the gauge."""
        return self.layout.core

    @property
    def linear_frequency(self) -> float:
        """Frequency of the linear mode that the family grows from."""
        alone = isinstance(self.layout, Alone)
        return self.core.linear_frequency(1) if alone else self.request.chain.linear_frequency(self.request.mode)

    @property
    def linear(self) -> tuple[Chain, int] | None:
        """Chain and mode whose closed formulas hold for the family; None in an infinite chain."""
        if isinstance(self.layout, Alone):
            return self.core, 1
        return None if self.request.chain.infinite else (self.request.chain, self.request.mode)

    @cached_property
    def whole(self) -> FamilyTools:
        """Tools of the same family with every site an unknown; raises ValueError where these are too many."""
        chain = self.request.chain
        if chain.sites > LONGEST_WHOLE:
            raise ValueError(
                f"sites: given {chain.sites}; stability is that of all sites, accepted: up to {LONGEST_WHOLE}"
            )
        return FamilyTools(replace(self.request, tail="full"))

    @cached_property
    def model(self) -> OdeModel:
        """The scaled equations in the gauge."""
        return self.core.gauge_model()

    @cached_property
    def rhs(self) -> ca.Function:
        """Function (q, kappa) -> acceleration and its derivatives."""
        return self.model.rhs_and_jacobian()

    @cached_property
    def hamiltonian(self) -> ca.Function:
        """Function (q, q', kappa) -> energy of the scaled gauge coordinates."""
        model = self.model
        return ca.Function("H", [model.state, model.velocity, model.parameters], [model.hamiltonian])

    @cached_property
    def symmetry(self) -> SymmetryClass:
        """Part of the period that is unknown."""
        return self.request.symmetry or symmetry_class(self.model)

    @cached_property
    def ladder(self) -> Ladder:
        """Discretisations from coarse to fine with their correctors."""
        if self.request.transcription == "shooting":
            useful = [d for d in DIGITS[:-2] if 10.0**-d <= SHOOTING_SHARE * self.request.tolerance]
            return Ladder(self._problem, self._corrector, (*useful, *DIGITS[-2:]))
        if self.request.transcription in COLLOCATIONS:
            return Ladder(self._problem, self._corrector, INTERVALS)
        fits = [H for H in HARMONICS if self.core.sites * H**2 <= LARGEST]
        fits += [H for H in MANY_HARMONICS if self.core.sites * H**2 <= CHEAP]
        return Ladder(self._problem, self._corrector, tuple(fits or HARMONICS[:2]))

    @cached_property
    def locator(self) -> Locator:
        """What makes points of the family at its tolerance."""
        return Locator(self.ladder, self.request.walk_settings())

    @cached_property
    def start(self) -> Point:
        """The linear mode at S = 0 with the tangent of the family."""
        layout = self.layout
        frequency = layout.start if isinstance(layout, Tailed) else self.linear_frequency
        return self.locator.start(layout.mode, frequency)

    def walk(self, history: tuple[Point, ...]) -> Walk:
        """The way along the family from the last points walked, or from `start`."""
        if self.request.way == "arclength":
            return ArclengthWalk(self.locator, history)
        from casadi_skin.continuation.series import SeriesWalk

        def precision(problem: OrbitProblem) -> float:
            allowed = max(self.corrector_tolerance, ROUND_OFF * problem.resolution**2)
            return min(0.1 * math.sqrt(allowed), SERIES_PRECISION)  # Newton's step squares it

        return SeriesWalk(self.locator, history, self._recursion, precision)

    def _recursion(self, problem: OrbitProblem) -> TaylorRecursion:
        """Power series on one rung of the ladder, made once."""
        from casadi_skin.bvp.recursion import TaylorRecursion

        assert isinstance(problem, TrigonometricProblem)
        if problem.resolution not in self._recursions:
            self._recursions[problem.resolution] = TaylorRecursion(problem, self._polynomial_form, SERIES_ORDERS)
        return self._recursions[problem.resolution]

    @cached_property
    def _polynomial_form(self) -> PolynomialForm:
        from casadi_skin.bvp.recursion import PolynomialForm

        return PolynomialForm.of(self.model)

    def _problem(self, resolution: int) -> OrbitProblem:
        if isinstance(self.layout, Tailed):
            return TailedProblem(self.model, resolution, self.layout.parameter(resolution))
        if self.request.transcription == "trigonometric":
            return TrigonometricProblem(self.model, resolution)
        if self.request.transcription == "shooting":
            return ShootingProblem(self.model, resolution, self.symmetry)
        make = COLLOCATIONS[self.request.transcription]
        return make(self.model, resolution, self.symmetry, self.request.collocation_degree)

    @property
    def corrector_tolerance(self) -> float:
        """What a corrector may leave of the residual, relative to the state, where round-off allows it."""
        return float(np.clip(1e-2 * self.request.tolerance, 1e-12, 1e-6))

    def _corrector(self, problem: OrbitProblem) -> Corrector:
        tolerance = self.corrector_tolerance
        if isinstance(problem, ShootingProblem):
            tolerance = max(tolerance, SHOOTING_NOISE * 10.0**-problem.resolution)
        if self.request.corrector == "newton":
            return NewtonCorrector(problem, tolerance)
        return IpoptCorrector(problem, max(tolerance, ROUND_OFF * problem.resolution**2))

    @cached_property
    def flow(self) -> FlowMap:
        """Flow map of the variational system."""
        make: dict[str, Callable[[OdeModel, float], FlowMap]] = {
            "splitting": SplittingFlow,
            "cvodes": CvodesFlow,
            "gauss": GaussFlow,
            "rk4": RungeKuttaFlow,
        }
        return make[self.request.flow](self.model, self.request.tolerance)
