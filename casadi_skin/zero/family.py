"""A request states a family: a model, a linear mode, its end, its tolerance, its methods; all of it is checked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

from casadi_skin.model import methods
from casadi_skin.model.arguments import check_places, number, number_within, numbers, short_repr, whole
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.methods import COLLOCATION_TABLES, FLOWS, TRIGONOMETRIC
from casadi_skin.model.polynomial import NotPolynomialError
from casadi_skin.zero.coordinates import Coordinates
from casadi_skin.zero.cosines import PolynomialForm
from casadi_skin.zero.problem import Scalar
from casadi_skin.zero.settings import ContinuationSettings, Target

# Numerical methods of orbits, and the places along a branch where they are wanted: frozen objects ---------------------

TWO_PI = 2.0 * math.pi
TOLERANCE_RANGE = (1e-13, 1e-2)
HIGHEST_DEGREE = 12
MOST_INTERVALS = 1500  # of a first mesh
STABILITY_SITES = (8, 2000)  # matrices of twice as many rows
MAX_POINTS = 2000  # of a family: ten times the need of those that do not wander from one resonance to the next


@dataclass(frozen=True)
class Method:
    """The interchangeable methods by name, as in the table [method] of a scene; None leaves a choice open.

    Attributes:
        transcription: a name in `methods.TRANSCRIPTIONS`.
        degree: of the polynomials of gauss and radau.
        corrector: a name in `methods.CORRECTORS`.
        walker: a name in `methods.CONTINUATIONS`.
        flow: a name in `methods.FLOWS`, for orbits of a boundary-value problem in `methods.FULL_PERIOD_FLOWS`.
        tail: "eliminated" or "full": what becomes of the linear tail of a long chain.
        intervals: of the first mesh.
        symmetry: a part of the period larger than the symmetries of the model need.
        stability_sites: sites at the edge of a chain with an eliminated tail on whose motion stability is computed:
            localised multipliers. Left out, all sites, or as many as these need where they are too many.

    Raises ValueError for other values.
    """

    transcription: str | None = None
    degree: int | None = None
    corrector: str = "ipopt"
    walker: str | None = None
    flow: str | None = None
    tail: str | None = None
    intervals: int | None = None
    symmetry: SymmetryClass | None = None
    stability_sites: int | None = None

    def __post_init__(self) -> None:
        for name, accepted in (
            ("transcription", tuple(methods.TRANSCRIPTIONS)),
            ("corrector", tuple(methods.CORRECTORS)),
            ("walker", tuple(methods.CONTINUATIONS)),
            ("flow", tuple(methods.ALL_FLOWS)),
            ("tail", methods.TAILS),
        ):
            given = getattr(self, name)
            known = isinstance(given, str) and given in accepted
            if not known and not (given is None and name != "corrector"):
                raise ValueError(f"{name}: given {short_repr(given)}; accepted: {', '.join(accepted)}")
        if self.intervals is not None:
            whole("intervals", self.intervals, 1, MOST_INTERVALS)
        if not (self.symmetry is None or isinstance(self.symmetry, SymmetryClass)):
            raise TypeError(f"symmetry: given {short_repr(self.symmetry)}; accepted: a SymmetryClass")
        if self.stability_sites is not None:
            whole("stability_sites", self.stability_sites, *STABILITY_SITES)
        self._check_together()

    def _check_together(self) -> None:
        """Raises ValueError for two choices that exclude each other."""
        if self.walker == "series" and self.transcription not in (None, TRIGONOMETRIC):
            raise ValueError(f'walker: given "series"; accepted with {self.transcription}: arclength')
        if self.stability_sites is not None and self.tail == "full":
            raise ValueError(f'stability_sites: given {self.stability_sites} with tail "full"; accepted: eliminated')
        if self.symmetry not in (None, SymmetryClass.QUARTER) and self.transcription == TRIGONOMETRIC:
            raise ValueError(f"symmetry: given {self.symmetry}; odd cosines live on a quarter of the period; use gauss")

    def check_degree(self, lowest: int) -> None:
        """Raises ValueError for a degree that is none from `lowest` on, which depends on the problem."""
        if self.degree is not None:
            whole("degree", self.degree, lowest, HIGHEST_DEGREE)


@dataclass(frozen=True)
class Targets:
    """Places where orbits of a family are wanted exactly, and its ends but for its largest amplitude.

    Attributes:
        at: values of S, ascending.
        at_Omega: frequencies, each once.
        at_period: periods, each once.
        period_max: the period at which the family ends where that comes first.
        max_points: number of points after which it ends wherever it is.

    Raises ValueError and TypeError, naming the argument, for other values.
    """

    at: Sequence[float] = ()
    at_Omega: Sequence[float] = ()
    at_period: Sequence[float] = ()
    period_max: float | None = None
    max_points: int = MAX_POINTS

    def __post_init__(self) -> None:
        for name in ("at", "at_Omega", "at_period"):
            object.__setattr__(self, name, numbers(name, getattr(self, name)))
        if self.period_max is not None:
            number("period_max", self.period_max)
        whole("max_points", self.max_points, 1)


# Request for one family -----------------------------------------------------------------------------------------------

LOWEST_DEGREE = 2  # of polynomials on an interval
PARAMETER_SIZE_RANGE = 1e-150, 1e150  # sizes of the free parameter: their squares are doubles
LARGEST_S = 1e300  # S of which a picture can be drawn
QUICK_LOOK = 1e-5  # tolerance from which on points are for a quick look


@runtime_checkable
class FamilyModel(Protocol):
    """A model that hands in the coordinates of its families."""

    def family_coordinates(
        self, mode: int | str, amplitude_max: float, method: Method, parameters: Mapping[str, float] | None
    ) -> Coordinates:
        """Coordinates of the family that grows from a linear mode; raises ValueError where there is none."""
        ...


@dataclass(frozen=True)
class FamilyRequest:
    """One family of a model, from a linear mode at S = 0 to S = `amplitude_max`.

    Attributes:
        model: a `Chain` or another model with coordinates of its own, or an `OdeModel` of second order.
        mode: number of the linear mode by ascending frequency, from 1; "first" or "last".
        amplitude_max: largest S.
        targets: conditions at which orbits are wanted exactly, and further ends.
        tolerance: relative error of Omega, profile and multipliers.
        method: numerical methods; open choices are made for the model.
        parameters: values of the parameters of an `OdeModel` by name, where they are not its nominal ones.
        certify: orbits whose existence tables prove: True for requested orbits, "all" for every one.
        decimals: whether proofs take parameters and S for the decimals that Python prints for their doubles.

    Raises ValueError and TypeError, naming the argument, its value and the accepted values.
    """

    model: FamilyModel
    mode: int | str
    amplitude_max: float
    targets: Targets = field(default_factory=Targets)
    tolerance: float = 1e-8
    method: Method = field(default_factory=Method)
    parameters: Mapping[str, float] | None = None
    certify: bool | str = False
    decimals: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.model, FamilyModel):
            raise TypeError(f"model: given {short_repr(self.model)}; accepted: a Chain, or an OdeModel of second order")
        if not number("amplitude_max", self.amplitude_max, "a finite number > 0") > 0:
            raise ValueError(f"amplitude_max: given {self.amplitude_max!r}; accepted: a finite number > 0")
        number_within("tolerance", self.tolerance, *TOLERANCE_RANGE)
        if not isinstance(self.parameters, Mapping | None):
            raise TypeError(f"parameters: given {short_repr(self.parameters)}; accepted: numbers by name")
        coordinates = self.coordinates
        object.__setattr__(self, "mode", coordinates.mode_number)
        object.__setattr__(self, "method", self._completed(self.method))
        check_places(self.targets, self.amplitude_max, TWO_PI / coordinates.frequency, coordinates.mode_number)
        for name, S in (("amplitude_max", self.amplitude_max), *(("at", S) for S in self.targets.at)):
            self._check_range(name, S)

    def _check_range(self, name: str, S: float) -> None:
        """Raises ValueError for an amplitude that arithmetic in double precision does not reach."""
        try:
            parameter = abs(self.coordinates.parameter_of(S))
        except ArithmeticError:
            parameter = math.inf
        low, high = PARAMETER_SIZE_RANGE
        if not low <= parameter <= high:
            size = f"the free parameter of the scaled equations (g S of a chain) has the size {parameter:.3g} there"
            raise ValueError(f"{name}: given {S!r}; {size}; accepted: sizes from {low:g} to {high:g}")
        if S > LARGEST_S:
            raise ValueError(f"{name}: given {S!r}; accepted: a number up to {LARGEST_S:g}")

    @cached_property
    def coordinates(self) -> Coordinates:
        """The coordinates that the family is solved in."""
        return self.model.family_coordinates(self.mode, self.amplitude_max, self.method, self.parameters)

    def _completed(self, method: Method) -> Method:
        """The method with every choice made; raises ValueError for one that is not for families."""
        scaled = self.coordinates.scaled
        odd = scaled.half_period is not None
        transcription = method.transcription or (TRIGONOMETRIC if odd and method.symmetry is None else "gauss")
        if transcription == TRIGONOMETRIC and not odd:
            accepted = "gauss, radau or shooting: the model declares no half-period symmetry"
            raise ValueError(f"transcription: given {TRIGONOMETRIC}; accepted: {accepted}")
        if method.flow not in (None, *FLOWS):
            raise ValueError(f"flow: given {short_repr(method.flow)}; accepted: {', '.join(FLOWS)}")
        if method.intervals is not None:
            raise ValueError(f"intervals: given {method.intervals}; accepted for families: none, the tolerance decides")
        if method.degree is not None and transcription not in COLLOCATION_TABLES:
            accepted = f"with {' or '.join(COLLOCATION_TABLES)} only"
            raise ValueError(f"degree: given {short_repr(method.degree)}; accepted: {accepted}")
        method.check_degree(LOWEST_DEGREE)
        if method.stability_sites is not None and self.coordinates.localised is None:
            given = f"stability_sites: given {method.stability_sites}"
            raise ValueError(f"{given}; accepted: with a chain whose linear tail is eliminated")
        return replace(
            method,
            transcription=transcription,
            flow=method.flow or "splitting",
            walker=self._walker(method, transcription),
        )

    def _walker(self, method: Method, transcription: str) -> str:
        """The requested continuation, or the fastest: a Taylor series has half the cost of predicted steps."""
        if method.walker is not None:
            return method.walker
        return "series" if transcription == TRIGONOMETRIC and is_polynomial(self.coordinates) else "arclength"

    def for_stability(self, walker: str | None = None) -> FamilyRequest:
        """With every position an unknown, as stability needs, unless the method states another choice."""
        coordinates = self.coordinates
        if self.method.tail is not None or coordinates.is_whole or coordinates.localised is not None:
            return self
        coordinates.check_whole("stability")
        return replace(self, method=replace(self.method, tail="full", walker=walker))

    @property
    def degree(self) -> int:
        """Degree of the polynomials of gauss and radau: the requested one, or the fastest for the tolerance.

        Measured for both at N = 1, 6 and 24: 5 at 1e-4, 8 or 9 at 1e-8, 10 to 12 at 1e-12.
        """
        return round(2.0 - 0.75 * math.log10(self.tolerance)) if self.method.degree is None else self.method.degree

    # In the parameter that the family is followed in ------------------------------------------------------------------

    def continuation_settings(self) -> ContinuationSettings:
        """Settings in the free parameter of the scaled equations; a quick look has half the points."""
        parameter_of, targets = self.coordinates.parameter_of, self.targets
        at = [Target(Scalar.PARAMETER, parameter_of(S)) for S in targets.at]
        at += [Target(Scalar.OMEGA, Omega) for Omega in (*targets.at_Omega, *self._Omega_of_period)]
        settings = ContinuationSettings(
            parameter_of(self.amplitude_max),
            self.tolerance,
            tuple(dict.fromkeys(at)),
            None if targets.period_max is None else TWO_PI / targets.period_max,
            max_points=targets.max_points,
            rounds_corners=True,
        )
        if self.tolerance < QUICK_LOOK:
            return settings
        return replace(settings, max_step=2.0 * settings.max_step, max_parameter_step=2.0 * settings.max_parameter_step)

    def S_of(self, parameter: float) -> float:
        """S at a value of the free parameter; exactly the requested S where the value came from one."""
        requested = {self.coordinates.parameter_of(S): S for S in (*self.targets.at, self.amplitude_max)}
        return requested.get(parameter) or self.coordinates.S_of(parameter)

    @property
    def _Omega_of_period(self) -> dict[float, float]:
        """Frequencies of the requested periods, with these."""
        return {TWO_PI / period: period for period in self.targets.at_period}

    def period_of(self, Omega: float) -> float:
        """Period at Omega; exactly the requested period where Omega came from one."""
        requested = self._Omega_of_period
        if self.targets.period_max is not None:
            requested[TWO_PI / self.targets.period_max] = self.targets.period_max
        return requested.get(Omega, TWO_PI / Omega)


def is_polynomial(coordinates: Coordinates) -> bool:
    """Whether the scaled equations have a power series that the recursion of the branch can compute."""
    try:
        PolynomialForm.of(coordinates.scaled)
    except NotPolynomialError:
        return False
    return True


def family_request(
    model: FamilyModel, mode: int | str, amplitude_max: float, *, tolerance: float = 1e-8,
    parameters: Mapping[str, float] | None = None, **more: Any,
) -> FamilyRequest:  # fmt: skip
    """A request from keywords as scripts write them: fields of `Targets` and of `Method`. Raises as `FamilyRequest`."""
    targets = Targets(**{field.name: more.pop(field.name) for field in fields(Targets) if field.name in more})
    return FamilyRequest(model, mode, amplitude_max, targets, tolerance, Method(**more), parameters)
