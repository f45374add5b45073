"""The one registry of interchangeable methods: their names and their descriptions.

Scenes, messages and documentation read it, and it loads no numerics. The classes and functions by the same names are
where they are used: `zero.butcher.TABLES`, `solve.ipopt.CORRECTORS`, `follow.family.Family`,
`stability.family_stability.FLOWS`, `stability.full_period.FULL_PERIOD_FLOWS`, `model.integrators.INTEGRATORS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

Registry = Mapping[str, str]  # of methods by name: what each is, in words


def _registry(**methods: str) -> Registry:
    return MappingProxyType(methods)


TRIGONOMETRIC, SHOOTING = "trigonometric", "shooting"
FEWEST_COSINES = 4  # odd cosines that a family begins with
GAUSS, SPLITTING, COLLOCATION = "gauss", "splitting", "collocation"  # the defaults
COLLOCATION_TABLES = _registry(
    gauss="Gauss-Legendre collocation on intervals",
    radau="Radau IIA collocation on intervals, for stiff equations",
)
TRANSCRIPTIONS = _registry(
    trigonometric="odd cosines on a quarter of the period",
    **COLLOCATION_TABLES,
    shooting="multiple shooting by SUNDIALS CVODES",
)
CORRECTORS = _registry(
    ipopt="Ipopt on the equations as a nonlinear program",
    newton="Newton's method with the bordered linear solver",
)
CONTINUATIONS = _registry(
    arclength="pseudo-arclength predictor and corrector",
    series="Taylor series of the branch",
)
FLOWS = _registry(
    splitting="symplectic splitting, extrapolated",
    cvodes="SUNDIALS CVODES with sensitivities",
)
FULL_PERIOD_FLOWS = _registry(
    collocation="interval maps of the linearised collocation equations",
    cvodes="SUNDIALS CVODES with sensitivities",
)
INTEGRATORS = _registry(
    cvodes="SUNDIALS CVODES",
    dop853="Dormand-Prince of order 8",
    symplectic="symplectic splitting of order 6",
)
TAILS = ("eliminated", "full")
PAYS_FROM = 500  # sites from which on the elimination of a chain's linear tail may be cheaper
QUARTER_PERIOD = "reversible with half-period symmetry x(t + T/2) = P x(t): a quarter of the period"
EVERY_SITE = "the gauge, in which the chain is symmetric; every site is an unknown"
FORMATS = ("png", "svg", "pdf")  # of pictures
