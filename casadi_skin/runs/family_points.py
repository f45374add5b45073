"""Results of families beside their points: branches that leave them, and edges of tongues in a parameter."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.lattice.declaration import INDICES
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.linear import REAL, bands, brillouin_zone, lattice_modes, winding_numbers
from casadi_skin.lattice.long_lattice import LongLattice
from casadi_skin.model.ode import OdeModel
from casadi_skin.points.edges import EdgeCurve
from casadi_skin.points.switch import leaving_space
from casadi_skin.results import figures
from casadi_skin.results.branch_records import EdgeRecord, Records
from casadi_skin.results.dataset import dataset_of, write_csv, write_netcdf
from casadi_skin.results.figures.bands import band_figure, skin_figure
from casadi_skin.results.quantities import Cell
from casadi_skin.results.saving import restored, saved
from casadi_skin.results.tables import edge_columns
from casadi_skin.runs.output import Lines, named
from casadi_skin.runs.parts import Offshoots, ended_well, mode_of, picture
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import ContinuationTable, Scene

EVENTS, FURTHER = "events.csv", "further_events.csv"  # where edges are listed
POINT_COLUMNS = ("branch", "kind", "S", "error", "Omega", "period", "mu", "loses")


def reasons(found: Offshoots) -> Iterator[str]:
    """Why something that was followed from families did not end well, in a line each."""
    for name, branch in found.leaving:
        if not ended_well(branch):
            yield f"[continuation] switch: {name}: {branch.reason}"
    for mode, listed, number, curve in found.edges:
        if not curve.complete:
            yield f"[continuation] curve: mode {mode}, edge {number} of {listed}: {curve.reason}"


def leaving_spaces(
    families: Sequence[Branch], table: ContinuationTable, failures: list[str]
) -> Iterator[tuple[str, SolutionSpace]]:
    """Names and spaces of the branches that leave families at special points of the requested kinds."""
    for family in families:
        for number, point in enumerate(family.special_points, start=1):
            if point.kind not in table.switch:
                continue
            options = {"at": (), "max_points": table.max_points, "max_step": table.max_step, "tolerance": 1e-8}
            try:
                space = leaving_space(point, "S", table.to, side=1, **options)  # type: ignore[arg-type]
            except (ValueError, ArithmeticError) as error:
                where = f"mode {mode_of(family)}, {point.kind} at S = {point.parameters['S']:.8g}"
                failures.append(f"[continuation] switch: {where}: {error}")
            else:
                yield f"other_j{mode_of(family)}_{number}", space


def follow_edges(
    families: Sequence[Branch], table: ContinuationTable, found: Offshoots, failures: list[str], progress: Progress,
    journal: Records,
) -> None:  # fmt: skip
    """Follow edges of tongues of families in the second parameter; those that the journal holds are not followed again.

    They are those of every change of stability, and where the scene requests it those between unstable orbits.
    """
    asked = table.curve
    if asked is None:
        return
    known = {record.branch: record for record in journal.records if isinstance(record, EdgeRecord)}
    for family in families:
        if family.localised_diagram is not None:
            where = f"[continuation] curve: mode {mode_of(family)}"
            failures.append(f"{where}: changes of localised multipliers are not followed in another parameter")
            continue
        diagram = family.stability_diagram
        counts = {EVENTS: len(family.changes), FURTHER: len(diagram.further) if diagram and asked.further else 0}
        for listed, number in ((listed, k) for listed, count in counts.items() for k in range(1, count + 1)):
            mode, name = mode_of(family), f"{listed} {mode_of(family)} {number}"
            progress.say(f"j = {mode}: edge {number} of {counts[listed]} in {asked.parameter}")
            try:
                curve = _kept(known.get(name))
                if curve is None:
                    point = family.edge(number - 1, further=listed == FURTHER)
                    options = {"max_points": table.max_points, "max_step": table.max_step}
                    curve = point.curve(asked.parameter, asked.to, **options)
                    _keep(name, curve, journal, progress)
            except (ValueError, ArithmeticError) as error:
                failures.append(f"[continuation] curve: mode {mode}, edge {number} of {listed}: {error}")
            else:
                found.edges.append((mode, listed, number, curve))


def _keep(name: str, curve: EdgeCurve, journal: Records, progress: Progress) -> None:
    """Append a curve to the journal, where its model can be saved."""
    try:
        data = saved(curve)
    except ValueError as error:
        progress.report(f"{journal.path}: {error}; the edge is followed again by --resume")
    else:
        journal.append(EdgeRecord(name, data))


def _kept(record: EdgeRecord | None) -> EdgeCurve | None:
    """The curve of a record; None without one."""
    if record is None:
        return None
    curve = restored(record.curve)
    return curve if isinstance(curve, EdgeCurve) else None


def write_offshoots(
    request: Request, families: Sequence[Branch], found: Offshoots, attributes: dict[str, float | str], directory: Path
) -> None:
    """special_points.csv; edges.csv with its picture; a netCDF file for each branch that leaves."""
    rows = [row for family in families for row in _rows(f"j{mode_of(family)}", family)]
    rows += [row for name, branch in found.leaving for row in _rows(name, branch)]
    write_csv(directory / "special_points.csv", POINT_COLUMNS, rows)
    for name, branch in found.leaving:
        if len(branch):
            write_netcdf(directory / f"{name}.nc", replace(dataset_of([branch]), attributes=attributes))
    if found.edges:
        table = [row for mode, listed, number, curve in found.edges for row in _edge_rows(mode, listed, number, curve)]
        write_csv(directory / "edges.csv", list(table[0]), table)
        curves = [curve for *_, curve in found.edges]
        picture(request.scene, directory / "edges", figures.edges_figure, curves, request.scene.title or "")


def _rows(name: str, branch: Branch) -> Iterator[dict[str, Cell]]:
    """A row for each special point of a branch in S."""
    for point in branch.special_points:
        orbit = point.solution
        known: list[Cell] = [name, point.kind, point.parameters["S"], point.error, orbit.Omega, orbit.period]  # type: ignore[attr-defined]
        yield dict(zip(POINT_COLUMNS, [*known, "" if point.mu is None else point.mu, _lost(point)], strict=True))


def _lost(point: SpecialPoint) -> str:
    return ", ".join(point.lost) if point.mu is not None else ""


def _edge_rows(mode: int, listed: str, number: int, curve: EdgeCurve) -> Iterator[dict[str, Cell]]:
    """A row for each point of an edge."""
    columns = edge_columns(curve)
    for k in range(len(curve)):
        values: dict[str, Cell] = {name: values[k].item() for name, values in columns.items()}
        yield {"mode": mode, "edge": number, "kind": curve.kind, "table": listed, **values}


# The lines that `check` prints of lattices: their declarations, and the properties found in them ----------------------

ROUNDING = 1e-13  # of the largest omega^2: smaller ones are 0
MOST_MODES = 600  # whose frequencies a plan computes at once


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
            count = int(np.sum(np.abs(squares.imag) > REAL * np.max(np.abs(squares))))
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
    zero = ROUNDING * max(abs(low), abs(high))
    ends = (f"{np.sqrt(abs(end)):.6g}{'i' if end < -zero else ''}" if abs(end) > zero else "0" for end in (low, high))
    return "from " + " to ".join(ends)


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


# Files of the linear spectrum of a lattice: modes with where they live, bands of the cell, the skin effect ------------


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
