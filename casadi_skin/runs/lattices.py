"""What is said and written of lattices: their declarations, the properties found in them, and their linear spectra."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from casadi_skin.lattice.declaration import CELL_INDICES
from casadi_skin.lattice.lattice import Lattice, LongLattice
from casadi_skin.lattice.linear import REAL_SQUARE_RTOL, bands, brillouin_zone, lattice_modes, winding_numbers
from casadi_skin.results import figures
from casadi_skin.results.dataset import write_columns
from casadi_skin.results.figures.bands import band_figure, skin_figure
from casadi_skin.runs.output import Lines, named
from casadi_skin.runs.parts import picture
from casadi_skin.runs.scene import Scene

ZERO_SQUARE_RATIO = 1e-13  # of the largest omega^2: smaller ones are 0
MOST_MODES = 600  # whose frequencies a plan computes at once


def lattice_lines(lattice: Lattice, parameters: Mapping[str, float]) -> Lines:
    """The declaration of a lattice, and the properties found in it."""
    declared = lattice.declaration
    size = f"{' x '.join(map(str, declared.cells))} cells of {len(declared.sites)}, {declared.size} sites"
    by_cell = f"; by cell {', '.join(declared.by_cell)}" if declared.by_cell else ""
    return [
        ("lattice", f"{size}, {len(declared.bonds)} bonds a cell; ends {', '.join(declared.boundary)}"),
        ("parameters", (named(parameters) or "none") + by_cell),
        *lattice.structure.lines(),
        ("linear", _linear(lattice, parameters)),
    ]


def _linear(lattice: Lattice, parameters: Mapping[str, float]) -> str:
    """Frequencies about rest without damping and drives, the digits that they lose, and bands and gaps of the cell."""
    words = []
    if lattice.declaration.size <= MOST_MODES:
        modes = lattice_modes(lattice, parameters)
        squares = modes.squares
        words.append(f"omega {_from_to(squares.real.min(), squares.real.max())}")
        if not modes.real:
            count = int(np.sum(np.abs(squares.imag) > REAL_SQUARE_RTOL * np.max(np.abs(squares))))
            words[0] += f"; {count} of {squares.size} omega^2 are complex: it has no families"
        lost = np.log10(np.max(1.0 / np.abs(np.sum(modes.left * modes.right, axis=0))))
        if lattice.structure.log_weights is None and lost >= 1.0:
            words.append(f"left and right modes differ so that about {lost:.0f} digits of them are lost")
    if not lattice.declaration.differing:
        found = bands(lattice, parameters)
        low, high = found.squares.real.min(axis=0), found.squares.real.max(axis=0)
        ring = "" if lattice.structure.log_weights is not None else "real part of a ring's "
        words.append(f"{ring}bands {', '.join(_from_to(a, b) for a, b in zip(low, high, strict=True))}")
        gaps = [_from_to(a, b) for a, b in found.gaps]
        words.append(f"gaps {', '.join(gaps)}" if gaps else "no gap")
    return "; ".join(words) or f"not computed for more than {MOST_MODES} sites that differ"


def _from_to(low: float, high: float) -> str:
    """Ends of a range of omega^2 as those of omega, imaginary where omega^2 < 0."""
    zero = ZERO_SQUARE_RATIO * max(abs(low), abs(high))
    ends = (f"{np.sqrt(abs(end)):.6g}{'i' if end < -zero else ''}" if abs(end) > zero else "0" for end in (low, high))
    return "from " + " to ".join(ends)


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


# Files of the linear spectrum: modes with where they live, bands of the cell, the skin effect -------------------------


def write_lattice_spectrum(scene: Scene, lattice: Lattice, parameters: Mapping[str, float], directory: Path) -> None:
    """spectrum.csv, where modes live, with pictures; where all cells are alike also bands and the skin effect."""
    modes, alike = lattice_modes(lattice, parameters), not lattice.declaration.differing
    has_skin = alike and len(lattice.declaration.cells) == 1
    if has_skin:
        windings = winding_numbers(lattice, modes.squares, parameters)
        sizes = np.abs(brillouin_zone(lattice, modes.squares, parameters)).mean(axis=1)
    columns: dict[str, Any] = {"mode": np.arange(modes.frequencies.size) + 1}
    columns |= {"omega": modes.frequencies.real, "growth": modes.frequencies.imag}
    columns |= {"participation": modes.participation, "left_participation": modes.left_participation}
    for name, centre, decay in zip(CELL_INDICES, modes.centre.T, modes.decay.T, strict=False):
        columns |= {f"centre_{name}": centre, f"decay_{name}": decay}
    if has_skin:
        columns |= {"winding_number": windings, "beta": sizes}
    write_columns(directory / "spectrum.csv", columns)
    if has_skin:
        picture(scene, directory / "skin", skin_figure, lattice, parameters)
    if modes.real and lattice.order == 2:
        picture(scene, directory / "spectrum", figures.spectrum_figure, lattice, parameters)
    if alike:
        found = bands(lattice, parameters)
        columns = {f"k_{name}": k for name, k in zip(CELL_INDICES, found.wave_numbers.T, strict=False)}
        for b, squares in enumerate(found.squares.T, start=1):
            columns |= {f"omega_squared_{b}": squares.real, f"imaginary_part_{b}": squares.imag}
        write_columns(directory / "bands.csv", columns)
        picture(scene, directory / "bands", band_figure, lattice, parameters)
