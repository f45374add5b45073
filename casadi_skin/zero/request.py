"""Request for one family, checked: a model, a linear mode, its end, its tolerance, its methods."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

from casadi_skin.model.arguments import number, short_repr
from casadi_skin.model.methods import COLLOCATION_TABLES, FLOWS, TRIGONOMETRIC
from casadi_skin.zero.family import TOLERANCE_RANGE, TWO_PI, Coordinates, Method, Targets
from casadi_skin.zero.problem import Scalar
from casadi_skin.zero.settings import ContinuationSettings, Target

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
        low, high = TOLERANCE_RANGE
        if not low <= number("tolerance", self.tolerance, f"{low:g} to {high:g}") <= high:
            raise ValueError(f"tolerance: given {self.tolerance!r}; accepted: {low:g} to {high:g}")
        if not isinstance(self.parameters, Mapping | None):
            raise TypeError(f"parameters: given {short_repr(self.parameters)}; accepted: numbers by name")
        coordinates = self.coordinates
        object.__setattr__(self, "mode", coordinates.mode_number)
        object.__setattr__(self, "method", self._completed(self.method))
        self.targets.check(self.amplitude_max, TWO_PI / coordinates.frequency, coordinates.mode_number)
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
    from casadi_skin.model.polynomial import NotPolynomialError
    from casadi_skin.zero.recursion import PolynomialForm

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
