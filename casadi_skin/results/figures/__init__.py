"""Pictures of results; dimensionless.

Figures are made without pyplot and leave the caller's matplotlib settings alone. Families and orbits are distinguished
by labels, markers and dashes, never by colour alone. A module is imported where one of its pictures is drawn.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

PLACES = {
    "branches": ("bifurcation_figure", "branch_figure", "curves_figure", "edges_figure"),
    "families": ("frequency_figure", "plane_figure", "profile_figure", "series_figure"),
    "multipliers": ("multiplier_figure",),
    "solutions": ("animate", "orbit_figure", "portrait_figure"),
    "bands": ("band_figure", "skin_figure", "spectrum_figure"),
    "evolutions": ("spacetime_figure", "spreading_figure"),
    "style": ("save",),
}


def __getattr__(name: str) -> Any:
    """Import a figure when it is first drawn: a run draws few of them."""
    for module, names in PLACES.items():
        if name in names:
            return getattr(import_module(f"casadi_skin.results.figures.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
