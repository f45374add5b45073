"""Nonlinear periodic orbits in nonreciprocal lattices: families, stability, and a continuation toolkit on CasADi."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from casadi_skin._version import __version__

if TYPE_CHECKING:
    from casadi_skin.bvp.symmetry import SymmetryClass
    from casadi_skin.families.branch import Branch
    from casadi_skin.families.follow import follow_family
    from casadi_skin.families.orbit import Orbit
    from casadi_skin.models.chain import Chain
    from casadi_skin.models.ode import OdeModel

__all__ = ["Branch", "Chain", "OdeModel", "Orbit", "SymmetryClass", "__version__", "follow_family"]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that reading a scene or `--help` does not load CasADi."""
    places = {
        "Branch": "families.branch",
        "Chain": "models.chain",
        "OdeModel": "models.ode",
        "Orbit": "families.orbit",
        "SymmetryClass": "bvp.symmetry",
        "follow_family": "families.follow",
    }
    if name not in places:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"casadi_skin.{places[name]}"), name)
