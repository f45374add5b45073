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
from casadi_skin.bvp.problem import Array, OrbitProblem, Scalar
from casadi_skin.bvp.radau import RadauProblem
from casadi_skin.bvp.shooting import ShootingProblem
from casadi_skin.bvp.symmetry import SymmetryClass, symmetry_class
from casadi_skin.bvp.trigonometric import TrigonometricProblem
from casadi_skin.continuation.arclength import ArclengthWalk
from casadi_skin.continuation.locating import Locator
from casadi_skin.continuation.points import SAME, Point, Target, Walk, WalkSettings
from casadi_skin.correctors.base import Corrector
from casadi_skin.correctors.ipopt import IpoptCorrector
from casadi_skin.correctors.ladder import Ladder
from casadi_skin.correctors.newton import NewtonCorrector
from casadi_skin.models.chain import Chain
from casadi_skin.models.ode import OdeModel
from casadi_skin.stability.cvodes import CvodesFlow
from casadi_skin.stability.flow import FlowMap
from casadi_skin.stability.gauss_flow import GaussFlow
from casadi_skin.stability.rk4 import RungeKuttaFlow
from casadi_skin.stability.splitting import SplittingFlow
from casadi_skin.theory.linear import standing_wave

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
QUICK_LOOK = 1e-5  # tolerance from which on points are for a quick look
DEGREE_RANGE = (2, 12)
SERIES_PRECISION = 1e-6  # of a residual: what is left before Newton's step
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

    def __post_init__(self) -> None:
        self._check_types()
        chain = self.chain
        if chain.g == 0:
            raise ValueError("g: given 0; accepted: not 0 (the family is the linear mode at every amplitude)")
        chain.linear_frequency(self.mode)
        if abs(chain.gamma) == 1.0:
            edge = chain.sites if chain.g > 0 else 1
            if self.mode != edge:
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
        return self.walker or ("series" if self.transcription == "trigonometric" else "arclength")

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
    def core(self) -> Chain:
        """The chain whose gauge is solved: the edge site alone at |gamma| = 1, where it moves by itself."""
        chain = self.request.chain
        return chain if abs(chain.gamma) < 1.0 else Chain(1, chain.alpha, 0.0, chain.g)

    @cached_property
    def core_mode(self) -> int:
        """The mode of `core` that the family grows from."""
        return self.request.mode if self.core.sites == self.request.chain.sites else 1

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
    def mode_positions(self) -> Array:
        """The linear mode in the gauge with sum_n w_n q_n^2 = 1, largest displacement positive, shape (sites,)."""
        q = standing_wave(self.core.sites, self.core_mode)
        q = q / np.sqrt(np.sum(self.core.weights * q**2))
        return np.asarray(q * np.sign(q[np.argmax(np.abs(self.core.rho * q))]))

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
        return self.locator.start(self.mode_positions, self.core.linear_frequency(self.core_mode))

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
