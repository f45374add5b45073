"""Results of families beside their points: branches that leave them, and edges of tongues in a parameter."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.points.edges import EdgeCurve
from casadi_skin.points.switch import leaving_space
from casadi_skin.results import figures
from casadi_skin.results.branch_records import EdgeRecord, Records
from casadi_skin.results.dataset import Cell, write_csv, write_netcdf
from casadi_skin.results.frames import edge_columns
from casadi_skin.results.quantities import dataset_of
from casadi_skin.results.saving import SavedResult, restored, saved
from casadi_skin.runs.diagram import ended_well
from casadi_skin.runs.model_tables import ContinuationTable
from casadi_skin.runs.offshoots import Offshoots
from casadi_skin.runs.pictures import picture
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.request import Request
from casadi_skin.runs.writing import mode_of

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
        journal.append(EdgeRecord(name, msgspec.msgpack.encode(data)))


def _kept(record: EdgeRecord | None) -> EdgeCurve | None:
    """The curve of a record; None without one."""
    if record is None:
        return None
    curve = restored(msgspec.msgpack.decode(record.curve, type=SavedResult))
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
