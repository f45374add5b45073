"""Files of a run: netCDF, special points, the spectrum, pictures and films."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.lattice.spectrum import linear_frequencies
from casadi_skin.results import figures
from casadi_skin.results.dataset import Cell, unique_names, write_csv, write_netcdf
from casadi_skin.results.quantities import dataset_of
from casadi_skin.results.tables import (
    EVENT_COLUMNS,
    PROVED_COLUMNS,
    TONGUE_COLUMNS,
    UNRESOLVED,
    event_rows,
    further_rows,
    tongue_rows,
)
from casadi_skin.runs.origins import mode_of, origin
from casadi_skin.runs.pictures import picture
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.request import Request
from casadi_skin.zero.family import TWO_PI

PASSED_COLUMNS = ("mode", "S_before", "S_after", "Omega_before", "Omega_after", "changes", "meetings")


def write_branches(
    request: Request, branches: Sequence[Branch], scene_text: str, directory: Path, progress: Progress
) -> None:
    """All files of branches but the table of their points."""
    scene = request.scene
    family = isinstance(branches[0].space, Family)
    vectors = scene.stability is not None and scene.stability.vectors
    dataset = dataset_of(branches, vectors)
    dataset = replace(dataset, attributes=origin(request, scene_text, branches[0]))
    write_netcdf(directory / ("family.nc" if family else "branch.nc"), dataset)
    if family:
        _write_families(request, branches, directory)
        if scene.family is not None and scene.family.film:
            _write_films(branches, directory, progress)
    else:
        _write_branch(request, branches[0], directory)


def _write_families(request: Request, branches: Sequence[Branch], directory: Path) -> None:
    """events.csv with the tables beside it, and the pictures of families."""
    stability = request.scene.stability
    if stability is not None and any(branch.with_events for branch in branches):
        diagrams = [(b, b.diagram_of_changes) for b in branches]
        known = [(mode_of(b), diagram) for b, diagram in diagrams if diagram is not None]
        if request.scene.accuracy.certify:
            rows_of = [event_rows(mode_of(b), diagram, b.certify_change) for b, diagram in diagrams if diagram]
            columns = (*EVENT_COLUMNS, *PROVED_COLUMNS)
            write_csv(directory / "events.csv", columns, [row for rows in rows_of for row in rows])
        else:
            write_csv(directory / "events.csv", EVENT_COLUMNS, [row for each in known for row in event_rows(*each)])
        for name, names, make in (
            ("further_events", EVENT_COLUMNS, further_rows),
            ("tongues", TONGUE_COLUMNS, tongue_rows),
        ):
            write_csv(directory / f"{name}.csv", names, [row for each in known for row in make(*each)])
        passed = [row for branch in branches if branch.with_events for row in passed_rows(branch)]
        write_csv(directory / "passed_resonances.csv", PASSED_COLUMNS, passed)
    picture(request.scene, directory / "frequency", figures.frequency_figure, branches)
    picture(request.scene, directory / "profile", figures.profile_figure, branches)
    for branch in branches:
        if request.scene.chain is None:
            from casadi_skin.results.figures.profiles import plane_figure

            picture(request.scene, directory / f"plane_j{mode_of(branch)}", plane_figure, branch)
        picture(request.scene, directory / f"multipliers_j{mode_of(branch)}", figures.multiplier_figure, branch)


def passed_rows(branch: Branch) -> list[dict[str, Cell]]:
    """Rows of passed_resonances.csv."""
    found = branch.passed_resonances or ()
    rows = [(mode_of(branch), *one.S, *one.Omega, one.changes, one.met) for one in found]
    return [dict(zip(PASSED_COLUMNS, row, strict=True)) for row in rows]


def _write_films(branches: Sequence[Branch], directory: Path, progress: Progress) -> None:
    """A film of each family's mode, at the last requested point or at the end."""
    from casadi_skin.results.figures.spacetime import animate

    for branch in branches:
        progress.say(f"film of j = {mode_of(branch)}")
        requested = [orbit for orbit in branch.orbits if orbit.point.requested]
        animate((requested or branch.orbits)[-1], directory / f"film_j{mode_of(branch)}.gif")


def _write_branch(request: Request, branch: Branch, directory: Path) -> None:
    """special_points.csv and the pictures of another branch, or of a single solution."""
    title = request.scene.title or ""
    if len(branch) > 1:
        write_csv(directory / "special_points.csv", special_columns(branch), special_rows(branch))
        picture(request.scene, directory / "branch", figures.branch_figure, branch, title)
    picture(request.scene, directory / "orbit", figures.orbit_figure, branch.solutions[-1], title)


def special_columns(branch: Branch) -> list[str]:
    """Columns of special_points.csv; the period of orbits alone."""
    fixed = ("kind", "error", "period")
    return [fixed[0], *unique_names([branch.parameter], fixed), *fixed[1 : 3 if _has_orbits(branch) else 2]]


def special_rows(branch: Branch) -> list[dict[str, Cell]]:
    """Rows of special_points.csv: folds and changes of stability in the order of the branch; what is unresolved last.

    The error of a stretch that is not resolved is its width.
    """
    columns, rows, changes = special_columns(branch), list[list[Cell]](), iter(branch.located)
    folds = {id(point.solution): point for point in branch.special_points}
    for before, here in zip((None, *branch.solutions), branch.solutions, strict=False):
        if branch.located and before is not None and before.stable != here.stable:
            change = next(changes)
            kind = f"stability {'gained' if change.stable_after else 'lost'} ({change.kind})"
            rows.append([kind, change.value, change.error, TWO_PI / change.Omega])
        if id(here) in folds:
            fold = folds[id(here)]
            period = here.period if isinstance(here, Orbit) else math.nan
            rows.append([fold.kind, fold.parameters[branch.parameter], fold.error, period])
    rows += [[UNRESOLVED, stretch.start, abs(stretch.end - stretch.start), math.nan] for stretch in branch.passed_over]
    return [dict(zip(columns, row, strict=False)) for row in rows]


def _has_orbits(branch: Branch) -> bool:
    return isinstance(branch.solutions[0], Orbit)


def write_spectrum(request: Request, directory: Path) -> None:
    """spectrum.csv and the picture of the linear spectrum; of a lattice also where modes live, and its bands."""
    if request.scene.chain is None:
        from casadi_skin.lattice.lattice import Lattice

        if isinstance(request.model, Lattice):
            from casadi_skin.runs.family_points import write_lattice_spectrum

            write_lattice_spectrum(request.scene, request.model, request.parameters, directory)
            return
    frequencies = linear_frequencies(request.model, request.parameters)
    rows = [{"mode": j, "omega": float(w)} for j, w in enumerate(frequencies, start=1)]
    write_csv(directory / "spectrum.csv", ("mode", "omega"), rows)
    picture(request.scene, directory / "spectrum", figures.spectrum_figure, request.model, request.parameters)
