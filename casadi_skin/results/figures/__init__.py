"""Pictures of results; dimensionless.

Figures are made without pyplot and leave the caller's matplotlib settings alone. Families and orbits are distinguished
by labels, markers and dashes, never by colour alone. `figures.spacetime` is imported where a time evolution is drawn.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from casadi_skin.results.figures.bands import spectrum_figure
    from casadi_skin.results.figures.bifurcation import (
        bifurcation_figure,
        curves_figure,
        edges_figure,
        frequency_figure,
    )
    from casadi_skin.results.figures.branch import branch_figure, orbit_figure
    from casadi_skin.results.figures.multipliers import multiplier_figure
    from casadi_skin.results.figures.profiles import portrait_figure, profile_figure
    from casadi_skin.results.figures.style import save

__all__ = [
    "bifurcation_figure",
    "branch_figure",
    "curves_figure",
    "edges_figure",
    "frequency_figure",
    "multiplier_figure",
    "orbit_figure",
    "portrait_figure",
    "profile_figure",
    "save",
    "spectrum_figure",
]


def __getattr__(name: str) -> Any:
    """Import a figure when it is first drawn: a run draws few of them."""
    places = {
        "bifurcation_figure": "bifurcation",
        "branch_figure": "branch",
        "curves_figure": "bifurcation",
        "edges_figure": "bifurcation",
        "frequency_figure": "bifurcation",
        "multiplier_figure": "multipliers",
        "orbit_figure": "branch",
        "portrait_figure": "profiles",
        "profile_figure": "profiles",
        "save": "style",
        "spectrum_figure": "bands",
    }
    if name not in places:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"casadi_skin.results.figures.{places[name]}"), name)
