"""The lines that `check` prints of lattices: their declarations, and the properties found in them."""

from __future__ import annotations

import math
from collections.abc import Mapping

from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.long_lattice import LongLattice
from casadi_skin.models.ode import OdeModel
from casadi_skin.runs.words import Lines, named


def lattice_lines(lattice: LongLattice | OdeModel, parameters: Mapping[str, float]) -> Lines:
    """The declaration of a lattice, and the properties found in it."""
    if isinstance(lattice, LongLattice):
        return _long_lattice_lines(lattice)
    assert isinstance(lattice, Lattice)
    declared = lattice.declaration
    size = f"{' x '.join(map(str, declared.cells))} cells of {len(declared.sites)}, {declared.size} sites"
    by_cell = f"; by cell {', '.join(declared.by_cell)}" if declared.by_cell else ""
    return [
        ("lattice", f"{size}, {len(declared.bonds)} bonds a cell; ends {', '.join(declared.boundary)}"),
        ("parameters", (named(parameters) or "none") + by_cell),
        *lattice.structure.lines(),
    ]


def _long_lattice_lines(lattice: LongLattice) -> Lines:
    """A lattice with a linear tail, and the linear modes at its edge."""
    modes = [f"{math.sqrt(mode.square):.6g}{' (pinned to a band)' if mode.pinned else ''}" for mode in lattice.modes]
    edge = "last" if lattice.at_last else "first"
    sites = f"{lattice.cells} cells of {len(lattice.sites)}, {len(lattice.bonds)} bonds a cell"
    return [
        ("lattice", f"{sites}; ends {lattice.boundary}; a linear tail behind the {edge} cells"),
        ("parameters", named(dict(lattice.parameters)) or "none"),
        ("edge modes", ", ".join(modes) or "none"),
    ]
