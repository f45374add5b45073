"""CSV tables of a run: family.csv, events.csv, dynamics.csv, spectrum.csv; 17 significant digits, no NaN."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from casadi_skin.files import replacing
from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.stability_changes import StabilityChange

if TYPE_CHECKING:
    from casadi_skin.dynamics import Evolution

Cell = float | int | str
EVENT_COLUMNS = ("mode", "S", "Omega", "kind", "stable_before", "stable_after", "mu", "S_width")


def orbit_row(orbit: Orbit, index: int, with_stability: bool) -> dict[str, Cell]:
    """One row of family.csv; the stability columns are absent without stability."""
    row: dict[str, Cell] = {
        "mode": orbit.space.coordinates.mode_number,
        "point": index,
        "requested": int(orbit.point.requested),
        "S": orbit.S,
        "Omega": orbit.Omega,
        "Omega_shift": orbit.Omega_shift,
        "period": orbit.period,
        "energy": orbit.energy if math.isfinite(orbit.energy) else "",  # infinite, where an infinite tail moves along
    }
    if with_stability:
        stability = orbit.floquet()
        row |= {
            "max_abs_multiplier": stability.max_abs_multiplier,
            "stable": int(stability.stable),
            "unstable_real": stability.unstable_real,
            "unstable_complex": stability.unstable_complex,
            "multiplier_error": stability.error,
        }
    regime = {} if orbit.regime is None else {"regime": orbit.regime.name.lower()}
    return row | {
        "Omega_error": orbit.Omega_error,
        "residual": orbit.residual,
        "profile_error": orbit.profile_error,
        "at_round_off": int(orbit.at_round_off),
        "S_error": orbit.S_error,
        **regime,
    }


def event_row(mode: int, change: StabilityChange) -> dict[str, Cell]:
    """One row of events.csv."""
    values = (
        mode,
        change.S,
        change.Omega,
        change.kind,
        int(change.stable_before),
        int(change.stable_after),
        change.mu,
        change.S_width,
    )
    return dict(zip(EVENT_COLUMNS, values, strict=True))


def evolution_columns(sites: int) -> list[str]:
    """Columns of dynamics.csv: t, energy and a displacement y_n a site."""
    return ["t", "energy", *(f"y_{n}" for n in range(1, sites + 1))]


def evolution_rows(evolution: Evolution) -> Iterator[dict[str, Cell]]:
    """Rows of dynamics.csv, one a time."""
    columns = evolution_columns(evolution.chain.sites)
    for t, energy, y in zip(evolution.t, evolution.energy, evolution.displacements, strict=True):
        yield dict(zip(columns, map(float, (t, energy, *y)), strict=True))


def spectrum_rows(chain: Chain) -> list[dict[str, Cell]]:
    """Rows of spectrum.csv: mode and omega; raises ValueError where a mode does not oscillate."""
    return [{"mode": j, "omega": float(w)} for j, w in enumerate(chain.linear_frequencies(), start=1)]


def _text(value: Cell) -> str:
    return f"{value:.17g}" if isinstance(value, float) else str(value)


def _line(row: Mapping[str, Cell], columns: Sequence[str], place: int) -> list[str]:
    """Cells of a row in text; raises ArithmeticError naming row and column of a value that is not finite."""
    for column in columns:
        value = row[column]
        if isinstance(value, float) and not math.isfinite(value):
            named = ", ".join(f"{name} {row[name]}" for name in ("mode", "point", "S", "t") if name in row)
            raise ArithmeticError(f"{column}: {value} in row {place} ({named}); it is not written")
    return [_text(row[column]) for column in columns]


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Cell]]) -> None:
    """Write rows under `columns`, replacing the file in one step.

    Raises ArithmeticError on a value that is not finite, naming its row (from 1) and column.
    """
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(_line(row, columns, place) for place, row in enumerate(rows, start=1))
