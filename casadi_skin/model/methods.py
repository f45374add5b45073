"""The one registry of interchangeable methods: their names, their descriptions, and their implementations.

Scenes, messages and documentation read it. It loads no numerics: an implementation is imported when it is first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any, NamedTuple


class Implementation(NamedTuple):
    """A method as one line of the registry: the words that describe it, and its place as "module:name"."""

    words: str
    place: str

    def load(self) -> Any:
        """The class or function that implements the method, imported now."""
        module, name = self.place.split(":")
        return getattr(import_module(f"casadi_skin.{module}"), name)


Registry = Mapping[str, Implementation]


def _registry(**methods: tuple[str, str]) -> Registry:
    return MappingProxyType({name: Implementation(*entry) for name, entry in methods.items()})


TRIGONOMETRIC, SHOOTING = "trigonometric", "shooting"
FEWEST_COSINES = 4  # odd cosines that a family begins with
GAUSS, SPLITTING, COLLOCATION = "gauss", "splitting", "collocation"  # the defaults
COLLOCATION_TABLES = _registry(
    gauss=("Gauss-Legendre collocation on intervals", "zero.butcher:gauss_table"),
    radau=("Radau IIA collocation on intervals, for stiff equations", "zero.butcher:radau_table"),
)
TRANSCRIPTIONS = _registry(
    trigonometric=("odd cosines on a quarter of the period", "zero.trigonometric:TrigonometricProblem"),
    gauss=("Gauss-Legendre collocation on intervals", "zero.orbit_collocation:CollocationProblem"),
    radau=("Radau IIA collocation on intervals, for stiff equations", "zero.orbit_collocation:CollocationProblem"),
    shooting=("multiple shooting by SUNDIALS CVODES", "zero.shooting:ShootingProblem"),
)
CORRECTORS = _registry(
    ipopt=("Ipopt on the equations as a nonlinear program", "solve.ipopt:IpoptCorrector"),
    newton=("Newton's method with the bordered linear solver", "solve.newton:NewtonCorrector"),
)
CONTINUATIONS = _registry(
    arclength=("pseudo-arclength predictor and corrector", "follow.arclength:ArclengthContinuation"),
    series=("Taylor series of the branch", "follow.series:SeriesContinuation"),
)
FLOWS = _registry(
    splitting=("symplectic splitting, extrapolated", "stability.splitting:SplittingFlow"),
    cvodes=("SUNDIALS CVODES with sensitivities", "stability.cvodes:CvodesFlow"),
    gauss=("Gauss-Legendre collocation", "stability.gauss_flow:GaussFlow"),
    rk4=("classical Runge-Kutta method, extrapolated", "stability.rk4:RungeKuttaFlow"),
)
FULL_PERIOD_FLOWS = _registry(
    collocation=("interval maps of the linearised collocation equations", "stability.full_period:by_collocation"),
    cvodes=("SUNDIALS CVODES with sensitivities", "stability.full_period:by_cvodes"),
)
INTEGRATORS = _registry(
    cvodes=("SUNDIALS CVODES", "model.cvodes:cvodes"),
    dop853=("Dormand-Prince of order 8", "model.dop853:dop853"),
    symplectic=("symplectic splitting of order 6", "dynamics.splitting:symplectic"),
)
TASKS = _registry(  # tasks of methods whose object stands below their module
    optimise=("the optimum of a boundary-value problem", "optimise.boundary_nlp:optimise"),
    follow=("the branch through a solution", "follow.follow:follow"),
    critical=("what decides at a special point", "zero.normal_forms:critical"),
    hopf_end=("the Hopf point at which a branch of orbits ends", "points.cycles:hopf_end"),
    breaking=("what leaves a family of reversible orbits", "points.breaking:breaking_of"),
    lost=("the symmetries that are lost at a branch point of orbits", "points.lost_symmetry:lost_symmetries"),
    special_orbit=("a special orbit of a branch, to rounding", "zero.location:special_orbit"),
    switch=("the branch that leaves at a special point", "points.switch:switch"),
    follow_all=("all that leaves a branch", "points.diagram:follow_all"),
    curve=("a special point followed in a second parameter", "follow.curve:curve"),
    along=("a quantity along a branch", "results.quantities:along"),
    sought=("a quantity as a function of a solution", "results.quantities:sought"),
    to_xarray=("a result as an xarray dataset", "results.frames:result_to_xarray"),
    to_dataframe=("a result as a pandas data frame", "results.frames:result_to_dataframe"),
    lines=("a result in a few lines", "results.described:lines"),
    html=("a result as a table with its picture", "results.figures.notebook:html_table"),
    map_picture=("a quantity of a map drawn", "runs.map_pictures:picture"),
    map_html=("a map as a table with a picture", "runs.map_pictures:html"),
    map_plot=("a quantity of a map drawn into axes", "runs.map_pictures:plot"),
    plot=("a result drawn into axes", "results.figures.drawn:plot"),
    save=("a result in a file", "results.saving:save_result"),
    chain_coordinates=("the coordinates of a chain's family", "lattice.chain_coordinates:chain_coordinates"),
    long_lattice_coordinates=(
        "the coordinates of a long lattice's family",
        "lattice.cell_core:long_lattice_coordinates",
    ),
    chain_equations=("the equations of motion of a chain", "lattice.chain_equations:ChainEquations"),
    certify=("a proof that an orbit exists", "certify.certify:certify"),
    certify_stability=("a proof of an orbit's stability", "certify.stability:certify_stability"),
    certify_change=("a proof of a change of stability", "certify.stability:certify_change"),
    certify_branch=("a proof that a family is one curve", "certify.stretch:certify_branch"),
    threshold=("where an infinite chain's end breather is born", "dynamics.resonances:threshold"),
)
TAILS = ("eliminated", "full")
PAYS_FROM = 500  # sites from which on the elimination of a chain's linear tail may be cheaper
QUARTER_PERIOD = "reversible with half-period symmetry x(t + T/2) = P x(t): a quarter of the period"
EVERY_SITE = "the gauge, in which the chain is symmetric; every site is an unknown"
FORMATS = ("png", "svg", "pdf")  # of pictures
