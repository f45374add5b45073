"""Nonlinear periodic orbits in nonreciprocal lattices: families, stability, and a continuation toolkit on CasADi."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from casadi_skin._version import __version__
from casadi_skin.model.result import Result

if TYPE_CHECKING:
    from casadi_skin.dynamics.evolve import simulate
    from casadi_skin.export.c_code import export_c
    from casadi_skin.fmu.archive import export_fmu
    from casadi_skin.fmu.model import import_fmu
    from casadi_skin.follow.branch import Branch
    from casadi_skin.follow.find import find_equilibria, find_equilibrium, find_orbit
    from casadi_skin.follow.follow import follow_family
    from casadi_skin.follow.orbit import Orbit
    from casadi_skin.lattice.chain import Chain
    from casadi_skin.lattice.lattice import Bond, Lattice, Site, Uniform
    from casadi_skin.lattice.long_lattice import LongLattice
    from casadi_skin.model.conserved import SymmetryClass
    from casadi_skin.model.ode import OdeModel
    from casadi_skin.model.saved import read_model, save_model
    from casadi_skin.optimise.kick import smallest_kick
    from casadi_skin.optimise.search_orbit import search_orbit
    from casadi_skin.results.saving import read_result, save_result
    from casadi_skin.runs.map import run_map
    from casadi_skin.runs.map_result import read_map
    from casadi_skin.zero.boundary_value_problem import BoundaryValueProblem

__all__ = [
    "Bond",
    "BoundaryValueProblem",
    "Branch",
    "Chain",
    "Lattice",
    "LongLattice",
    "OdeModel",
    "Orbit",
    "Site",
    "SymmetryClass",
    "Uniform",
    "__version__",
    "export_c",
    "export_fmu",
    "find_equilibria",
    "find_equilibrium",
    "find_orbit",
    "follow_family",
    "import_fmu",
    "read_map",
    "read_model",
    "read_result",
    "run_map",
    "save_model",
    "save_result",
    "search_orbit",
    "simulate",
    "smallest_kick",
]

VERBS = {  # of classes by name: each a method, and the function that it is, "module:function"
    "Result": {
        "__str__": "results.present:lines",
        "_repr_html_": "results.present:html_table",
        "plot": "results.present:plot",
        "save": "results.saving:save_result",
        "to_dataframe": "results.present:to_dataframe",
        "to_xarray": "results.present:to_dataset",
    },
    "Solution": {"follow": "follow.follow:follow"},
    "Orbit": {"certify": "certify.certify:certify", "certify_stability": "certify.stability:certify_stability"},
    "SpecialPoint": {
        "curve": "points.curves:curve",
        "follow": "points.switch:switch",
        "lost_symmetries": "points.lost_symmetry:lost_at",
        "normal_form": "follow.normal_forms:critical",
    },
    "Branch": {
        "certify": "certify.stretch:certify_branch",
        "certify_change": "certify.stability:certify_change",
        "edge": "points.edges:edge",
        "edges_left": "points.edges:edges_left",
        "follow_all": "points.diagram:follow_all",
        "quantity": "results.quantities:along",
        "quantity_of": "results.quantities:sought",
    },
    "Statement": {"solve": "optimise.boundary_nlp:solve"},
    "Chain": {
        "equations_of_motion": "dynamics.evolution:chain_equations",
        "family_coordinates": "lattice.chain_coordinates:chain_coordinates",
        "threshold": "dynamics.resonances:threshold",
    },
    "LongLattice": {"family_coordinates": "lattice.core_with_tail:long_lattice_coordinates"},
    "Map": {
        "_repr_html_": "results.present:html_table",
        "figure": "runs.map_result:picture",
        "plot": "runs.map_result:plot",
        "to_dataframe": "results.present:to_dataframe",
    },
}
Result.bind(VERBS)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that reading a scene or `--help` does not load CasADi."""
    places = {
        "Bond": "lattice.lattice",
        "BoundaryValueProblem": "zero.boundary_value_problem",
        "Branch": "follow.branch",
        "Chain": "lattice.chain",
        "Lattice": "lattice.lattice",
        "LongLattice": "lattice.long_lattice",
        "OdeModel": "model.ode",
        "Orbit": "follow.orbit",
        "Site": "lattice.lattice",
        "SymmetryClass": "model.conserved",
        "Uniform": "lattice.lattice",
        "export_c": "export.c_code",
        "export_fmu": "fmu.archive",
        "find_equilibria": "follow.find",
        "find_equilibrium": "follow.find",
        "find_orbit": "follow.find",
        "follow_family": "follow.follow",
        "import_fmu": "fmu.model",
        "read_map": "runs.map_result",
        "read_model": "model.saved",
        "run_map": "runs.map",
        "read_result": "results.saving",
        "save_model": "model.saved",
        "save_result": "results.saving",
        "simulate": "dynamics.evolve",
        "search_orbit": "optimise.search_orbit",
        "smallest_kick": "optimise.kick",
    }
    if name not in places:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"casadi_skin.{places[name]}"), name)
