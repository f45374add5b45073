"""Nonlinear periodic orbits in nonreciprocal lattices: families, stability, and a continuation toolkit on CasADi."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from casadi_skin._version import __version__
from casadi_skin.model.result import Result

if TYPE_CHECKING:
    from casadi_skin.certify.certificate import Certificate as Certificate
    from casadi_skin.dynamics.evolution import Evolution as Evolution, EvolutionError as EvolutionError
    from casadi_skin.dynamics.evolve import distance_from_orbit as distance_from_orbit, evolve as evolve
    from casadi_skin.dynamics.evolve import perturbed as perturbed, simulate as simulate
    from casadi_skin.dynamics.evolve import simulate_orbit as simulate_orbit
    from casadi_skin.dynamics.resonances import conservative_part as conservative_part, energy_balance as energy_balance
    from casadi_skin.dynamics.resonances import resonances as resonances
    from casadi_skin.dynamics.starts import initial_state as initial_state, spreading as spreading
    from casadi_skin.export.c_code import export_c as export_c
    from casadi_skin.export.codegen import build_c as build_c
    from casadi_skin.fmu.archive import export_fmu as export_fmu
    from casadi_skin.fmu.model import import_fmu as import_fmu
    from casadi_skin.follow.branch import Branch as Branch, harmonic_shares as harmonic_shares
    from casadi_skin.follow.branch import third_harmonic_leads as third_harmonic_leads
    from casadi_skin.follow.family_series import FamilySeries as FamilySeries
    from casadi_skin.follow.find import find_orbit as find_orbit
    from casadi_skin.follow.follow import follow_family as follow_family
    from casadi_skin.follow.rest_space import find_equilibria as find_equilibria, find_equilibrium as find_equilibrium
    from casadi_skin.follow.solution import Equilibrium as Equilibrium, Orbit as Orbit, Solution as Solution
    from casadi_skin.follow.space import BoundaryError as BoundaryError, EquilibriumError as EquilibriumError
    from casadi_skin.follow.special_points import SpecialPoint as SpecialPoint
    from casadi_skin.lattice import closed_forms as closed_forms
    from casadi_skin.lattice.chain import Chain as Chain
    from casadi_skin.lattice.lattice import Bond as Bond, Lattice as Lattice, LongLattice as LongLattice, Site as Site
    from casadi_skin.lattice.lattice import Uniform as Uniform
    from casadi_skin.lattice.linear import bands as bands, brillouin_zone as brillouin_zone
    from casadi_skin.lattice.linear import lattice_modes as lattice_modes, winding_numbers as winding_numbers
    from casadi_skin.model.conserved import SymmetryClass as SymmetryClass
    from casadi_skin.model.ode import OdeModel as OdeModel
    from casadi_skin.model.saved import read_model as read_model, save_model as save_model
    from casadi_skin.points.diagram import Diagram as Diagram
    from casadi_skin.points.gradient import Gradient as Gradient
    from casadi_skin.results.figures.style import style as style
    from casadi_skin.results.saving import read_result as read_result, save_result as save_result
    from casadi_skin.runs.map import run_map as run_map
    from casadi_skin.runs.map_result import Map as Map, read_map as read_map
    from casadi_skin.search.design import Design as Design
    from casadi_skin.search.designs import optimise as optimise
    from casadi_skin.search.fit import Fit as Fit, fit_parameters as fit_parameters
    from casadi_skin.search.kick import KickError as KickError, SmallestKick as SmallestKick
    from casadi_skin.search.kick import smallest_kick as smallest_kick
    from casadi_skin.search.orbit_search import search_orbit as search_orbit
    from casadi_skin.search.pareto import ParetoFront as ParetoFront, pareto_front as pareto_front
    from casadi_skin.stability.growth import TransientGrowth as TransientGrowth
    from casadi_skin.stability.result import Floquet as Floquet
    from casadi_skin.zero.statement import BoundaryValueProblem as BoundaryValueProblem

PLACES = {  # modules of public names, each imported when one of its names is first used
    "certify.certificate": ("Certificate",),
    "dynamics.evolution": ("Evolution", "EvolutionError"),
    "dynamics.evolve": ("distance_from_orbit", "evolve", "perturbed", "simulate", "simulate_orbit"),
    "dynamics.resonances": ("conservative_part", "energy_balance", "resonances"),
    "dynamics.starts": ("initial_state", "spreading"),
    "export.c_code": ("export_c",),
    "export.codegen": ("build_c",),
    "fmu.archive": ("export_fmu",),
    "fmu.model": ("import_fmu",),
    "follow.branch": ("Branch", "harmonic_shares", "third_harmonic_leads"),
    "follow.family_series": ("FamilySeries",),
    "follow.find": ("find_orbit",),
    "follow.follow": ("follow_family",),
    "follow.rest_space": ("find_equilibria", "find_equilibrium"),
    "follow.solution": ("Equilibrium", "Orbit", "Solution"),
    "follow.space": ("BoundaryError", "EquilibriumError"),
    "follow.special_points": ("SpecialPoint",),
    "lattice": ("closed_forms",),
    "lattice.chain": ("Chain",),
    "lattice.lattice": ("Bond", "Lattice", "LongLattice", "Site", "Uniform"),
    "lattice.linear": ("bands", "brillouin_zone", "lattice_modes", "winding_numbers"),
    "model.conserved": ("SymmetryClass",),
    "model.ode": ("OdeModel",),
    "model.saved": ("read_model", "save_model"),
    "points.diagram": ("Diagram",),
    "points.gradient": ("Gradient",),
    "results.figures.style": ("style",),
    "results.saving": ("read_result", "save_result"),
    "runs.map": ("run_map",),
    "runs.map_result": ("Map", "read_map"),
    "search.design": ("Design",),
    "search.designs": ("optimise",),
    "search.fit": ("Fit", "fit_parameters"),
    "search.kick": ("KickError", "SmallestKick", "smallest_kick"),
    "search.orbit_search": ("search_orbit",),
    "search.pareto": ("ParetoFront", "pareto_front"),
    "stability.growth": ("TransientGrowth",),
    "stability.result": ("Floquet",),
    "zero.statement": ("BoundaryValueProblem",),
}
__all__ = ["__version__", *sorted(name for names in PLACES.values() for name in names)]

VERBS = {  # of classes by name: each a method, and the function that it is, "module:function"
    "Result": {
        "__str__": "results.present:lines",
        "_repr_html_": "results.present:html_table",
        "plot": "results.present:plot",
        "save": "results.saving:save_result",
        "to_dataframe": "results.present:to_dataframe",
        "to_xarray": "results.present:to_dataset",
    },
    "Solution": {"follow": "follow.follow:follow", "gradient": "points.gradient:gradient_of"},
    "Orbit": {"certify": "certify.certify:certify", "certify_stability": "certify.stability:certify_stability"},
    "SpecialPoint": {
        "curve": "points.curves:curve",
        "follow": "points.switch:switch",
        "gradient": "points.gradient:gradient",
        "lost_symmetries": "points.lost_symmetry:lost_at",
        "normal_form": "follow.normal_forms:critical",
        "spread": "points.gradient:spread",
    },
    "Branch": {
        "certify": "certify.stretch:certify_branch",
        "certify_change": "certify.stability:certify_change",
        "edge": "points.edges:edge",
        "edges_left": "points.edges:edges_left",
        "follow_all": "points.diagram:follow_all",
        "quantity": "results.quantities:along",
        "quantity_of": "results.quantities:sought",
        "series": "follow.family_series:series",
    },
    "Statement": {"solve": "search.boundary_nlp:solve"},
    "OdeModel": {
        "equations_of_motion": "dynamics.evolution:model_equations",
        "family_coordinates": "zero.model_coordinates:coordinates_of_model",
        "linear_frequencies": "zero.model_coordinates:frequencies_of_model",
        "linear_spectrum": "zero.model_coordinates:spectrum_of_model",
        "family_equations": "search.families:model_equations",
    },
    "Chain": {
        "equations_of_motion": "dynamics.evolution:chain_equations",
        "family_coordinates": "lattice.chain_coordinates:chain_coordinates",
        "family_equations": "search.families:chain_equations",
        "threshold": "dynamics.resonances:threshold",
        "threshold_gradient": "dynamics.resonances:threshold_gradient",
    },
    "LongLattice": {"family_coordinates": "lattice.core_with_tail:long_lattice_coordinates"},
    "Map": {
        "_repr_html_": "results.present:html_table",
        "to_dataframe": "results.present:to_dataframe",
    },
}
Result.bind(VERBS)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that reading a scene or `--help` does not load CasADi."""
    for place, names in PLACES.items():
        if name in names:
            return getattr(__import__(f"casadi_skin.{place}", fromlist=[name]), name)  # also where it is a module
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
