"""Nonlinear periodic orbits in nonreciprocal lattices: families, stability, and a continuation toolkit on CasADi."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from casadi_skin._version import __version__

if TYPE_CHECKING:
    from casadi_skin.bvp.statement import BoundaryValueProblem
    from casadi_skin.bvp.symmetry import SymmetryClass
    from casadi_skin.export.c_code import export_c
    from casadi_skin.export.fmu.archive import export_fmu
    from casadi_skin.lattice.chain import Chain
    from casadi_skin.models.ode import OdeModel
    from casadi_skin.optimise.kick.smallest_kick import smallest_kick
    from casadi_skin.optimise.search_orbit import search_orbit
    from casadi_skin.orbits.branch import Branch
    from casadi_skin.orbits.find_orbit import find_orbit
    from casadi_skin.orbits.follow import follow_family
    from casadi_skin.orbits.orbit import Orbit
    from casadi_skin.simulation import simulate

__all__ = [
    "BoundaryValueProblem",
    "Branch",
    "Chain",
    "OdeModel",
    "Orbit",
    "SymmetryClass",
    "__version__",
    "export_c",
    "export_fmu",
    "find_orbit",
    "follow_family",
    "search_orbit",
    "simulate",
    "smallest_kick",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that reading a scene or `--help` does not load CasADi."""
    places = {
        "BoundaryValueProblem": "bvp.statement",
        "Branch": "orbits.branch",
        "Chain": "lattice.chain",
        "OdeModel": "models.ode",
        "Orbit": "orbits.orbit",
        "SymmetryClass": "bvp.symmetry",
        "export_c": "export.c_code",
        "export_fmu": "export.fmu.archive",
        "find_orbit": "orbits.find_orbit",
        "follow_family": "orbits.follow",
        "simulate": "simulation",
        "search_orbit": "optimise.search_orbit",
        "smallest_kick": "optimise.kick.smallest_kick",
    }
    if name not in places:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"casadi_skin.{places[name]}"), name)
