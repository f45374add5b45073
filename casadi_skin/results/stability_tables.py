"""Tables of a family's stability: its changes, edges inside unstable stretches, and tongues."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from casadi_skin.follow.unresolved import Unresolved
from casadi_skin.results.dataset import Cell
from casadi_skin.stability.tongues.diagram import StabilityDiagram, StabilityEdge, Tongue
from casadi_skin.stability.tongues.localised_diagram import LocalisedChange, LocalisedDiagram

EVENT_COLUMNS = (
    "mode", "S", "Omega", "kind", "stable_before", "stable_after", "mu", "S_width",
    "S_error", "multiplier_real", "multiplier_imaginary", "signatures", "tongue", "tongue_width", "tongue_growth",
)  # fmt: skip
PROVED_COLUMNS = ("proved_S_lower", "proved_S_upper")  # of events.csv, where proofs are requested
TONGUE_COLUMNS = (
    "mode", "tongue", "kind", "S_start", "S_start_error", "S_end", "S_end_error", "width", "growth",
    "max_abs_multiplier", "S_deepest", "modes", "order", "decided",
)  # fmt: skip
UNRESOLVED = "unresolved"  # kind of the rows of stretches that are not known


def event_rows(
    mode: int,
    diagram: StabilityDiagram | LocalisedDiagram,
    prove: Callable[[Any], tuple[float, float] | None] | None = None,
) -> list[dict[str, Cell]]:
    """Rows of events.csv: changes of stability in order, and stretches on which some may be missing.

    With `prove`, which gives two S between which a change is proved or None, they have the columns for it.
    """
    rows = [*edge_rows(mode, diagram, diagram.changes), *(_unresolved(mode, u) for u in diagram.unresolved)]
    if prove is not None:
        brackets = [prove(edge) for edge in diagram.changes] + [None] * len(diagram.unresolved)
        for row, ends in zip(rows, brackets, strict=True):
            row.update(zip(PROVED_COLUMNS, ends or ("", ""), strict=True))
    return sorted(rows, key=lambda row: row["S"] if isinstance(row["S"], float) else -1.0)


def further_rows(mode: int, diagram: StabilityDiagram | LocalisedDiagram) -> list[dict[str, Cell]]:
    """Rows of further_events.csv: places where orbits are unstable on both sides, or stable on both."""
    return list(edge_rows(mode, diagram, diagram.further))


def edge_rows(
    mode: int, diagram: StabilityDiagram | LocalisedDiagram, edges: Sequence[StabilityEdge | LocalisedChange]
) -> Iterator[dict[str, Cell]]:
    """Rows of edges of tongues, and of changes of localised multipliers, which bound none."""
    for e in edges:
        signatures = "".join("+" if sign > 0 else "-" for sign in e.signatures)
        values: tuple[Cell, ...] = (
            mode, e.S, e.Omega, e.kind, int(e.stable_before), int(e.stable_after), e.mu, e.S_width,
            e.S_error, e.multiplier.real, e.multiplier.imag, signatures, *_of_tongue(diagram, e),
        )  # fmt: skip
        yield dict(zip(EVENT_COLUMNS, values, strict=True))


def _of_tongue(
    diagram: StabilityDiagram | LocalisedDiagram, edge: StabilityEdge | LocalisedChange
) -> tuple[Cell, Cell, Cell]:
    """Number, width and growth of the tongue that an edge bounds."""
    if isinstance(diagram, LocalisedDiagram) or isinstance(edge, LocalisedChange):
        return "", "", ""
    return edge.tongue + 1, edge.width, diagram.tongues[edge.tongue].growth


def _unresolved(mode: int, stretch: Unresolved) -> dict[str, Cell]:
    known = np.isfinite([stretch.S_start, stretch.S_end]).all()
    row: dict[str, Cell] = dict.fromkeys(EVENT_COLUMNS, "")
    start, width = (stretch.S_start, abs(stretch.S_end - stretch.S_start)) if known else ("", "")
    return {**row, "mode": mode, "S": start, "kind": UNRESOLVED, "S_width": width}


def tongue_rows(mode: int, diagram: StabilityDiagram | LocalisedDiagram) -> list[dict[str, Cell]]:
    """Rows of tongues.csv: every tongue, also those too narrow to decide whether they open."""
    if isinstance(diagram, LocalisedDiagram):
        return []
    decided = [_tongue(mode, number, tongue) for number, tongue in enumerate(diagram.tongues, start=1)]
    rows = [*decided, *(_tongue(mode, "", tongue) for tongue in diagram.undecided)]
    return sorted(rows, key=lambda row: float(row["S_start"]))


def _tongue(mode: int, number: Cell, t: Tongue) -> dict[str, Cell]:
    start, end = ("" if t.open_start else t.start.S_error), ("" if t.open_end else t.end.S_error)
    values: tuple[Cell, ...] = (
        mode, number, t.kind, t.start.S, start, t.end.S, end, t.width, t.growth, t.max_abs_multiplier, t.S_deepest,
        "" if t.modes is None else f"{t.modes[0]} {t.modes[1]}", "" if t.order is None else t.order, int(t.decided),
    )  # fmt: skip
    return dict(zip(TONGUE_COLUMNS, values, strict=True))
