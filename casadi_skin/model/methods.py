"""The one registry of interchangeable methods: their names and their descriptions.

Scenes, messages and documentation read it, and it loads no numerics. The classes and functions by the same names are
where they are used: `zero.butcher.TABLES`, `solve.ipopt.CORRECTORS`, `follow.family.Family`,
`stability.family_stability.FLOWS`, `stability.full_period.FULL_PERIOD_FLOWS`, `model.integrators.INTEGRATORS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal, get_args

Registry = Mapping[str, str]  # of methods by name: what each is, in words
Transcription = Literal["trigonometric", "gauss", "radau", "shooting"]
Corrector = Literal["ipopt", "newton"]
Continuation = Literal["arclength", "series"]
Flow = Literal["splitting", "cvodes", "collocation"]
Integrator = Literal["cvodes", "dop853", "symplectic"]
Tail = Literal["eliminated", "full"]
Format = Literal["png", "svg", "pdf"]  # of pictures


def _registry(names: Any, *words: str) -> Registry:
    return MappingProxyType(dict(zip(get_args(names), words, strict=True)))


TRIGONOMETRIC, SHOOTING = "trigonometric", "shooting"
FEWEST_COSINES = 4  # odd cosines that a family begins with
GAUSS, SPLITTING, COLLOCATION = "gauss", "splitting", "collocation"  # the defaults
TRANSCRIPTIONS = _registry(
    Transcription,
    "odd cosines on a quarter of the period",
    "Gauss-Legendre collocation on intervals",
    "Radau IIA collocation on intervals, for stiff equations",
    "multiple shooting by SUNDIALS CVODES",
)
COLLOCATION_TABLES = {name: TRANSCRIPTIONS[name] for name in ("gauss", "radau")}
CORRECTORS = _registry(
    Corrector, "Ipopt on the equations as a nonlinear program", "Newton's method with the bordered linear solver"
)
CONTINUATIONS = _registry(Continuation, "pseudo-arclength predictor and corrector", "Taylor series of the branch")
ALL_FLOWS = _registry(
    Flow,
    "symplectic splitting, extrapolated",
    "SUNDIALS CVODES with sensitivities",
    "interval maps of the linearised collocation equations",
)
FLOWS = {name: ALL_FLOWS[name] for name in ("splitting", "cvodes")}  # of families
FULL_PERIOD_FLOWS = {name: ALL_FLOWS[name] for name in ("collocation", "cvodes")}  # of other orbits
INTEGRATORS = _registry(Integrator, "SUNDIALS CVODES", "Dormand-Prince of order 8", "symplectic splitting of order 6")
TAILS: tuple[str, ...] = get_args(Tail)
PAYS_FROM = 500  # sites from which on the elimination of a chain's linear tail may be cheaper
QUARTER_PERIOD = "reversible with half-period symmetry x(t + T/2) = P x(t): a quarter of the period"
EVERY_SITE = "the gauge, in which the chain is symmetric; every site is an unknown"
FORMATS: tuple[str, ...] = get_args(Format)
