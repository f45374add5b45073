"""What `check` prints of lattices: as what they were declared, and what they show of themselves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.long_lattice import LongLattice

Lines = list[tuple[str, str]]
MOST_WORDS = 16  # that a line of the plan lists


def lattice_lines(lattice: Lattice, parameters: Mapping[str, float]) -> Lines:
    """What a lattice was declared as, and what it shows of itself."""
    declared = lattice.declaration
    size = f"{' x '.join(map(str, declared.cells))} cells of {len(declared.sites)}, {declared.size} sites"
    by_cell = f"; by cell {', '.join(declared.by_cell)}" if declared.by_cell else ""
    return [
        ("lattice", f"{size}, {len(declared.bonds)} bonds a cell; ends {', '.join(declared.boundary)}"),
        ("parameters", (named(parameters) or "none") + by_cell),
        *lattice.structure.lines(),
    ]


def long_lattice_lines(lattice: LongLattice) -> Lines:
    """A lattice with a linear tail, and the linear modes at its edge."""
    modes = [f"{math.sqrt(mode.square):.6g}{' (pinned to a band)' if mode.pinned else ''}" for mode in lattice.modes]
    edge = "last" if lattice.at_last else "first"
    sites = f"{lattice.cells} cells of {len(lattice.sites)}, {len(lattice.bonds)} bonds a cell"
    return [
        ("lattice", f"{sites}; ends {lattice.boundary}; a linear tail behind the {edge} cells"),
        ("parameters", named(dict(lattice.parameters)) or "none"),
        ("edge modes", ", ".join(modes) or "none"),
    ]


def named(values: Mapping[str, float]) -> str:
    return listed([f"{name} = {value:g}" for name, value in values.items()])


def listed(words: Sequence[str]) -> str:
    """Words one after the other; of many the first and the last."""
    if len(words) <= MOST_WORDS:
        return ", ".join(words)
    return f"{', '.join(words[:2])}, ..., {words[-1]} ({len(words)} in all)"
