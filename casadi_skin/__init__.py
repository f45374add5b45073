"""Nonlinear periodic orbits in nonreciprocal lattices: families, stability, and a continuation toolkit on CasADi."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from casadi_skin._version import __version__
from casadi_skin.model.result import Result

STUB = Path(__file__).with_name("__init__.pyi").read_text(encoding="utf-8")  # public names, for type checkers too
PLACES = {name: f"casadi_skin.{module}" for module, name in re.findall(r"from \.(\S+) import (\w+)", STUB)}
__all__ = ["__version__", *sorted(PLACES)]

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
    if name not in PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(__import__(PLACES[name], fromlist=[name]), name)  # also where it is a module
