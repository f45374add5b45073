"""Files of the linear spectrum of a lattice: modes with where they live, bands of the cell, the skin effect."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from casadi_skin.lattice.declaration import INDICES
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.linear import bands, lattice_modes
from casadi_skin.lattice.skin import brillouin_zone, winding_numbers
from casadi_skin.results import figures
from casadi_skin.results.dataset import Cell, write_csv
from casadi_skin.results.figures.bands import band_figure
from casadi_skin.results.figures.skin import skin_figure
from casadi_skin.runs.pictures import picture
from casadi_skin.runs.scene import Scene


def write_lattice_spectrum(scene: Scene, lattice: Lattice, parameters: Mapping[str, float], directory: Path) -> None:
    """spectrum.csv, where modes live, with pictures; where all cells are alike also bands and the skin effect."""
    modes, alike = lattice_modes(lattice, parameters), not lattice.declaration.differing
    has_skin = alike and len(lattice.declaration.cells) == 1
    if has_skin:
        windings = winding_numbers(lattice, modes.squares, parameters)
        sizes = np.abs(brillouin_zone(lattice, modes.squares, parameters)).mean(axis=1)
    rows: list[dict[str, Cell]] = []
    for j, omega in enumerate(modes.frequencies):
        row: dict[str, Cell] = {"mode": j + 1, "omega": float(omega.real), "growth": float(omega.imag)}
        row |= {"participation": modes.participation[j], "left_participation": modes.left_participation[j]}
        for k, name in zip(range(modes.centre.shape[1]), INDICES, strict=False):
            row |= {f"centre_{name}": modes.centre[j, k], f"decay_{name}": modes.decay[j, k]}
        if has_skin:
            row |= {"winding_number": float(windings[j]), "beta": float(sizes[j])}
        rows.append(row)
    write_csv(directory / "spectrum.csv", list(rows[0]), rows)
    if has_skin:
        picture(scene, directory / "skin", skin_figure, lattice, parameters)
    if modes.real and lattice.order == 2:
        picture(scene, directory / "spectrum", figures.spectrum_figure, lattice, parameters)
    if alike:
        _write_bands(scene, lattice, parameters, directory)


def _write_bands(scene: Scene, lattice: Lattice, parameters: Mapping[str, float], directory: Path) -> None:
    """bands.csv and its picture, of a lattice whose cells are all alike."""
    found = bands(lattice, parameters)
    names = INDICES[: found.wave_numbers.shape[1]]
    of_bands: list[dict[str, Cell]] = []
    for wave, squares in zip(found.wave_numbers, found.squares, strict=True):
        row: dict[str, Cell] = {f"k_{name}": float(k) for name, k in zip(names, wave, strict=True)}
        for b, square in enumerate(squares, start=1):
            row |= {f"omega_squared_{b}": float(square.real), f"imaginary_part_{b}": float(square.imag)}
        of_bands.append(row)
    write_csv(directory / "bands.csv", list(of_bands[0]), of_bands)
    picture(scene, directory / "bands", band_figure, lattice, parameters)
